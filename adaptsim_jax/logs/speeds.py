"""What logged speeds are, by the slopes of their angles: each way in which they may be another
number is a row of one table, and all are asked alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import SIGNAL, UNIT
from adaptsim_jax.logs.log import LogTrial, ModelNames
from adaptsim_jax.logs.quality.consistency import Agreement, velocity_agreement

DEGREE = math.pi / 180
RPM = 2 * math.pi / 60
MISTAKES: dict[float, tuple[str, dict[str, str]]] = {
    DEGREE: ("{q} in degrees while {v} are in rad/s", {"angle": "deg", "velocity": "rad/s"}),
    1 / DEGREE: ("{v} in deg/s while {q} are in rad", {"velocity": "deg/s"}),
    1e3: ("time in milliseconds", {"time": "ms"}),
    1e6: ("time in microseconds", {"time": "us"}),
    1 / RPM: ("{v} in revolutions per minute", {"velocity": "rpm"}),
    1e-3: ("{v} in rad/ms", {"velocity": "rad/ms"}),
}
"""Times that speeds are the slopes of the angles -> what explains it, and lines of `[units]`."""


@dataclass(frozen=True)
class Written:
    """A joint's columns of angle and speed, and the SI of one as the speed is written."""

    q: str
    v: str
    scale: float


def check_speeds(
    trials: Sequence[LogTrial], names: ModelNames, written: Mapping[str, Written]
) -> tuple[str, ...]:
    """Notes on speeds that are a little more or less than the slopes of their angles. BadInput
    where they are another number: a unit's, of the other sign, of the rotor.
    """
    columns = {j: written[name] for j, name in enumerate(names.joints) if name in written}
    hinges = [j for j in columns if names.joints[j] not in names.slides]
    agreements = [
        {
            j: a
            for j in columns
            if t.v is not None and (a := agreement(t.time, t.q[:, j], t.v[:, j]))
        }
        for t in trials
    ]
    for trial, by_joint in zip(trials, agreements, strict=True):
        hinge_agreements = {j: by_joint[j] for j in hinges if j in by_joint}
        if what := _mistake(hinge_agreements, columns):
            why = f"velocities and angles differ by a unit: suspected are {what}"
            raise BadInput(f"{trial.path}: {why} under [units] in meta.toml, or convert the file")
    gains = {
        j: g
        for j in columns
        if (g := common_ratio([by_joint[j] for by_joint in agreements if j in by_joint]))
    }
    wrong_joints = [j for j, g in gains.items() if not SIGNAL.min_gain < g < SIGNAL.max_gain]
    if wrong_joints:
        ignored = ", ".join(f'"{columns[j].v}"' for j in columns)
        raise BadInput(
            f"{trials[0].path}: {_ratio_text(gains, columns, wrong_joints)}, or ignore = "
            f"[{ignored}] above it to go without speeds"
        )
    scaled_joints = [j for j, gain in gains.items() if abs(math.log(gain)) > SIGNAL.gain_error]
    return (_ratio_text(gains, columns, scaled_joints),) if scaled_joints else ()


def agreement(time: np.ndarray, q: np.ndarray, v: np.ndarray) -> Agreement | None:
    """How speeds `v [T]` of a joint relate to its angles `q [T]`; None where they do not, or where
    it hardly moves.
    """
    rows = np.isfinite(q) & np.isfinite(v)
    if rows.sum() <= UNIT.min_rows:
        return None
    estimate = velocity_agreement(time[rows], q[rows], v[rows])
    if estimate.enough and estimate.r2 > UNIT.min_r2:
        return estimate
    return None


def _log_uncertainty(found: Agreement) -> float:
    """Estimate by how much a ratio may be off, in log: noise of the speeds makes it too large."""
    errors = SIGNAL.gain_errors * found.spread / abs(found.gain)
    return min(UNIT.log_tolerance, max(UNIT.ratio_tolerance, errors, 1.0 - found.r2))


def _mistake(found: Mapping[int, Agreement], columns: Mapping[int, Written]) -> str:
    """The row of `MISTAKES` that all joints agree on, or nothing."""
    if not found or min(a.gain for a in found.values()) <= 0:
        return ""
    words = {stem: ", ".join(getattr(columns[j], stem) for j in found) for stem in ("q", "v")}
    for size, (what, units) in MISTAKES.items():
        if all(abs(math.log(a.gain / size)) < _log_uncertainty(a) for a in found.values()):
            lines = " and ".join(f'{key} = "{unit}"' for key, unit in units.items())
            return f"{what.format(**words)}; write {lines}"
    return ""


def common_ratio(found: Sequence[Agreement]) -> float | None:
    """The ratio that trials agree on, 1 or -1 where it may be that; None where they do not."""
    gains = np.array([a.gain for a in found])
    if not len(gains) or abs(np.sum(np.sign(gains))) < len(gains):
        return None
    size, median = np.abs(gains), float(np.median(gains))
    if size.max() > UNIT.max_ratio * size.min():
        return None
    log_size = abs(math.log(abs(median)))
    # coarse rows of a fast motion leave ratios that trials do not share to the digit
    are_alike = len(size) > 1 and float(np.ptp(np.log(size))) < UNIT.log_ratio_tolerance * log_size
    if log_size < float(np.median([_log_uncertainty(a) for a in found])) or (
        log_size < UNIT.log_tolerance and not are_alike
    ):
        return math.copysign(1.0, median)
    return median


def _ratio_text(
    gains: Mapping[int, float], columns: Mapping[int, Written], joints: Sequence[int]
) -> str:
    """What speeds of these joints are, and what to write."""
    text = ", ".join(f"{columns[j].v} is {gains[j]:.4g} times d({columns[j].q})/dt" for j in joints)
    why = "filtered, or of a clock that differs"
    if any(gains[j] < 0 for j in joints):
        why = "of the other sign than the angle"
    elif any(abs(math.log(gains[j])) > UNIT.log_tolerance for j in joints):
        why = "of the motor's side of a gear"
    lines = " and ".join(f"{columns[j].v} = {columns[j].scale / gains[j]:.4g}" for j in joints)
    return f"{text} ({why}?); write {lines} under [units] in meta.toml"
