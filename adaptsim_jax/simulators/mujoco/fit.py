"""Numbers of a model file fitted to a recording by MuJoCo itself: Gauss and Newton's steps with a
free start of each stretch.

Derivatives are central differences of whole simulations, starts are eliminated stretch by stretch
(variable projection; Golub and Pereyra, 1973), intervals come from leaving trials out one by one
(the jackknife).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.diagnosis.steps import CONVERGED_GAIN, Point, best_of, bounded_step, fit_values
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.build import Stepped, stepped
from adaptsim_jax.simulators.mujoco.criteria import SIMULATION
from adaptsim_jax.simulators.mujoco.fields import DELAY, Field, field, with_values
from adaptsim_jax.simulators.mujoco.rollouts import by_start, predict, residual, start_size
from adaptsim_jax.simulators.mujoco.starts import START_DAMPING, fitted
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, cut, late

LINEARISATION_STEPS = 4e6  # steps of one linearisation: bounds its time and memory
MAX_ROUNDS = 10  # rounds of steps of the numbers: bounds the time of a slow fit
FIRST_START_ROUNDS = 8  # rounds of starts before the first step: they begin far off
START_ROUNDS = 2  # rounds of starts after each step: they begin near
EXACT_SQUARE = 1e-16  # mean square of what is left, below which nothing is: double precision
# of weighted residuals and their derivatives: a stretch that runs away says nothing of where to
# go
RUNAWAY_RESIDUAL = 1e9


@dataclass(frozen=True)
class Fitted:
    """names; neutral, value, low, high [P]: as the file has it, fitted, and where it lies with 90
    %; before, after: rms of the weighted residuals with the file's numbers and these; code:
    converged, stopped or stuck.
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
    cost = (1 + start_size(made) + 2 * len(fields)) * horizon / float(made.model.opt.timestep)
    return fitted_values(
        made, cut(made, log, horizon, max(12, int(LINEARISATION_STEPS / cost))), fields
    )


def fitted_values(made: Stepped, stretches: MujocoStretches, fields: Sequence[Field]) -> Fitted:
    """The same of stretches."""
    values = np.array([f.default for f in fields])
    plain = np.ones(stretches.measured.shape[2] - (1 if made.base >= 0 else 0))
    starts, off = fitted(*_at(made, stretches, fields, values), plain, FIRST_START_ROUNDS)
    weight = _weights(off)
    before = _rms(off, weight)

    def around(point: Point) -> Callable[[float], Point]:
        values, starts, _ = point.state
        lin = _linear(made, stretches, fields, values, starts, weight)
        hess, slope = lin.hess.sum(0), lin.slope.sum(0)

        def moved(damping: float) -> Point:
            step = _bounded(hess, slope, fields, values, damping)
            trial = _at(made, stretches, fields, values + step)
            options = (starts + lin.start_steps(step), starts, np.zeros_like(starts))
            return point_of(values + step, *_better(trial, weight, options))

        return moved

    def point_of(values: np.ndarray, starts: np.ndarray, off: np.ndarray) -> Point:
        return Point(_loss(off, weight), (values, starts, off))

    def stuck(point: Point) -> Point | None:
        values, *rest = point.state
        other = point_of(values, *_restarted(_at(made, stretches, fields, values), weight, *rest))
        if point.loss - other.loss >= CONVERGED_GAIN * off.size:
            return other
        return None

    def done(old: Point, new: Point, k: int) -> bool:
        exact = np.median(np.square(new.state[2]).mean((1, 2))) < EXACT_SQUARE
        return bool(exact) or old.loss - new.loss < CONVERGED_GAIN * off.size

    found = fit_values(point_of(values, starts, off), around, MAX_ROUNDS, done=done, stuck=stuck)
    values, starts, left = found.point.state
    lin = _linear(made, stretches, fields, values, starts, weight)
    spread = deviates(len(lin.hess)) * _jackknife(lin, fields, values)
    low, high = (np.array([getattr(f, k) for f in fields]) for k in ("low", "high"))
    bounds = np.maximum(values - spread, low), np.minimum(values + spread, high)
    return Fitted(tuple(fields), values, *bounds, before, _rms(left, weight), found.code)


def _at(
    made: Stepped, stretches: MujocoStretches, fields: Sequence[Field], values: np.ndarray
) -> tuple[Stepped, MujocoStretches]:
    """Model and stretches with these numbers; a delay moves the commands."""
    delay = [float(v) for f, v in zip(fields, values, strict=True) if f.name == DELAY]
    own = [(f, v) for f, v in zip(fields, values, strict=True) if f.name != DELAY]
    if own:
        model = with_values(made.model, [f for f, _ in own], [v for _, v in own])
    else:
        model = made.model
    if delay:
        steps = np.full(stretches.count, delay[0] / float(model.opt.timestep))
        stretches = replace(stretches, control=late(stretches.past, stretches.control, steps))
    return made.with_model(model), stretches


def _weights(off: np.ndarray) -> np.ndarray:
    """[C'] one over the size of each channel's residuals, by medians over stretches; of one that is
    hardly off, of the typical one.
    """
    size = np.median(np.sqrt(np.mean(np.square(off), 1)), 0)
    typical = np.median(size[size > 0]) if np.any(size > 0) else 1e-9
    return 1.0 / np.maximum(size, 0.1 * typical)


