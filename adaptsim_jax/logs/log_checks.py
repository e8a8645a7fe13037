"""Units that a whole log betrays: milliseconds for seconds, degrees for radians; refused where it
is sure, told where not.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.log import LogTrial, ModelNames
from adaptsim_jax.logs.log_units import LENGTH_UNITS
from adaptsim_jax.logs.quality.consistency import Agreement, velocity_agreement

WORDS = {"mm": "millimetres", "cm": "centimetres"}
MISTAKES = {
    math.pi / 180: (
        'q1, q2 in degrees while v1, v2 are in rad/s; write angle = "deg" and velocity = "rad/s"'
    ),
    180 / math.pi: 'v1, v2 in deg/s while q1, q2 are in rad; write velocity = "deg/s"',
    1e3: 'time in milliseconds; write time = "ms"',
    1e6: 'time in microseconds; write time = "us"',
    60 / (2 * math.pi): 'v1, v2 in revolutions per minute; write velocity = "rpm"',
    1e-3: 'v1, v2 in rad/ms; write velocity = "rad/ms"',
}
"""Times that speeds are the slopes of the angles -> the unit that explains it."""


def check_log_units(
    trials: Sequence[LogTrial],
    names: ModelNames,
    units: Mapping[str, object] | None = None,
    known: Collection[str] = (),
) -> tuple[str, ...]:
    """Notes about suspicious units.

    Raises `BadInput` naming the trial and the line for meta.toml where the data are sure.

    Args:
        units: As declared; angles that are degrees already are not asked about.
        known: Joints for whose angles or ways a unit is declared.
    """
    hinges = [j for j, joint in enumerate(names.joints) if joint not in names.slides]
    for trial in trials:
        if what := _speed_suspect(trial, hinges):
            why = f"velocities and angles differ by a unit: suspected are {what}"
            raise BadInput(f"{trial.path}: {why} under [units] in meta.toml, or convert the file")
    slides = [j for j, joint in enumerate(names.joints) if joint in names.slides]
    distant = tuple(
        note for j in slides if (note := _distance_note(trials, j, names, names.joints[j] in known))
    )
    degrees = any(unit in ("deg", "degrees") for unit in (units or {}).values())
    if degrees:
        return distant
    return distant + tuple(
        note for j in hinges if (note := _large(trials, j, names, names.joints[j] in known))
    )


def lengths_within(times: float) -> tuple[str, ...]:
    """Units of length that bring a sliding joint, which moves `times` as far as its range, into it.
    Metres are not asked about.
    """
    return tuple(
        unit
        for unit in ("mm", "cm")
        if times >= UNIT.hint and times * LENGTH_UNITS[unit] <= UNIT.inside
    )


def times_range(reach: float, limits: tuple[float, float] | None) -> float:
    """How many times as far from 0 as its declared range a joint moves; 0 where it has none."""
    span = max(map(abs, limits)) if limits else 0.0
    if span > 0.0:
        return reach / span
    return 0.0


def _distance_note(trials: Sequence[LogTrial], j: int, names: ModelNames, known: bool) -> str:
    """A note on ways too long for metres; BadInput where the declared range is surely passed, and
    no unit is declared.
    """
    reach = float(np.median([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials]))
    limits, joint = names.limits_of(j), names.joints[j]
    times = times_range(reach, limits)
    units = lengths_within(times)
    if known or (limits and not units) or (not limits and reach < UNIT.long):
        return ""
    ask = " or ".join(f'length = "{unit}"' for unit in units or ("mm",))
    if limits is None:
        return (
            f"{joint} slides as far as {reach:.3g} m: if that is no metres, write {ask} under "
            "[units]"
        )
    declared = f"{limits[0]:g} to {limits[1]:g} m"
    statement = (
        f"{joint} slides as far as {reach:.3g} m, {times:.2g} times its declared range of "
        f"{declared}"
    )
    if times < UNIT.distant:
        return f"{statement}: if that is no metres, write {ask} under [units]"
    raise BadInput(
        f"{trials[0].path}: {statement}, as {' or '.join(WORDS[unit] for unit in units)} would; "
        f"write {ask} under [units] in meta.toml, "
        'or length = "m" if they are metres and the range is not the machine\'s'
    )


def _speed_suspect(trial: LogTrial, hinges: Sequence[int]) -> str:
    """The mistake that all hinges that move enough agree on, or nothing."""
    if trial.v is None:
        return ""
    here = {j: np.isfinite(trial.q[:, j]) & np.isfinite(trial.v[:, j]) for j in hinges}
    return speed_mistake(
        velocity_agreement(trial.time[rows], trial.q[rows, j], trial.v[rows, j])
        for j, rows in here.items()
        if rows.sum() > UNIT.min_rows
    )


def speed_mistake(joints: Iterable[Agreement]) -> str:
    """The mistake in a unit that speeds of all joints that move enough agree on, or nothing."""
    gains = [a.gain for a in joints if a.enough and a.r2 > UNIT.related]
    if not gains or min(gains) <= 0:
        return ""
    for size, what in MISTAKES.items():
        if all(abs(math.log(gain / size)) < UNIT.alike for gain in gains):
            return what
    return ""


def _large(trials: Sequence[LogTrial], j: int, names: ModelNames, known: bool) -> str:
    """A note on angles that may be degrees. Where a unit is declared, on a trial that is unlike the
    others alone.
    """
    reaches = np.array([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials])
    reach = float(np.median(reaches))
    outlier = int(reaches.argmax())
    if reaches[outlier] > max(UNIT.large, UNIT.outlier * reach):
        return (
            f"angles of {names.joints[j]} reach {reaches[outlier]:.3g} rad in "
            f"{trials[outlier].name}, {reach:.2g} rad in the others: if they are degrees there, "
            "convert that file"
        )
    speeds = [np.nanquantile(np.abs(t.v[:, j]), 0.99) for t in trials if t.v is not None]
    if known or reach < UNIT.large or (speeds and np.median(speeds) < UNIT.fast):
        return ""
    if trials[0].path.endswith(".parquet"):
        more = "; LeRobot may write per cent of a range, too"
    else:
        more = ""
    return (
        f"angles of {names.joints[j]} reach {reach:.3g} rad: if they are degrees, write angle = "
        f'"deg" under [units]{more}'
    )
