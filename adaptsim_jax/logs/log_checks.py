"""Units that a whole log betrays: milliseconds for seconds, degrees for radians; refused where it is sure, told where not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import LogTrial, ModelNames
from adaptsim_jax.logs.quality.consistency import velocity_agreement
from adaptsim_jax.logs.units import speed_mistake

LARGE = 4 * np.pi
"""Angle in rad beyond which degrees are suspected where no speeds tell."""
FAST = 20.0
"""rad/s beyond which such angles may be degrees where speeds agree with them."""
ODD = 15.0
"""Times that one trial's angles may reach as far as those of the others."""


def check_log_units(
    trials: Sequence[LogTrial], names: ModelNames, units: Mapping[str, object] | None = None
) -> tuple[str, ...]:
    """Notes about suspicious units. units: as declared; angles that are degrees already are not asked about.

    Raises `BadInput` naming the trial and the line for meta.toml where the data are sure.
    """
    hinges = [j for j, joint in enumerate(names.joints) if joint not in names.slides]
    for trial in trials:
        if what := _speed_suspect(trial, hinges):
            why = f"velocities and angles differ by a unit: suspected are {what}"
            raise BadInput(f"{trial.path}: {why} under [units] in meta.toml, or convert the file")
    degrees = any(unit in ("deg", "degrees") for unit in (units or {}).values())
    return () if degrees else tuple(note for j in hinges if (note := _large(trials, j, names)))


def _speed_suspect(trial: LogTrial, hinges: Sequence[int]) -> str:
    """The mistake that all hinges that move enough agree on, or nothing."""
    if trial.v is None:
        return ""
    here = {j: np.isfinite(trial.q[:, j]) & np.isfinite(trial.v[:, j]) for j in hinges}
    return speed_mistake(
        velocity_agreement(trial.time[rows], trial.q[rows, j], trial.v[rows, j])
        for j, rows in here.items()
        if rows.sum() > 20
    )


def _large(trials: Sequence[LogTrial], j: int, names: ModelNames) -> str:
    reaches = np.array([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials])
    reach = float(np.median(reaches))
    odd = int(reaches.argmax())
    if reaches[odd] > max(LARGE, ODD * reach):
        return (
            f"angles of {names.joints[j]} reach {reaches[odd]:.3g} rad in {trials[odd].name}, {reach:.2g} rad in the others: if they "
            "are degrees there, convert that file"
        )
    speeds = [np.nanquantile(np.abs(t.v[:, j]), 0.99) for t in trials if t.v is not None]
    if reach < LARGE or (speeds and np.median(speeds) < FAST):
        return ""
    more = "; LeRobot may write per cent of a range, too" if trials[0].path.endswith(".parquet") else ""
    return f'angles of {names.joints[j]} reach {reach:.3g} rad: if they are degrees, write angle = "deg" under [units]{more}'
