"""Damaged logs at random over the readers: each is refused in one line that names its file, or read with its meaning unchanged."""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.sysid.io.read import read_log
from adaptsim_jax.sysid.io.recording import read_recording
from adaptsim_jax.sysid.io.table import read_table
from adaptsim_jax.sysid.quality.audit import unwrapped
from adaptsim_jax.tasks.pendulum.measured import COLUMNS, measured_trajectory
from tests.sysid.arm_files import META, arm, write

CASES = pytest.mark.parametrize("cases", [300, pytest.param(10_000, marks=pytest.mark.slow)])
ANGLES, SPEEDS, TORQUES = ("q1", "q2"), ("v1", "v2"), ("tau1", "tau2")
wrap = lambda x, period=2 * np.pi: (x + period / 2) % period - period / 2


def scaled_time(c, rng):
    return c | {"time": c["time"] * float(rng.choice([1e3, 1e6, 1e9]))}


def epoch(c, rng):
    time = c["time"] + 1.7e9
    return c | {"time": time.astype(np.float32) if rng.integers(2) else time}


def wrapped(c, rng):
    moved = {k: wrap(c[k] + 2 * np.pi * int(rng.integers(-1, 2))) for k in ANGLES}
    return c | moved


def emptied(c, rng):
    names = SPEEDS if rng.integers(2) else (str(rng.choice([*ANGLES, *TORQUES])),)
    return c | {k: [str(rng.choice(["", "nan", "NaN", "null"]))] * len(c["time"]) for k in names}


def one_cell(c, rng):
    name, at = str(rng.choice(list(c))), int(rng.integers(len(c["time"])))
    cells = [f"{x:.12g}" for x in c[name]]
    cells[at] = str(rng.choice(["", "nan", "inf", "-inf", "x", "1,5", "1e400", "0x10", "--", "1 2"]))
    return c | {name: cells}


def rows(c, rng):
    n, kind = len(c["time"]), int(rng.integers(4))
    at, size = int(rng.integers(20, n - 80)), int(rng.integers(2, 60))
    order = np.arange(n)
    if kind == 0:
        order = np.delete(order, slice(at, at + size))
    elif kind == 1:
        order = np.insert(order, at, at)
    elif kind == 2:
        order[at], order[at + size] = order[at + size], order[at]
    else:
        order = order[: int(rng.integers(0, n))]
    return {k: x[order] for k, x in c.items()}


def clock(c, rng):
    at, step = int(rng.integers(20, len(c["time"]) - 20)), float(rng.choice([-1.0, -0.05, 0.5, 3600.0]))
    return c | {"time": np.where(np.arange(len(c["time"])) >= at, c["time"] + step, c["time"])}


def commas(c, rng):
    names = list(c) if rng.integers(2) else [str(rng.choice(list(c)))]
    return c | {k: ['"' + f"{x:.6f}".replace(".", ",") + '"' for x in c[k]] for k in names}


DAMAGES = (scaled_time, epoch, wrapped, emptied, one_cell, rows, clock, commas)


def same(read, c, time):
    """Angles as they were, at the times as they were, up to whole turns at the start."""
    for j, name in enumerate(ANGLES):
        own = np.interp(time, c["time"], c[name])
        off = read[:, j] - own
        turns = 2 * np.pi * np.round(np.median(off) / (2 * np.pi))
        if np.max(np.abs(off - turns)) > 0.05:
            return False
    return True


@pytest.fixture(scope="module")
def healthy():
    return [arm(count=1, seconds=3.0, seed=seed)[0] for seed in range(6)]


@CASES
def test_a_damaged_log_is_refused_or_means_what_it_meant(tmp_path, healthy, cases):
    refused, wrong = 0, []
    for seed in range(cases):
        rng = np.random.default_rng([42, seed])
        c = healthy[int(rng.integers(len(healthy)))]
        damage = DAMAGES[int(rng.integers(len(DAMAGES)))]
        folder = write(tmp_path / "data", [damage(c, rng)], meta=META)
        try:
            trial = unwrapped(read_recording(folder)).trials[0]
        except BadInput as error:
            refused += 1
            if "\n" in str(error) or str(folder) not in str(error):
                wrong.append((seed, damage.__name__, str(error)))
            continue
        # a clock that jumps forward moves what comes after it: the audit tells that gap
        jump = damage is clock and np.max(np.diff(trial.time)) > 0.3
        begin = trial.time - (1.7e9 if trial.time[0] > 1e6 else 0.0)
        if not jump and not same(trial.q, c, begin):
            wrong.append((seed, damage.__name__, "read with another meaning"))
    assert not wrong, wrong[:5]
    assert 0.3 * cases < refused < cases


@CASES
def test_a_damaged_log_of_a_mechanism_is_refused_or_means_what_it_meant(tmp_path, healthy, cases):
    """Rows whose angles were not read are there, and are missing."""
    refused, wrong = 0, []
    for seed in range(cases):
        rng = np.random.default_rng([44, seed])
        c = healthy[int(rng.integers(len(healthy)))]
        damage = DAMAGES[int(rng.integers(len(DAMAGES)))]
        folder = write(tmp_path / "data", [damage(c, rng)], meta='task = "mechanism"\n')
        try:
            trial = read_log(folder, ("joint1", "joint2")).trials[0]
        except BadInput as error:
            refused += 1
            if "\n" in str(error) or str(folder) not in str(error):
                wrong.append((seed, damage.__name__, str(error)))
            continue
        jump = damage is clock and np.max(np.diff(trial.time)) > 0.3
        read, begin = np.isfinite(trial.q).all(1), trial.time - (1.7e9 if trial.time[0] > 1e6 else 0.0)
        if not jump and not same(trial.q[read], c, begin[read]):
            wrong.append((seed, damage.__name__, "read with another meaning"))
    assert not wrong, wrong[:5]
    assert 0.3 * cases < refused < cases


@CASES
def test_a_damaged_trial_of_a_robot_is_refused_or_means_what_it_meant(tmp_path, healthy, cases):
    """Of a robot that hangs at first: the arm's trials, let go from there."""
    wrong, refused, count = [], 0, cases // 3
    for seed in range(count):
        rng = np.random.default_rng([43, seed])
        c = {k: x[40:] for k, x in healthy[int(rng.integers(len(healthy)))].items()}  # in motion from its first row
        hanging = c | {"time": c["time"] - c["time"][0]}
        hanging |= {"q1": c["q1"] - c["q1"][0] - np.pi, "q2": c["q2"] - c["q2"][0]}
        damage = DAMAGES[int(rng.integers(len(DAMAGES)))]
        path = write(tmp_path / "data", [damage(hanging, rng)], meta=META) / "00.csv"
        told = measured_trajectory({k: v for k, v in hanging.items() if k in COLUMNS}, "healthy")
        try:
            table = read_table(path, COLUMNS)
            read = measured_trajectory(table.columns, str(path), lines=table.lines, row_word=table.row_word)
        except BadInput as error:
            refused += 1
            if "\n" in str(error) or str(path) not in str(error):
                wrong.append((seed, damage.__name__, str(error)))
            continue
        if float(np.max(np.abs(np.asarray(read.angles) - np.asarray(told.angles)))) > 0.05:
            wrong.append((seed, damage.__name__, "read with another meaning"))
    assert not wrong, wrong[:5]
    assert 0.3 * count < refused < count
