"""A convention that the motion contradicts is told with the column and what to write; a healthy
recording is not doubted.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.quality.pendulum_design import check_conventions
from tests.logs.arm_files import L1, arm, write


def late(x, rows):
    return np.r_[[x[0]] * rows, x[:-rows]]


def swapped(c):
    other = {"1": "2", "2": "1"}
    return {k if k == "time" else k[:-1] + other[k[-1]]: c[k] for k in c}


def without_gravity(c):
    outer = 9.81 * 0.11 * np.sin(c["q1"] + c["q2"])
    return c | {
        "tau1": c["tau1"] - 9.81 * 0.33 * np.sin(c["q1"]) - outer,
        "tau2": c["tau2"] - outer,
    }


SPOILED = {
    "joints": (swapped, L1, "joint 1 and joint 2 look swapped"),
    "torques": (
        lambda c: c | {"tau1": c["tau2"], "tau2": c["tau1"]},
        L1,
        "exchange columns tau1 and tau2",
    ),
    "sign": (lambda c: c | {"tau2": -c["tau2"]}, L1, "turn the sign of column tau2"),
    "signs": (
        lambda c: c | {"tau1": -c["tau1"], "tau2": -c["tau2"]},
        L1,
        "all torques have the other sign",
    ),
    "angle": (
        lambda c: c | {"q2": -c["q2"], "v2": -c["v2"]},
        L1,
        "turn the signs of columns q2 and v2",
    ),
    # the mirror image of a turned joint 1: either will do
    "joint": (
        lambda c: c | {k: -c[k] for k in ("q2", "v2", "tau2")},
        L1,
        "joint 1 looks to be counted the other way round",
    ),
    "degrees": (
        lambda c: c | {"q1": np.degrees(c["q1"]), "v1": np.degrees(c["v1"])},
        L1,
        'q1 = "deg" under [units]',
    ),
    "absolute": (
        lambda c: c | {"q2": c["q1"] + c["q2"], "v2": c["v1"] + c["v2"]},
        L1,
        "q2 looks absolute",
    ),
    "gravity": (without_gravity, L1, "gravity is missing from the torques"),
    "mm": (lambda c: c, 1e3 * L1, "write l1 = 0.35 under [geometry]"),
    "late": (
        lambda c: c | {k: late(c[k], 2) for k in ("tau1", "tau2")},
        L1,
        "logged about 20 ms (2 rows) late",
    ),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_wrong_convention_is_told(tmp_path, name):
    spoil, l1, says = SPOILED[name]
    recording = read_pendulum(write(tmp_path, [spoil(c) for c in arm()], l1=l1))
    with pytest.raises(BadInput) as told:
        check_conventions(recording)
    assert says in str(told.value) and "--as-declared" in str(told.value)


def test_healthy_recordings_are_not_doubted(tmp_path):
    for seed in range(12):
        assert check_conventions(read_pendulum(write(tmp_path / str(seed), arm(seed=seed)))) == ()


def test_motion_that_follows_late_is_an_effect_or_a_sensor_and_warned_of(tmp_path):
    moved = [c | {k: late(c[k], 1) for k in ("q1", "q2", "v1", "v2")} for c in arm()]
    (found,) = check_conventions(read_pendulum(write(tmp_path, moved)))
    told = re.search(r"about ([\d.]+) ms late", found.message)
    assert (
        found.severity == "warn" and told and float(told[1]) == pytest.approx(10.0, abs=1.0)
    )  # one row
