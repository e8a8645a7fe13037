"""Numbers of a machine's servos by trial and log (`diagnosis/numbers.py`): what was fitted of whole
trials, and a delay and a mass at the hand that each log may have of its own.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.attribution.closed_loop import KEYS, NAMES, UNIT_OF, ServoDiagnosis, unit_of
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.numbers import Evidence, Number, tabled
from adaptsim_jax.diagnosis.report import words
from adaptsim_jax.diagnosis.testing import jackknife
from adaptsim_jax.simulators.closed_loop.law import ServoLaw
from adaptsim_jax.simulators.closed_loop.polish import (
    SHARED_BY_ALL,
    Coordinate,
    FittedServos,
    polish_laws,
    pull,
)
from adaptsim_jax.simulators.closed_loop.rivals import allowed_by_all
from adaptsim_jax.simulators.closed_loop.shared import DELAY_NAMES

STEP = 1e-4  # of a coordinate, for differences
OF_LOGS = ("delay", "payload")
"""What may differ from log to log though the machine is the same."""
LAW_UNITS = {"scale": "N m/rad", "damping": "N m s/rad", "offset": "N m"} | UNIT_OF


def number_rows(d: ServoDiagnosis) -> list[Table]:
    """Rows of `numbers` of a report."""
    found, recording, trials = d.found.found, d.recording, d.found.whole
    fitted = {name for _, name in found.model.coordinates}
    late = fitted & {*DELAY_NAMES}
    more = [
        n
        for n in OF_LOGS
        if n in allowed_by_all(recording) and n not in fitted and not (n == "delay" and late)
    ]
    model = FittedServos(found.model.fits, (*found.model.shared, *more))
    at = [c for c in model.coordinates if c[1] in NAMES]
    if not at:
        return []
    free = polish_laws(trials, model, rounds=0)
    prior, right = pull(trials, model)
    names = [t.name for t in recording.trials]
    trial_names = list(dict.fromkeys(names))
    trial = np.array([trial_names.index(names[k]) for k, _, _ in recording.pieces])
    evidence = Evidence(free.hess, -free.slope, prior, -right, trial)
    here = _values(d, model.laws, at)
    steps = STEP * np.eye(len(model.coordinates))
    there = [_values(d, trials.step_from(model, step).laws, at) for step in steps]
    slope = (np.stack(there, 1) - here[:, None]) / STEP
    known = found.steps.shape[1]
    wide = d.found.ends() * jackknife(found.steps @ slope[:, :known].T)
    numbers = [
        Number(_name(d, c), _unit(d, c), float(here[m]), float(wide[m]), slope[m], c[1] not in more)
        for m, c in enumerate(at)
    ]
    labels = [d.machine.log.label_of(name) for name in trial_names]
    return tabled(numbers, evidence, trial_names, labels)


def _values(d: ServoDiagnosis, laws: Sequence[ServoLaw], at: Sequence[Coordinate]) -> np.ndarray:
    """Numbers [M] of laws, as a report has them."""
    out = []
    for joint, name in at:
        law, servo = laws[max(joint, 0)], d.recording.servos[max(joint, 0)]
        stiffness = "damping" if servo.follows_speed else "kp"
        value = float(getattr(law, stiffness if name == "scale" else name))
        if name == "offset":
            value *= law.kp
        out.append(value + servo.armature if name == "rotor" else value)
    return np.array(out)


def _name(d: ServoDiagnosis, at: Coordinate) -> str:
    joint, name = at
    where = "all joints" if joint == SHARED_BY_ALL else d.recording.servos[joint].name
    if name in ("payload", "reach"):
        where = "the hand"
    if name in ("scale", "damping"):
        return f"{'kp' if name == 'scale' else name} at {where}"
    return f"{words(NAMES[name])} {KEYS.get(name, name)} at {where}"


def _unit(d: ServoDiagnosis, at: Coordinate) -> str:
    return unit_of(d.recording.servos[max(at[0], 0)], LAW_UNITS.get(at[1], "1"))
