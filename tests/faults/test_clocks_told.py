"""Clocks and efforts that the motion contradicts: jitter of stamps, stamps that are counted,
currents for torques; with the advice done.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from tests.faults.servo_files import log, noisy, sines, swung
from tests.logs.arm_files import arm
from tests.logs.log_files import folder

NAMES = ("joint1", "joint2")
ARM = (
    '<mujoco><worldbody><body><joint name="joint1" axis="0 1 0" damping="0.03"/><inertial pos="0 0 '
    '-0.12" mass="1" '
    'diaginertia="0.0371 0.0371 1e-3"/><body pos="0 0 -0.35"><joint name="joint2" axis="0 1 0" '
    'damping="0.02"/>'
    '<inertial pos="0 0 -0.18333" mass="0.6" diaginertia="0.014833 0.014833 '
    '1e-3"/></body></body></worldbody></mujoco>'
)
"""The arm of `arm_files`: p1 = I1 + m1 r1^2 + m2 l1^2 + p3, p3 = I2 + m2 r2^2, h1 = m1 r1 + m2 l1,
h2 = m2 r2.
"""


def recorded(path, trials, meta="", names=("q", "v", "tau")):
    def named(c):
        return {"time": c["time"]} | {
            f"{s}_{n}": c[f"{s}{k + 1}"] for s in names for k, n in enumerate(NAMES)
        }

    data = folder(
        path, f'model = "robot.xml"\n{meta}', **{f"run_{k}": named(c) for k, c in enumerate(trials)}
    )
    (path / "robot.xml").write_text(ARM)
    return data


def test_the_arm_itself_is_told_nothing_of(tmp_path):
    assert check_conventions(load(recorded(tmp_path / "a", arm(4)))) == ()


@pytest.mark.parametrize("slow, scale", [(2.0, 1.0), (0.5, 1.0), (1.5, 1.0), (2.0, 3.0)])
def test_time_that_gravity_contradicts_is_told_with_its_factor(tmp_path, slow, scale):
    trials = [c | {"time": c["time"] * slow} for c in arm(4, scale=scale)]
    only = [{k: x for k, x in c.items() if not k.startswith("v")} for c in trials]
    data = recorded(tmp_path / "a", only, names=("q", "tau"))
    with pytest.raises(BadInput, match=r"time runs too (slow|fast)") as error:
        check_conventions(load(data))
    line = re.search(r"time = [\d.]+", str(error.value))[0]
    assert float(line.split("= ")[1]) == pytest.approx(1.0 / slow, rel=0.06)
    assert "as if counted" in str(error.value)
    mended = load(recorded(tmp_path / "b", only, f"[units]\n{line}\n", names=("q", "tau")))
    assert check_conventions(mended) == ()


@pytest.mark.parametrize("friction", [5.0, 0.05, 0.0])
def test_friction_beyond_what_moves_a_joint_is_told_and_left_out_as_advised(tmp_path, friction):
    data = recorded(tmp_path / "a", arm(4))
    (data / "robot.xml").write_text(
        ARM.replace('name="joint2"', f'name="joint2" frictionloss="{friction}"')
    )
    told = check_conventions(load(data))
    assert len(told) == (friction == 5.0)
    assert all(
        "declares friction of 5 N m at joint2" in f.message and "or 0" in f.message for f in told
    )


def test_efforts_that_are_currents_are_asked_after_and_read_as_currents(tmp_path):
    trials = [c | {"tau1": c["tau1"] / 12.0, "tau2": c["tau2"] / 5.0} for c in arm(4)]
    (told,) = check_conventions(load(recorded(tmp_path / "a", trials)))
    assert "are these currents (A)" in told.message and "12 at joint1, 5 at joint2" in told.message
    lines = re.search(r'i_\w+ = "\w+", i_\w+ = "\w+"', told.message)[0].replace(", ", "\n")
    machine = load(recorded(tmp_path / "b", trials, f'input = "current"\n[columns]\n{lines}\n'))
    assert machine.log.input_kind == "current" and machine.gain_unknown


@pytest.mark.parametrize("how", ["uniform", "late"])
def test_rows_read_evenly_are_taken_so_whatever_their_stamps_say(tmp_path, how):
    def trials(stamped):
        out = []
        for seed in range(3):
            u = sines(seed, 300, 125.0, 1, 1.0)
            rng = np.random.default_rng(seed)
            jitter = (
                rng.uniform(-4e-4, 4e-4, 300) if how == "uniform" else rng.exponential(4e-4, 300)
            )
            out.append(
                (
                    np.arange(300) / 125.0 + stamped * (0.002 + jitter),
                    swung(u, 125.0) + 1e-5 * rng.normal(size=u.shape),
                    u,
                )
            )
        return out

    machine = load(log(tmp_path / "a", "", ("arm",), trials(1.0)))
    assert any("stamps of rows jitter" in note for note in machine.log.notes)
    for track in machine.tracks:
        np.testing.assert_allclose(np.diff(track.time), 0.008, rtol=1e-3)
    assert not any(
        "jitter" in note for note in load(log(tmp_path / "b", "", ("arm",), trials(0.0))).log.notes
    )


def test_rows_that_were_read_unevenly_keep_their_stamps(tmp_path):
    trials = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        fine = sines(seed, 2400, 1000.0, 1, 1.0)
        at = np.unique(np.clip(8 * np.arange(300) + rng.integers(-2, 3, 300), 0, 2399))
        trials.append((at / 1000.0, noisy(swung(fine, 1000.0)[at], seed), fine[at]))
    machine = load(log(tmp_path / "a", "", ("arm",), trials))
    assert not any("jitter" in note for note in machine.log.notes)
    np.testing.assert_allclose(machine.tracks[0].time, trials[0][0])
