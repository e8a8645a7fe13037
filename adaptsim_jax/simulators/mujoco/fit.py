"""Numbers of a model file fitted to a recording by MuJoCo itself, as a diagnosis fits what it
declares.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.diagnosis.fit import completed, reached
from adaptsim_jax.diagnosis.models import Model, by_fold
from adaptsim_jax.diagnosis.starts import problem_of
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.build import stepped
from adaptsim_jax.simulators.mujoco.diagnosed import simulated
from adaptsim_jax.simulators.mujoco.fields import Field, field

MAX_ROUNDS = 10  # rounds of steps of the numbers: bounds the time of a slow fit


@dataclass(frozen=True)
class Fitted:
    """value, low, high [P]: the fields' numbers as fitted, and where each lies with 90 %; before,
    after: median over stretches of the RMS residual over the noise, with the file's numbers and
    with these; code: converged, stopped or stuck.
    """

    fields: tuple[Field, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    before: float
    after: float
    code: str

    def as_dict(self) -> dict[str, dict[str, float]]:
        """By name: value, low, high, file."""
        fitted = zip(self.fields, self.value, self.low, self.high, strict=True)
        return {
            f.name: {"value": float(v), "low": float(a), "high": float(b), "file": f.default}
            for f, v, a, b in fitted
        }


def fit(source: Source, log: Log, names: Sequence[str], horizon: float = 0.5) -> Fitted:
    """Fit numbers of a model file, named as `fields` has them, to a recording.

    Raises BadInput where a name is none of the model's, or the recording cannot be read so.
    """
    made = stepped(source, log)
    fields = tuple(field(made.model, name) for name in names)
    problem = problem_of(simulated(made, log, fields, tuple(names), horizon))

    def left(values: np.ndarray) -> float:
        off = np.square(problem.residuals(np.tile(values, (len(problem.trials), 1)))).sum(1)
        return float(np.sqrt(np.median(off / problem.weight**2 / problem.counts)))

    before = left(problem.neutral)
    begun = reached(problem, names, problem.neutral, MAX_ROUNDS)
    problem.anew(begun.point.state[0])  # with other numbers other starts are nearer
    again = reached(problem, names, begun.point.state[0], MAX_ROUNDS)
    values, _ = again.point.state
    code = "converged" if begun.code == "converged" else again.code
    folds = by_fold(problem, Model((), completed(problem, names, values)))
    spread = deviates(len(folds)) * jackknife(folds)
    low, high = np.array([(f.low, f.high) for f in fields]).T
    ends = np.maximum(values - spread, low), np.minimum(values + spread, high)
    return Fitted(fields, values, *ends, before, left(values), code)
