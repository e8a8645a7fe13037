"""Units that the data betray: degrees for radians, milliseconds for seconds; suspected, never
mended.
"""

import math
from collections.abc import Iterable

import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.quality.consistency import Agreement, velocity_agreement
from adaptsim_jax.logs.quality.conventions import gravity_fit
from adaptsim_jax.logs.types import Recording, Trial

GAINS = {
    math.pi
    / 180: 'q1, q2 in degrees while v1, v2 are in rad/s; write angle = "deg" and velocity = "rad/s"',
    180 / math.pi: 'v1, v2 in deg/s while q1, q2 are in rad; write velocity = "deg/s"',
    1e3: 'time in milliseconds; write time = "ms"',
    1e6: 'time in microseconds; write time = "us"',
    60 / (2 * math.pi): 'v1, v2 in revolutions per minute; write velocity = "rpm"',
    1e-3: 'v1, v2 in rad/ms; write velocity = "rad/ms"',
}
ALIKE = 0.1
"""How far (in log) a speed may be from a known mistake and still be taken for it."""
FAST = 15.0
"""Top speed over sqrt(g / l) that no pendulum on a bench reaches (a fall from upright gives 2, a
whip 6).
"""
BETTER = 0.5
"""Share of the unexplained torque that must remain, at most, after a conversion for it to be
believed.
"""


def check_units(recording: Recording, *, angle_stated: bool = False) -> None:
    """Raise `BadInput` naming the first trial whose unit is suspect, with the line to add to
    meta.toml.

    Where meta.toml states the unit of angles, that is believed.
    """
    for trial in recording.trials:
        suspect = _velocity_suspect(trial)
        if suspect:
            raise BadInput(
                _say(trial, f"velocities and angles differ by a unit: suspected are {suspect}")
            )
    if not angle_stated and _degrees(recording):
        fastest = max(recording.trials, key=_top_speed)
        size = f"angles reach {_reach(fastest):.3g} and speeds {_top_speed(fastest):.3g}"
        why = f"{size}: degrees are suspected instead of radians"
        raise BadInput(_say(fastest, f'{why}; write angle = "deg", or "rad" if they are,'))


def _say(trial: Trial, why: str) -> str:
    return f"{trial.path}: {why} under [units] in meta.toml, or convert the file"


def _velocity_suspect(trial: Trial) -> str:
    """The unit mismatch that both joints agree on, or nothing."""
    return speed_mistake(
        []
        if trial.v is None
        else [velocity_agreement(trial.time, *z) for z in zip(trial.q.T, trial.v.T, strict=True)]
    )


def speed_mistake(joints: Iterable[Agreement]) -> str:
    """The mistake in a unit that speeds of all joints that move enough agree on (within 10 %), or
    nothing.
    """
    gains = [a.gain for a in joints if a.enough and a.r2 > 0.9]
    if not gains or min(gains) <= 0:
        return ""
    return next(
        (
            what
            for size, what in GAINS.items()
            if all(abs(math.log(g / size)) < ALIKE for g in gains)
        ),
        "",
    )


def _top_speed(trial: Trial) -> float:
    """A speed that the faster joint exceeds in one row of a hundred."""
    if trial.v is not None:
        v = trial.v
    else:
        v = np.diff(trial.q, axis=0) / np.diff(trial.time)[:, None]
    return float(np.max(np.quantile(np.abs(v), 0.99, axis=0)))


def _reach(trial: Trial) -> float:
    return float(np.max(np.abs(trial.q)))


def _degrees(recording: Recording) -> bool:
    """Angles too large and speeds too high for radians, or a rigid-body fit that degrees suit far
    better.

    The fit decides where there is torque to judge by: sin and cos of the true angle enter the
    dynamics. Sizes are those of the median trial: all of a recording is in one unit, and one trial
    may have run away.
    """
    reach = float(np.median([_reach(t) for t in recording.trials]))
    speed = float(np.median([_top_speed(t) for t in recording.trials]))
    length = min(recording.geometry.get("l1", 0.3), recording.geometry.get("l2", 0.3))
    gravity = max(recording.geometry.get("g", GRAVITY), 1.0)
    implausible = reach > 10 and speed > FAST * math.sqrt(gravity / length)
    if recording.model != "rigid_body" or reach < 5:
        return implausible
    as_rad = 1.0 - gravity_fit(recording)[2]
    as_deg = 1.0 - gravity_fit(recording, math.pi / 180)[2]
    if min(as_rad, as_deg) < 0.5:
        return as_deg < BETTER * as_rad
    return implausible
