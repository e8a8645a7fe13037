"""Output-error fit by Levenberg-Marquardt over windows with free initial states.

Every window's initial state is eliminated from the normal equations (variable projection; Golub and Pereyra, 1973),
so a step costs one small system in the shared parameters. A general solver would factor the whole arrow-shaped
Jacobian, or iterate on it; here one forward-mode pass with P + A + S tangents gives all of it, and one compiled program
serves every mask of effects and every weighting of trials.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.kept_programs import kept
from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.sysid.estimate.fit_problem import FitPoint, FitProblem
from adaptsim_jax.sysid.estimate.fit_result import FitResult, fit_result
from adaptsim_jax.sysid.forward import Model, driven, first_angles, measure, trajectory

ROOM = (6, 9, 12, 20)  # effect parameters that a compiled fit has room for: friction and a spring fit the first
Array = Any  # of JAX in a trace, of NumPy outside


class FitSettings(NamedTuple):
    """Traced settings of a fit. `huber` is in weighted residual units (infinite: plain least squares)."""

    iterations: jax.Array | int = 20
    tolerance: jax.Array | float = 1e-6
    huber: jax.Array | float = jnp.inf


class Prior(NamedTuple):
    """Independent Gaussian prior on `[theta | eff]`: `mean [P + E]` and `precision [P + E]` (0: none)."""

    mean: Array
    precision: Array


def least_squares(
    model: Model,
    mask: np.ndarray,
    windows: Windows,
    theta0: np.ndarray,
    eff0: np.ndarray | None = None,
    x0: np.ndarray | None = None,
    *,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
    fixed: tuple[str, ...] = (),
    prior: Prior | None = None,
    trial_weight: np.ndarray | None = None,
    settings: FitSettings | None = None,
) -> FitResult:
    """Fit theta, the parameters of the masked-in effects and all initial states, in float64.

    bounds: `[E]` low and high of the effect parameters (`Layout.bounds`); those with low == high stay, as do names in
    `fixed` (a theta name, or `effect/where/parameter`) and held shapes. trial_weight `[N]`: 0 leaves a trial out of the shared
    parameters, while its initial states are still fitted to it, so that its residual is a held-out one.
    """
    with jax.enable_x64(True):
        problem, start = _problem(model, mask, windows, theta0, eff0, x0, bounds, fixed, prior, trial_weight)
        point, info = _solve(model, problem, start, settings or FitSettings())
        return fit_result(model, problem, jax.tree.map(np.asarray, point), jax.tree.map(np.asarray, info))


def _problem(model, mask, windows, theta0, eff0, x0, bounds, fixed, prior, trial_weight):
    layout, plant = model.layout, model.plant
    eff0 = layout.off() if eff0 is None else np.asarray(eff0, float)
    low, high = (np.full(layout.size, s) for s in (-np.inf, np.inf)) if bounds is None else bounds
    held = layout.vector(lambda p, i: p.held or f"{i.effect.name}/{i.where}/{p.name}" in fixed).astype(bool)
    owner = np.array([k for k, i in enumerate(layout.instances) for _ in i.effect.parameters], int)
    free_eff = np.flatnonzero(np.asarray(mask, bool)[owner] & ~held & (low < high)) if layout.size else np.zeros(0, int)
    if len(free_eff) > ROOM[-1]:
        raise ValueError(f"{len(free_eff)} effect parameters at once; at most {ROOM[-1]} can be fitted")
    room = next(r for r in ROOM if len(free_eff) <= r)
    active = np.concatenate([free_eff, np.full(room - len(free_eff), -1)]).astype(int)
    free = np.array([n not in fixed for n in plant.theta_names]) & (np.asarray(plant.low) < np.asarray(plant.high))
    prior = prior or Prior(np.zeros(len(free) + layout.size), np.zeros(len(free) + layout.size))
    pick = lambda a, b, spare: np.concatenate([a, np.where(active >= 0, np.append(b, spare)[active], spare)])
    trials = windows.trials
    problem = FitProblem(
        windows, np.asarray(mask, bool), free, active,
        pick(np.asarray(plant.low), low, -np.inf), pick(np.asarray(plant.high), high, np.inf),
        np.ones(trials) if trial_weight is None else np.append(trial_weight, np.zeros(trials - len(trial_weight))),
        pick(np.asarray(prior.mean)[: len(free)], np.asarray(prior.mean)[len(free) :], 0.0),
        pick(np.asarray(prior.precision)[: len(free)], np.asarray(prior.precision)[len(free) :], 0.0),
    )  # fmt: skip
    inside = np.clip(eff0, low, high)
    x0 = windows.start if x0 is None else np.asarray(x0)
    return jax.tree.map(
        jnp.asarray, (problem, (np.clip(np.asarray(theta0, float), plant.low, plant.high), inside, x0.T))
    )


def _linearise(model: Model, problem: FitProblem, theta, eff, x0, huber) -> FitPoint:
    """Residual, its derivatives by forward mode, and their inner products per window."""
    windows, sizes = problem.windows, (len(theta), len(problem.active), x0.shape[0])
    weight = jnp.asarray(windows.weight).transpose(1, 2, 0)
    measured = jnp.asarray(windows.measured).transpose(1, 2, 0)

    def simulated(theta, eff, x0):
        on = model.layout.masked(eff, problem.mask)
        drive = driven(model, theta, on, problem.mask, windows)
        x, _ = trajectory(model, theta, on, problem.mask, drive, x0, windows.substeps)
        return weight * measure(model, on, problem.mask, drive.time, x, first_angles(windows, x0), measured.shape[1])

    tangents = _tangents(problem, theta, eff, x0)
    # one pass for the motion and all tangents: a linearised program would be twice the steps, and keep all of them in memory
    along = lambda *way: jax.jvp(simulated, (theta, eff, x0), way)
    y, jac = jax.vmap(along, out_axes=(None, 0))(*tangents)  # jac [P + A + S, L+1, Y, W]
    residual = weight * measured - y
    robust = jnp.minimum(1.0, huber / jnp.maximum(jnp.abs(residual), 1e-12))
    rows = jnp.concatenate([jac, residual[None]]) * jnp.sqrt(robust)[None]
    flat = rows.reshape(sum(sizes) + 1, -1, x0.shape[1]).transpose(2, 0, 1)
    gram = flat @ jnp.swapaxes(flat, 1, 2)
    size = jnp.abs(residual)
    rho = jnp.where(size <= huber, 0.5 * jnp.square(residual), huber * (size - 0.5 * jnp.minimum(huber, 1e150)))
    window_cost = jnp.where(size <= huber, 0.5 * jnp.square(residual), rho).sum((0, 1))
    z = jnp.concatenate([theta, eff[problem.active]])
    prior = 0.5 * jnp.sum(problem.prior_precision * jnp.square(z - problem.prior_mean))
    return FitPoint(theta, eff, x0, residual, jac, gram, window_cost, _total(problem, window_cost) + prior)


def _total(problem: FitProblem, window_cost):
    """Weighted cost. Left-out trials count a little, lest their initial states run away unseen."""
    return jnp.sum(jnp.maximum(problem.trial_weight, 1e-6)[problem.windows.trial] * window_cost)


def _tangents(problem: FitProblem, theta, eff, x0):
    """One-hot tangents `[P + A + S, ...]` of theta, eff and the initial states."""
    p, a, s = len(theta), len(problem.active), x0.shape[0]
    total = p + a + s
    dtheta = jnp.zeros((total, p), theta.dtype).at[jnp.arange(p), jnp.arange(p)].set(problem.free)
    used = (problem.active >= 0).astype(eff.dtype)
    deff = jnp.zeros((total, len(eff)), eff.dtype).at[p + jnp.arange(a), problem.active].set(used)
    dx0 = jnp.zeros((total, *x0.shape), x0.dtype).at[p + a + jnp.arange(s), jnp.arange(s)].set(1.0)
    return dtheta, deff, dx0


def _reduced(problem: FitProblem, point: FitPoint, damping):
    """Normal equations of the shared parameters with initial states eliminated, and what gives those back."""
    g, s = len(problem.low), point.x0.shape[0]
    gram = point.gram
    shared, state = slice(0, g), slice(g, g + s)
    hxx = gram[:, state, state]
    diagonal = jnp.diagonal(hxx, axis1=1, axis2=2)
    diagonal = jnp.where(diagonal > 0, diagonal, 1.0)
    scale = 1.0 / jnp.sqrt(diagonal)
    eye = jnp.eye(s, dtype=hxx.dtype)[None]
    scaled = hxx * scale[:, :, None] * scale[:, None, :] + (damping + 1e-12) * eye
    empty = jnp.diagonal(hxx, axis1=1, axis2=2) <= 0
    scaled = scaled + jnp.where(empty, 1.0, 0.0)[:, :, None] * eye
    right = jnp.concatenate([gram[:, state, shared], gram[:, state, -1:]], 2) * scale[:, :, None]
    back = jnp.linalg.solve(scaled, right) * scale[:, :, None]  # [W, S, G+1]
    full = jnp.concatenate([gram[:, shared, shared], gram[:, shared, -1:]], 2)
    schur = full - gram[:, shared, state] @ back
    return schur, back


def _step(problem: FitProblem, point: FitPoint, damping):
    """Damped Gauss-Newton step of (shared `[G]`, x0 `[S, W]`); parameters pushed against a bound stay there."""
    g, p = len(problem.low), len(point.theta)
    schur, back = _reduced(problem, point, damping)
    weight = problem.trial_weight[problem.windows.trial]
    total = jnp.einsum("w,wij->ij", weight, schur)
    z = jnp.concatenate([point.theta, point.eff[problem.active]])
    hess = total[:, :g] + jnp.diag(problem.prior_precision)
    slope = total[:, g] - problem.prior_precision * (z - problem.prior_mean)
    live = jnp.concatenate([problem.free, problem.active >= 0])
    live = live & ~((z <= problem.low) & (slope < 0)) & ~((z >= problem.high) & (slope > 0))
    step = _solve_scaled(hess, slope, live, damping)
    step = jnp.clip(z + step, problem.low, problem.high) - z
    step = jnp.where(live, step, 0.0)
    dx0 = back[:, :, g] - jnp.einsum("wsg,g->ws", back[:, :, :g], step)
    used = jnp.where(problem.active >= 0, step[p:], 0.0)
    return step[:p], jnp.zeros_like(point.eff).at[problem.active].add(used), dx0.T


def _solve_scaled(hess, slope, live, damping):
    """Solve with unit diagonal, dead entries out and directions without information left alone."""
    diagonal = jnp.where(live & (jnp.diagonal(hess) > 0), jnp.diagonal(hess), 1.0)
    scale = live / jnp.sqrt(diagonal)
    scaled = hess * scale[:, None] * scale[None, :]
    value, vector = jnp.linalg.eigh(0.5 * (scaled + scaled.T))
    kept = jnp.where(value > 1e-11, 1.0 / (jnp.maximum(value, 1e-30) + damping), 0.0)
    return scale * (vector @ (kept * (vector.T @ (scale * slope))))


class _Loop(NamedTuple):
    point: FitPoint
    damping: jax.Array
    iteration: jax.Array
    code: jax.Array  # -1 while running


def _nowhere(problem: FitProblem, theta, eff, x0) -> FitPoint:
    """A point of infinite cost from which the first step is zero: so the loop linearises in one place only, which
    halves the compile time."""
    length, channels = problem.windows.measured.shape[1:]
    count, windows = len(problem.low) + x0.shape[0], x0.shape[1]
    empty = lambda *shape: jnp.zeros(shape, x0.dtype)
    jac, gram = empty(count, length, channels, windows), empty(windows, count + 1, count + 1)
    cost = jnp.asarray(jnp.inf, x0.dtype)
    return FitPoint(theta, eff, x0, empty(length, channels, windows), jac, gram, empty(windows), cost)


@kept(FitPoint)
def _solve(model: Model, problem: FitProblem, start, settings: FitSettings):
    """Levenberg-Marquardt. A trial point is linearised at once, as most steps are taken."""

    def body(loop: _Loop) -> _Loop:
        old = loop.point
        dtheta, deff, dx0 = _step(problem, old, loop.damping)
        new = _linearise(model, problem, old.theta + dtheta, old.eff + deff, old.x0 + dx0, settings.huber)
        good = jnp.isfinite(new.cost) & jnp.isfinite(new.gram).all() & (new.cost <= old.cost)
        fall = old.cost - new.cost
        done = good & jnp.isfinite(old.cost) & (fall <= settings.tolerance * old.cost)
        stuck = ~good & ((loop.damping > 1e6) | ~jnp.isfinite(old.cost))
        point = jax.tree.map(lambda a, b: jnp.where(good, a, b), new, old)
        damping = jnp.where(good, jnp.maximum(loop.damping * 0.1, 1e-9), jnp.maximum(loop.damping * 8.0, 1e-4))
        code = jnp.where(done, 0, jnp.where(stuck, 2, -1))
        return _Loop(point, damping, loop.iteration + 1, code)

    def running(loop: _Loop):
        return (loop.code < 0) & (loop.iteration < settings.iterations)

    nowhere = _nowhere(problem, *start)
    first = _Loop(nowhere, jnp.asarray(1e-3, nowhere.cost.dtype), jnp.asarray(-1), jnp.asarray(-1))
    last = jax.lax.while_loop(running, body, first)
    schur, _ = _reduced(problem, last.point, 0.0)
    code = jnp.where(last.code < 0, 1, jnp.where(jnp.isfinite(last.point.cost), last.code, 3))
    return last.point, (schur, last.iteration, code)
