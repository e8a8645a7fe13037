"""How long stretches are: what `--horizon` may be, what is told where no trial is as long, and the
command that a report names.
"""

import shlex
from dataclasses import dataclass

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.commands.parser import command_parser
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.run import command_of
from tests.logs.log_files import folder, motion, named


@dataclass(frozen=True)
class Made:
    """A simulator that is never run."""

    verify: object


SERVO = """<mujoco><option timestep="0.01"/><worldbody><body><joint name="arm" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/></body></worldbody></mujoco>"""  # noqa: E501


@pytest.mark.parametrize("command", ["diagnose", "replay"])
@pytest.mark.parametrize("given", ["-1", "nan", "long", "1e9"])
def test_what_is_no_length_is_refused(command, given, tmp_path, capsys):
    words = {
        "diagnose": [tmp_path, "--out", tmp_path / "out"],
        "replay": [tmp_path / "arm.xml", tmp_path],
    }[command]
    assert main([command, *map(str, words), "--horizon", given]) == 2
    assert "give seconds" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_diagnosis_over_nothing_names_what_it_is_over_whole_trials(tmp_path, capsys):
    assert main(["diagnose", str(tmp_path), "--out", str(tmp_path / "out"), "--horizon", "0"]) == 2
    assert "--yardstick whole" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("simulator", "horizon", "span"),
    [
        ("tree", 20.0, 1.19),
        ("mujoco", 20.0, 1.19),
        ("mujoco", 0.4, 0.4),
        ("mujoco", 0.0, 0.98 * 1.19),
    ],
)
def test_a_replay_tells_how_long_its_stretches_really_are(tmp_path, simulator, horizon, span):
    from adaptsim_jax.attribution.replay import replay_files

    log = folder(
        tmp_path / "log", 'input = "torque"\n', run=named(motion(1, rows=120), ("arm",), "q", "tau")
    )
    (tmp_path / "arm.xml").write_text(SERVO)
    found = replay_files(tmp_path / "arm.xml", log, horizon, ("stretches",), simulator)
    told = found.as_dict()
    np.testing.assert_allclose(told["horizon"], span, rtol=1e-6)
    np.testing.assert_allclose(np.ptp(found.time[0]), span, atol=0.03)
    assert any(
        "no trial is 20 s long: stretches are of 1.19 s" in note for note in found.notes
    ) == (horizon == 20.0)


def test_the_command_of_a_report_says_all_that_changes_the_answer():
    told = {
        "model": "arm.xml",
        "as_declared": True,
        "simulator": "tree",
        "yardstick": "torque",
        "horizon": 0.25,
    }
    command = command_of("my log", out="out", exclude=("backlash",), without=("a", "b"), **told)
    args = command_parser("diagnose").parse_args(shlex.split(command)[2:])
    assert {key: getattr(args, key) for key in told} == told
    assert (args.data, args.out, args.exclude, args.without) == (
        ["my log"],
        "out",
        ["backlash"],
        ["a", "b"],
    )
    assert command_of("log", out="out") == "adaptsim diagnose log --out out"


@pytest.mark.parametrize("simulator", [None, "mujoco"])
def test_a_diagnosis_hands_on_what_its_command_is_made_of(tmp_path, monkeypatch, simulator):
    """The search itself is not run: what reaches it is what the report's command names."""
    from adaptsim_jax.attribution import diagnose as by_tree
    from adaptsim_jax.simulators.mujoco import diagnosed as by_mujoco

    seen = {}

    def keep(*args, **options):
        seen.update(options)
        raise BadInput("reached")

    def made(source, log, horizon=None):
        seen["horizon"] = horizon
        return Made(None)

    monkeypatch.setattr(by_tree, "diagnose", keep)
    monkeypatch.setattr(by_mujoco, "simulator", made)
    monkeypatch.setattr(by_mujoco, "diagnose", keep)
    log = folder(
        tmp_path / "log", 'input = "torque"\n', run=named(motion(1, rows=120), ("arm",), "q", "tau")
    )
    (tmp_path / "arm.xml").write_text(SERVO)
    asked = ["--horizon", "0.3", *(["--simulator", simulator] if simulator else [])]
    assert (
        main(
            [
                "diagnose",
                str(log),
                "--model",
                str(tmp_path / "arm.xml"),
                "--out",
                str(tmp_path / "out"),
                *asked,
            ]
        )
        == 2
    )
    assert seen["horizon"] == 0.3
    if simulator:
        assert seen["command"].endswith("--simulator mujoco --horizon 0.3")