def _better(
    trial: tuple[Stepped, MujocoStretches], weight: np.ndarray, options: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(starts, residual) of the options stretch by stretch the better, settled once more."""

    def evaluate(starts: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off = residual(*trial, predict(*trial, starts, lanes), lanes)
        return off, np.square(off * weight).sum((1, 2))

    return fitted(*trial, weight, START_ROUNDS, best_of(options, evaluate).starts)


def _restarted(
    at: tuple[Stepped, MujocoStretches], weight: np.ndarray, starts: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(starts, residual), those of stretches that are nearer when their starts are sought from the
    measured ones again.
    """
    other, new = fitted(*at, weight, FIRST_START_ROUNDS)
    good = _each(new, weight) < _each(off, weight)
    return np.where(good[:, None], other, starts), np.where(good[:, None, None], new, off)


def _each(off: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """[W] mean squares of weighted residuals, with a floor."""
    return np.square(off * weight).mean((1, 2)) + SIMULATION.residual_floor**2


def _loss(off: np.ndarray, weight: np.ndarray) -> float:
    """Each stretch has a spread of its own, so that one whose start is caught at another contact
    does not decide.
    """
    return 0.5 * float(off[0].size * np.log(_each(off, weight)).sum())


def _rms(off: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sqrt(np.median(np.square(off * weight).mean((1, 2)))))


@dataclass(frozen=True)
class _Linear:
    """Weighted residuals [W, R], derivatives by starts [W, R, S] and by the fields [W, R, P], and
    the normal equations of the fields by trial with the starts eliminated: hess [F, P, P], slope
    [F, P]. `good` [W]: stretches that count.
    """

    left: np.ndarray
    by_start: np.ndarray
    by_field: np.ndarray
    hess: np.ndarray
    slope: np.ndarray
    good: np.ndarray

    def start_steps(self, step: np.ndarray) -> np.ndarray:
        """Change of the starts [W, S] that goes with a step [P] of the fields."""
        out = np.zeros((len(self.left), self.by_start.shape[2]))
        free = np.full(out.shape[1], np.inf)
        for w in np.flatnonzero(self.good):
            x, left = self.by_start[w], self.left[w] + self.by_field[w] @ step
            out[w] = bounded_step(x.T @ x, -(x.T @ left), -free, free, START_DAMPING)
        return out


def _linear(made, stretches, fields, values, starts, weight) -> _Linear:
    now = _at(made, stretches, fields, values)
    lanes = np.arange(stretches.count)
    base, by_x = by_start(*now, starts, lanes)
    columns = [_column(made, stretches, fields, values, p, starts) for p in range(len(fields))]
    by_p = np.stack(columns, -1)
    spread = np.sqrt(_each(base, weight))

    def wide(z):
        each = z * weight.reshape(1, 1, -1, *[1] * (z.ndim - 3))
        rows = each.reshape(len(z), -1, *z.shape[3:])
        return rows / spread.reshape(-1, *[1] * (z.ndim - 2))

    r, x, s = wide(base), wide(by_x), wide(by_p)
    largest = [np.abs(z).reshape(len(z), -1).max(1) for z in (r, x, s)]
    good = np.all([size < RUNAWAY_RESIDUAL for size in largest], 0)
    trials = np.unique(stretches.trial)
    hess = np.zeros((len(trials), len(fields), len(fields)))
    slope = np.zeros((len(trials), len(fields)))
    for w in np.flatnonzero(good):
        q, u = np.linalg.qr(x[w] / np.maximum(np.linalg.norm(x[w], axis=0), 1e-12))
        q = q[:, np.abs(np.diagonal(u)) > 1e-7]
        rest = r[w] - q @ (q.T @ r[w])
        own = s[w] - q @ (q.T @ s[w])
        k = int(np.searchsorted(trials, stretches.trial[w]))
        hess[k] += own.T @ own
        slope[k] -= own.T @ rest  # the derivative is of what is left
    return _Linear(r, x, s, hess, slope, good)


def _column(made, stretches, fields, values, p: int, starts) -> np.ndarray:
    """Derivative [W, L, C'] of what is left by one field: a central difference, one-sided at a
    bound.
    """
    f, lanes = fields[p], np.arange(stretches.count)
    ends = []
    for way in (1.0, -1.0):
        moved = values.copy()
        moved[p] = np.clip(values[p] + way * f.step, f.low, f.high)
        at = _at(made, stretches, fields, moved)
        ends.append((moved[p], residual(*at, predict(*at, starts, lanes), lanes)))
    (high, above), (low, below) = ends
    return (above - below) / (high - low)


def _bounded(hess, slope, fields, values, damping) -> np.ndarray:
    """Damped step [P] within the bounds."""
    low, high = (np.array([getattr(f, k) for f in fields]) for k in ("low", "high"))
    return bounded_step(hess, slope, low - values, high - values, damping)


def _jackknife(lin: _Linear, fields, values) -> np.ndarray:
    """Standard deviation [P] of the values, by leaving out one trial at a time (one linear step
    each).
    """
    count = len(lin.hess)
    if count < 2:
        return np.full(len(fields), np.nan)
    hess, slope = lin.hess.sum(0), lin.slope.sum(0)
    moves = [
        _bounded(hess - lin.hess[k], slope - lin.slope[k], fields, values, 0.0)
        for k in range(count)
    ]
    return jackknife(np.stack(moves))
