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
from adaptsim_jax.simulators.mujoco.build import make_stepped_model
from adaptsim_jax.simulators.mujoco.diagnosed import simulated
from adaptsim_jax.simulators.mujoco.fields import ModelNumber, model_number

MAX_ROUNDS = 10  # rounds of steps of the numbers: bounds the time of a slow fit


@dataclass(frozen=True)
class FileFit:
    """Numbers fitted to a recording: value, low, high [P] as fitted, with 90 % intervals; before,
    after: median over stretches of the RMS residual over the noise, with the file's numbers and
    with these; code: converged, stopped or stuck.
    """

    fields: tuple[ModelNumber, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    before: float
    after: float
    code: str

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return value, low, high and the file's value by name."""
        fitted = zip(self.fields, self.value, self.low, self.high, strict=True)
        return {
            f.name: {"value": float(v), "low": float(a), "high": float(b), "file": f.default}
            for f, v, a, b in fitted
        }


def fit(source: Source, log: Log, names: Sequence[str], horizon: float = 0.5) -> FileFit:
    """Fit numbers of a model file, named as `fields` has them, to a recording.

    Raises BadInput where a name is none of the model's, or the recording cannot be read so.
    """
    stepped_model = make_stepped_model(source, log)
    fields = tuple(model_number(stepped_model.model, name) for name in names)
    problem = problem_of(simulated(stepped_model, log, fields, tuple(names), horizon))

    def median_residual(values: np.ndarray) -> float:
        squares = np.square(problem.residuals(np.tile(values, (len(problem.trials), 1)))).sum(1)
        return float(np.sqrt(np.median(squares / problem.weight**2 / problem.counts)))

    before = median_residual(problem.neutral)
    first = reached(problem, names, problem.neutral, MAX_ROUNDS)
    problem.anew(first.point.state[0])  # with other numbers other starts are nearer
    second = reached(problem, names, first.point.state[0], MAX_ROUNDS)
    values, _ = second.point.state
    code = "converged" if first.code == "converged" else second.code
    folds = by_fold(problem, Model((), completed(problem, names, values)))
    spread = deviates(len(folds)) * jackknife(folds)
    low, high = np.array([(f.low, f.high) for f in fields]).T
    ends = np.maximum(values - spread, low), np.minimum(values + spread, high)
    return FileFit(fields, values, *ends, before, median_residual(values), code)
