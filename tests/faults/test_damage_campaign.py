"""Damaged recordings at random over all readers: each is refused in one line that names its file,
or read with its meaning unchanged.

pytest tests/faults/test_damage_campaign.py -m "slow or not slow"
"""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from tests.faults import readers_of_trials as trials
from tests.faults.damage import ASKED, POSES, TRACKS
from tests.faults.readers import READERS, Reader, number, numbers

PUSHES = trials.pushed, trials.write_tracks("pushing"), trials.read_pushes
SCOOPS = trials.scooped, trials.write_tracks("scooping"), trials.read_scoops
TOSSES = trials.tossed, trials.write_tosses, trials.read_tosses
TOLD_PUSHES = trials.asked_pushes, trials.write_record, trials.read_push_record
TOLD_SCOOPS = trials.asked_scoops, trials.write_record, trials.read_scoop_record
ALL = [
    *READERS,
    Reader("diagnose, pushes", 60, trials.PUSH, ASKED, *PUSHES, off=2e-3),
    Reader("diagnose, scoops", 61, trials.SCOOP, ASKED, *SCOOPS, off=2e-3),
    Reader("diagnose, tosses", 62, trials.TOSS, POSES, *TOSSES, off=5e-3),
    Reader(
        "robot record, pushes", 63, trials.ASKED, TRACKS, *TOLD_PUSHES, off=5e-3, resampled=True
    ),
    Reader(
        "robot record, scoops", 64, trials.LIFTED, TRACKS, *TOLD_SCOOPS, off=5e-3, resampled=True
    ),
]
NEEDS = {"bag": "rosbags", "MCAP": "rosbags", "LeRobot": "pyarrow"}
TURN = 2 * np.pi


def drawn(reader: Reader, seed: int):
    """The healthy recording, what is done to it, and what it is then."""
    rng = np.random.default_rng([reader.seed, seed])
    healthy = reader.healthy()
    own = healthy[int(rng.integers(len(healthy)))]
    what = reader.damages[int(rng.integers(len(reader.damages)))]
    return own, what.__name__, what(own, rng, reader.kind)


def lost(own, damaged, k: int, name: str, time: np.ndarray) -> np.ndarray:
    """Rows `[T]` at `time` s whose torque damage left no number: it acts on from the row before,
    which is told.
    """
    cells = numbers(damaged.trials[k].get(name, ()))
    if not name.startswith("tau") or len(cells) != len(own.trials[k]["time"]):
        return np.zeros(len(time), bool)
    row = np.searchsorted(own.trials[k]["time"], time + 1e-6, side="right") - 1
    return ~np.isfinite(cells[np.maximum(row, 0)])


def unlike(reader: Reader, read, own, damaged) -> str:
    """Which columns mean another thing than those of the healthy recording; nothing where none
    does.
    """
    for k, trial in read.trials.items():
        for name, column in trial.columns.items():
            here = np.isfinite(column)
            if "lack a number" in read.told:
                here &= ~lost(own, damaged, k, name, trial.time)
            if not here.any():
                return f"trial {k}: {name}, none of which is left,"
            off = column[here] - healthy_column(own, k, name, trial.time[here])
            if name in reader.kind.angles:  # whole turns at the start are no other posture
                off = off - TURN * np.round(np.median(off) / TURN)
            if np.max(np.abs(off), initial=0.0) > reader.off:
                return f"trial {k}: {name}"
    for name, column in (read.actions or {}).items():
        at = np.array([int(k) for k in read.trials])
        if not np.allclose(column, np.asarray(own.actions[name])[at], atol=1e-6):
            return f"actions: {name}"
    return ""


def healthy_column(own, k: int, name: str, time: np.ndarray) -> np.ndarray:
    """A column of a healthy trial at `time` s: torques hold from row to row, a turn is the product
    of its numbers.
    """
    c = own.trials[k]
    if "*" in name:
        return np.prod([np.interp(time, c["time"], c[q]) for q in name.split("*")], 0)
    if name.startswith("tau"):
        return np.asarray(c[name])[
            np.maximum(np.searchsorted(c["time"], time + 1e-6, side="right") - 1, 0)
        ]
    return np.interp(time, c["time"], c[name])


def begun(own, damaged):
    """A healthy recording whose clock counts from the first stamp that damage left a number, as
    that of a bag does.
    """
    trials = []
    for c, d in zip(own.trials, damaged.trials, strict=False):
        stamps = np.array([number(z) for z in d.get("time", ())])
        first = int(np.argmax(np.isfinite(stamps))) if len(stamps) == len(c["time"]) else 0
        trials.append(c | {"time": np.asarray(c["time"]) - c["time"][first]})
    return replace(own, trials=trials + own.trials[len(trials) :])


def wrong(reader: Reader, seed: int, folder) -> tuple[bool, str]:
    """Whether a damaged recording was refused, and what was wrong of that; "" where all was
    right.
    """
    own, what, damaged = drawn(reader, seed)
    shutil.rmtree(folder, ignore_errors=True)
    source = reader.write(folder, damaged)
    try:
        read = reader.read(source)
    except BadInput as error:
        right = "\n" not in str(error) and str(folder) in str(error)
        return True, "" if right else f"{what}: {error}"
    if reader.resampled:
        told = reader.read(reader.write(folder, own))
        pairs = [(read.trials[k].columns, told.trials[k].columns) for k in told.trials]
        off = max(float(np.max(np.abs(a[n] - b[n]))) for a, b in pairs for n in b)
        return False, f"{what}: read with another meaning" if off > reader.off else ""
    own = begun(own, damaged) if "bag" in reader.name or "MCAP" in reader.name else own
    # a clock that jumps forward moves what comes after it: that gap is told, of a log by the audit
    jump = what == "clock" and any(
        np.max(np.diff(t.time), initial=0.0) > 0.3 for t in read.trials.values()
    )
    jump &= reader.kind.angles != () or "nothing was recorded" in read.told
    other = "" if jump else unlike(reader, read, own, damaged)
    return False, f"{what}: {other} has another meaning" if other else ""


@pytest.mark.parametrize("reader", ALL, ids=lambda reader: reader.name)
@pytest.mark.parametrize("tier", ["quick", pytest.param("slow", marks=pytest.mark.slow)])
def test_a_damaged_recording_is_refused_or_means_what_it_meant(tmp_path, reader, tier):
    """705 in all, 10,000 in the slow tier."""
    cases = reader.cases[tier == "slow"]
    for word, library in NEEDS.items():
        if word in reader.name:
            pytest.importorskip(library)
    found = [wrong(reader, seed, tmp_path / "data") for seed in range(cases)]
    bad = [(seed, why) for seed, (_, why) in enumerate(found) if why]
    assert not bad, f"{len(bad)} of {cases}: {bad[:5]}"
    refused = sum(one for one, _ in found)
    assert 0.1 * cases < refused < cases
