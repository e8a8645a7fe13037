"""Replay of a model over data that another engine made."""

import json

import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.replay import recommended, replay_files
from tests.attribution.pendulum import XML, record


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return record(tmp_path_factory.mktemp("rub"), friction=0.15, trials=2, seconds=2.5)


def test_the_true_model_errs_by_the_noise_and_the_declared_one_by_more(data):
    true = data.parent / "true.xml"
    true.write_text(XML.format(damping=0.02, friction=0.15, mass=1.0))
    right, declared = replay_files(true, data).as_dict(), replay_files(None, data).as_dict()
    assert right["median"] < 4e-4  # the noise is 2e-4
    assert declared["median"] > 10.0 * right["median"]
    assert (
        right["unit"] == "rad"
        and right["horizon"] == 0.5
        and set(right["trials"]) == {"trial_00", "trial_01"}
    )


def test_the_command_prints_json_and_draws(data, tmp_path, capsys):
    assert (
        cli.main(
            ["replay", str(data / "model.xml"), str(data), "--json", "--out", str(tmp_path / "out")]
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert {"median", "rms", "unit", "horizon", "joints", "trials"} <= set(told)
    assert np.isfinite(told["median"]) and (tmp_path / "out" / "replay.png").stat().st_size > 10_000


def test_a_horizon_that_is_none_is_refused(data, capsys):
    assert cli.main(["replay", str(data / "model.xml"), str(data), "--horizon", "-1"]) == 2
    assert "seconds" in capsys.readouterr().err


def test_units_that_the_motion_contradicts_are_told(data, tmp_path, capsys):
    """Torques logged in mN m, declared in N m: `diagnose` refuses them, the yardstick says so."""
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    (wrong / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    (wrong / "model.xml").write_text((data / "model.xml").read_text())
    for path in data.glob("*.csv"):
        rows = np.loadtxt(path, delimiter=",", skiprows=1) * [1.0, 1.0, 1e3]
        np.savetxt(wrong / path.name, rows, delimiter=",", header="time,q1,tau1", comments="")
    assert cli.main(["replay", str(wrong / "model.xml"), str(wrong)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "note: " in shown and "torques in mN m" in shown and "--as-declared" not in shown


def test_whole_trials_of_unlike_length_are_each_judged_over_their_own(tmp_path):
    record(tmp_path / "short", friction=0.15, trials=1, seconds=2.0)
    data = record(tmp_path / "both", friction=0.15, trials=1, seconds=5.0)
    (data / "short.csv").write_text(next((tmp_path / "short").glob("*.csv")).read_text())
    both = replay_files(None, data, asked=("whole",)).measures["whole"]
    apart = [
        replay_files(None, folder, asked=("whole",)).measures["whole"]
        for folder in (tmp_path / "short", record(tmp_path / "long", 0.15, trials=1, seconds=5.0))
    ]
    assert both.span == pytest.approx(np.mean([m.span for m in apart]), rel=1e-3)
    np.testing.assert_allclose(both.error, np.mean([m.error for m in apart], 0), rtol=1e-2)


def test_each_part_of_a_log_is_run_by_the_files_that_were_made_without_it(data, tmp_path):
    """A file that is good for the second trial alone, beside one that is good for none."""
    true, wrong = (XML.format(damping=0.02, friction=0.15, mass=m) for m in (1.0, 2.0))
    for name, text in (("", wrong), ("0", wrong), ("1", true)):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "model.xml").write_text(text)
    spans = {"stretches": 0.5}
    apart = {
        tmp_path / "0": ("trial_00", 0.0, 9.0),
        tmp_path / "1": ("trial_01", 0.0, 1.2),
    }
    (good,) = recommended(data, None, "tree", spans, ("trial_00",), apart)(tmp_path)["model.xml"]
    (bad,) = recommended(data, None, "tree", spans, ("trial_01",), apart)(tmp_path)["model.xml"]
    (both,) = recommended(data, None, "tree", spans, (), apart)(tmp_path)["model.xml"]
    assert good["after"] < 1e-3 < 0.1 * bad["after"]  # starts are fitted roughly
    assert good["after"] < both["after"] < bad["after"]
    assert not good["worse"]


@pytest.mark.long
def test_what_is_recommended_of_torques_is_judged_by_trials_that_made_no_file(data, tmp_path):
    report = diagnose(data, out=tmp_path, yardstick="torque")
    over = {row["over"] for rows in report["files"].values() for row in rows}
    assert set(report["files"]) == {"model.xml", "model.toml"}
    assert over == {"left-out stretches of 0.5 s"}
    assert not any(row["worse"] for rows in report["files"].values() for row in rows)
