"""One model of a problem refitted under a residual covariance, and its linearisation in rows of averaged samples."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.generic_forces import generic_forces
from adaptsim_jax.sysid.estimate.gls import LEAST, Point, Refit, refit
from adaptsim_jax.sysid.estimate.linearize import Path, signatures
from adaptsim_jax.sysid.estimate.problem import DIVERGED, Active, Diverged, Problem, at_point
from adaptsim_jax.sysid.estimate.variance import Linearised


@dataclass(frozen=True)
class Candidate:
    """A model with some effects, refitted under a residual covariance. theta `[P]`, eff `[E]`, names of `refit.point.z`."""

    active: Active
    theta: np.ndarray
    eff: np.ndarray
    names: tuple[str, ...]
    refit: Refit
    phases: int = 0  # phases of trials that its effects use, beside what is in `names`

    @property
    def cost(self) -> float:
        return float(self.refit.cost.sum())

    def parameters(self, effect: str, where: str) -> dict[str, tuple[float, float]]:
        """Fitted values of one effect and their standard errors."""
        found = {}
        for i, name in enumerate(self.names):
            if name.startswith(f"{effect}/{where}/"):
                found[name.split("/")[2]] = (self.refit.point.z[i], float(np.sqrt(self.refit.covariance[i, i])))
        return found


def refit_from(
    problem: Problem, active: Active, first: FitResult, factor: np.ndarray, *, iterations: int = 10
) -> Candidate:
    """Refit declared parameters and the active effects' parameters under the covariance behind `factor`, from where a fit of those
    effects ended. Raises `Diverged` where it ran away."""
    if first.code == DIVERGED:
        raise Diverged(f"the model with {active} runs away from where its refit starts")
    return _refit(problem, active, first.names, first.theta, first.eff, first.x0, first, factor, None, iterations)


def refit_more(
    problem: Problem, start: Candidate, factor: np.ndarray, *, keep: np.ndarray | None = None, iterations: int = 2
) -> Candidate:
    """Refit a candidate from where it stands, under another covariance or on other windows (`keep [W]`)."""
    known, x0, damping = start.refit.linearised, start.refit.point.x0, start.refit.damping
    return _refit(
        problem, start.active, start.names, start.theta, start.eff, x0, known, factor, keep, iterations, damping
    )


def _refit(
    problem, active, names, theta, eff, x0, known: FitResult | Linearised, factor, keep, iterations, damping=LEAST
) -> Candidate:
    split = _Split(problem, names, theta, eff)

    def linearise(point: Point) -> Linearised:
        result = at_point(problem, active, *split.full(point.z), point.x0)
        return compressed(problem, linearised(problem, result))

    if isinstance(known, FitResult):
        known = compressed(problem, linearised(problem, known))
    start = Point(split.pick(theta, eff), x0)
    free = np.ones(len(names), bool)
    told = {"keep": keep, "iterations": iterations, "known": known, "damping": damping, "slow": split.slow}
    done = refit(linearise, start, factor, *split.bounds(), free, **told)
    return Candidate(active, *split.full(done.point.z), names, done, problem.phases(active))


class _Split:
    """Between the flat vector of what is fitted and the full theta and effect vectors."""

    def __init__(self, problem: Problem, names: tuple[str, ...], theta: np.ndarray, eff: np.ndarray):
        plant, layout = problem.plant, problem.model.layout
        every = list(plant.theta_names) + ["/".join(n) for n in layout.names()]
        self.index = np.array([every.index(n) for n in names], int)
        self.base = np.concatenate([theta, eff]).astype(float)
        self.cut = len(plant.theta_names)
        self.low = np.concatenate([plant.low, problem.bounds[0]])[self.index]
        self.high = np.concatenate([plant.high, problem.bounds[1]])[self.index]
        flat = layout.vector(lambda p, i: p.late and p.default == p.low).astype(bool)  # sharp is where it has no slope
        self.slow = np.concatenate([np.zeros(self.cut, bool), flat])[self.index]

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.low, self.high

    def pick(self, theta: np.ndarray, eff: np.ndarray) -> np.ndarray:
        return np.concatenate([theta, eff])[self.index]

    def full(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        both = self.base.copy()
        both[self.index] = z
        return both[: self.cut], both[self.cut :]


def linearised(problem: Problem, result: FitResult, impulse: np.ndarray | None = None) -> Linearised:
    """Rows of one fit result without candidates."""
    windows = problem.windows
    count, length, channels = windows.measured.shape
    rows = length * channels
    residual = result.residual.reshape(count, rows)
    return Linearised(
        residual=np.full_like(residual, np.inf) if result.code == DIVERGED else residual,
        jac_state=result.jac_state,
        jac_theta=result.jac_shared,
        atoms=np.zeros((count, rows, 0)),
        impulse=np.zeros((count, rows, problem.plant.joint_dim, 0)) if impulse is None else impulse,
        dt=windows.dt,
        channel=np.tile(np.arange(channels), length),
        trial=np.asarray(windows.trial),
        used=np.asarray(windows.weight).reshape(count, rows) > 0,
    )


def compressed(problem: Problem, lin: Linearised) -> Linearised:
    """Average neighbouring rows of each channel: motions are slow against rows, and covariances shrink by the square."""
    group = problem.rows_merged
    if group == 1:
        return lin
    channels = problem.windows.measured.shape[2]
    length = lin.residual.shape[1] // channels
    blocks = -(-length // group)

    def pool(z: np.ndarray) -> np.ndarray:
        z = np.asarray(z, float).reshape(z.shape[0], length, channels, -1)
        z = np.concatenate([z, np.zeros((z.shape[0], blocks * group - length, *z.shape[2:]))], 1)
        return z.reshape(z.shape[0], blocks, group, *z.shape[2:]).sum(2).reshape(z.shape[0], blocks * channels, -1)

    used = pool(lin.used[..., None])[..., 0]
    scale = 1.0 / np.sqrt(np.maximum(used, 1.0))

    def mean(z: np.ndarray) -> np.ndarray:
        out = pool(z) * scale[..., None]
        return out.reshape(*out.shape[:2], *z.shape[2:])

    return replace(
        lin, residual=mean(lin.residual[..., None])[..., 0], jac_state=mean(lin.jac_state), jac_theta=mean(lin.jac_theta),
        atoms=mean(lin.atoms), impulse=mean(lin.impulse), channel=np.tile(np.arange(channels), blocks), used=used > 0,
    )  # fmt: skip


def survey(
    problem: Problem, active: Active, theta: np.ndarray, eff: np.ndarray, x0: np.ndarray, *, candidates: bool = True
) -> tuple[tuple[Atom, ...], Linearised, Path, FitResult]:
    """Signatures of every candidate and of the generic dictionary about one model, rows compressed; without `candidates` the
    linearisation and the path alone."""
    result = at_point(problem, active, theta, eff, x0)
    return *surveyed(problem, result, candidates=candidates), result


def surveyed(
    problem: Problem, result: FitResult, *, candidates: bool = True
) -> tuple[tuple[Atom, ...], Linearised, Path]:
    """The same about a fit, where it ended."""
    effects, basis = (None, generic_forces) if candidates else ((), None)
    compress = partial(compressed, problem)
    seen = signatures(
        problem.model, result, problem.windows, problem.reach, effects=effects, basis=basis, compress=compress
    )
    return seen.atoms, seen.lin, seen.path
