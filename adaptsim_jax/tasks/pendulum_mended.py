"""The pendulum task on a mended model: the same swing-up and cost, with the effects of a `model.toml` in the simulator.

Omega has the declared parameters and the effects' amplitudes, each around its fitted value. The policy is an LQR that
knows the effects: gains of the model linearized with them along its own motion, a constant torque where they push one
way, cancellation of the modelled force, and prediction across a late command. Which of these pays is tried in the
model.

The reward is 1 at the reference's cost. Of a linearized model that is the cost of the target's own policy, which no
other beats by much. Of a rigid body it is not: a gain that is optimal near the goal is far from the best for a swing-up
from hanging, and policies trained at other parameters cost less in half of the cases. There the reference is the
cheapest of the target's own policy and of those of `SPREAD` points of Omega; rewards above 1 still occur, but are rare.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats.qmc import Sobol

from adaptsim_jax.control.riccati import solve_care
from adaptsim_jax.control.small_matrix import mm, solve, transpose
from adaptsim_jax.models.closed_loop import Loop, broadcasts, group_delay, history_rows, run_loop, sensed
from adaptsim_jax.models.model_file import ModelFile, model_of, read_model
from adaptsim_jax.models.pendulum_linear import HORIZON, SAMPLES, SNAPSHOTS, transition
from adaptsim_jax.models.stepping import Model, acting, make_model
from adaptsim_jax.space import Parameter, Space, gaussian
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pendulum import SETTINGS, PendulumTrajectory, _paper_scaling

ROWS = 500  # a command is held for 5 ms
DT = HORIZON / ROWS
COST_CEILING = 1e9
SPREAD = 16  # points of Omega whose policies a rigid body's reference is the best of
SLIDING = 0.05  # rad/s: where the policy takes a joint to slide


class MendedPolicy(NamedTuple):
    """gain `[2, 4]` and constant torque feed `[2]` N m; share `[]` of the modelled force that is cancelled; phi `[4, 4]`,
    gamma `[4, 2]`, recent `[H]`: the state when a command arrives, from now's and the mean of recent commands; zero
    `[2]` rad: error of the encoders; theta, eff: the model that it was trained on; code: the Riccati solver's."""

    gain: jax.Array
    feed: jax.Array
    share: jax.Array
    phi: jax.Array
    gamma: jax.Array
    recent: jax.Array
    zero: jax.Array
    theta: jax.Array
    eff: jax.Array
    code: jax.Array


@dataclass(frozen=True)
class World:
    """A mended model as a simulator of the task. goal, start: `[4]`; history: rows that its effects remember."""

    model: Model
    goal: np.ndarray
    start: np.ndarray
    history: int

    def rollout(self, policy: MendedPolicy, theta, eff) -> tuple[PendulumTrajectory, Loop]:
        """The task's trajectory under a policy, and all of it."""
        law = lambda y, past, t: command(self, policy, y, past, t)
        loop = run_loop(self.model, theta, eff, law, jnp.asarray(self.start, jnp.float32), ROWS, DT, self.history)
        return self.judged(loop), loop

    @broadcasts
    def judged(self, loop: Loop) -> PendulumTrajectory:
        """Angles from the goal at the task's samples, and the cost on the scale of its 1000 samples."""
        gap = loop.state - jnp.asarray(self.goal, jnp.float32)[None]
        cost = (SAMPLES / ROWS) * (jnp.sum(jnp.square(gap)) + jnp.sum(jnp.square(loop.command)))
        at = np.round(np.asarray(SNAPSHOTS) * ROWS / (SAMPLES - 1)).astype(int)
        angles = gap[at, :2]
        fine = jnp.isfinite(cost) & (cost < COST_CEILING) & jnp.all(jnp.isfinite(angles))
        angles = jnp.where(fine, angles, 0.0)
        return PendulumTrajectory(angles, jnp.where(fine, cost, COST_CEILING), jnp.where(fine, 0, 2).astype(jnp.int32))


def make_world(given: ModelFile, largest: np.ndarray | None = None, history: int = 2) -> World:
    """The simulator of a mended model; `largest`: effect parameters `[E]` at which its memory is measured."""
    names = [name for name, _ in given.active]
    effects = tuple(given.effect(n) for n in dict.fromkeys(names))
    model = make_model(given.plant(), effects)
    up = 0.0 if given.angle_zero == "upright" else np.pi
    goal = np.array([up, 0.0, 0.0, 0.0])
    largest = given.effect_vector(model.layout) if largest is None else largest
    rows = max(history, history_rows(model, np.asarray(largest, float), DT))
    return World(model, goal, goal - [np.pi, 0.0, 0.0, 0.0], rows)


@broadcasts
def command(world: World, policy: MendedPolicy, y, past, t) -> jax.Array:
    """Torque `[2]` N m of a policy that sees `y: [4]` and its own `past: [H, 2]` commands (the newest last)."""
    n = world.model.plant.joint_dim
    gap = y - jnp.asarray(world.goal, y.dtype) - jnp.concatenate([policy.zero, jnp.zeros(n, y.dtype)])
    gap = policy.phi @ gap + policy.gamma @ (policy.recent @ past[::-1])
    u = -policy.gain @ gap - policy.feed
    x = (gap + jnp.asarray(world.goal, y.dtype))[:, None]
    force = modelled_force(world.model, policy.theta, policy.eff, x, u[:, None], t[None])[:, 0]
    wanted = u - force
    return u + policy.share * (_inverse(world.model, policy.eff, wanted) - u)


@broadcasts
def modelled_force(model: Model, theta, eff, x, u, t) -> jax.Array:
    """Force of all force effects `[n, T]` at states `x: [S, T]`, dry friction by a smooth sign."""
    n = model.plant.joint_dim
    way = jnp.tanh(x[n:] / SLIDING)
    memory = tuple(way for e in model.layout.placed("force") if e.memory)
    act = acting(model, theta, eff, memory, x, u, t)
    return act.force - act.level * way


@broadcasts
def _static(model: Model, eff, u) -> jax.Array:
    """Command effects that do not remember, on `u: [T, U]`."""
    t = DT * jnp.arange(u.shape[0], dtype=u.dtype)[:, None, None]
    u = u[:, :, None]
    for effect in model.layout.placed("command"):
        if not _remembers(effect):
            u = effect.apply({k: v[None] for k, v in model.layout.params(effect, eff, 1).items()}, t, u)
    return u[:, :, 0]


def _remembers(effect) -> bool:
    return any(p.unit == "s" for p in effect.parameters)


def _inverse(model: Model, eff, wanted) -> jax.Array:
    """The command after which the static command effects give `wanted: [U]`, by a few fixed-point steps."""
    u = wanted
    for _ in range(3):
        u = u + wanted - _static(model, eff, u[None])[0]
    return u


class Affine(NamedTuple):
    """Forces taken as `slope_q q + slope_v v + push` from the goal, and commands as `1 + gain` of themselves; `[n]`."""

    slope_q: jax.Array
    slope_v: jax.Array
    push: jax.Array
    gain: jax.Array


@broadcasts
def along(world: World, theta, eff, loop: Loop) -> Affine:
    """The effects' best affine stand-in along a motion (least squares; statistical linearization)."""
    model, n = world.model, world.model.plant.joint_dim
    gap = jnp.clip(loop.state - jnp.asarray(world.goal, loop.state.dtype), -20.0, 20.0)
    x = (gap + jnp.asarray(world.goal, gap.dtype)).T
    u = jnp.clip(loop.command, -1e4, 1e4)
    t = DT * jnp.arange(ROWS, dtype=x.dtype)
    force = modelled_force(model, theta, eff, x, u.T, t)
    change = _static(model, eff, u) - u
    fits = []
    for j in range(n):
        design = jnp.stack([gap[:, j], gap[:, n + j], jnp.ones(ROWS)], 1)
        normal = design.T @ design
        normal = normal + jnp.diag(1e-4 * jnp.diag(normal) + 1e-6)
        fits.append(solve(normal, (design.T @ force[j])[:, None])[:, 0])
    a, b, c = jnp.stack(fits, 1)
    share = jnp.sum(change * u, 0) / (jnp.sum(u * u, 0) + 1e-9)
    return Affine(a, b, c, jnp.maximum(share, -0.9))


@broadcasts
def lqr(world: World, theta, eff, affine: Affine) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]:
    """Optimal gain `[2, 4]` and constant torque `[2]` of the model with affine forces, with its A, B and Riccati code."""
    model, n = world.model, world.model.plant.joint_dim
    goal = jnp.asarray(world.goal, jnp.float32)
    zeros = jnp.zeros((n, 1))
    memory = tuple(zeros for e in model.layout.placed("force") if e.memory)
    inertia = acting(model, theta, eff, memory, goal[:, None], zeros, jnp.zeros(1)).inertia

    def deriv(gap, u):
        force = affine.slope_q * gap[:n] + affine.slope_v * gap[n:] + affine.push
        arrives = (1.0 + affine.gain) * u
        return model.plant.deriv(theta, (goal + gap)[:, None], arrives[:, None], force[:, None], inertia)[:, 0]

    x, u = jnp.zeros(4), jnp.zeros(n)
    A, B = jax.jacfwd(deriv, (0, 1))(x, u)
    P, _, code = solve_care(A, B, jnp.eye(4), jnp.eye(n))
    gain = mm(transpose(B), P)
    drift = deriv(x, u)[:, None]
    s = -solve(transpose(A - mm(B, gain)), mm(P, drift))
    return gain, mm(transpose(B), s)[:, 0], A, B, code


def plain_policy(world: World, theta, eff) -> MendedPolicy:
    """The LQR of the declared part alone: it knows nothing of the effects (but of added inertia)."""
    n, rows = world.model.plant.joint_dim, world.history
    nothing = Affine(*(jnp.zeros(n) for _ in range(4)))
    gain, _, _, _, code = lqr(world, theta, eff, nothing)
    return MendedPolicy(
        gain, jnp.zeros(n), jnp.zeros(()), jnp.eye(4), jnp.zeros((4, n)), jnp.zeros(rows), jnp.zeros(n),
        jnp.asarray(theta, jnp.float32), jnp.asarray(eff, jnp.float32), code,
    )  # fmt: skip


@broadcasts
def train_policy(world: World, theta, eff) -> MendedPolicy:
    """The cheapest in the model of: knowing nothing, affine stand-ins, cancelling half or all; each with prediction too."""
    plain = plain_policy(world, theta, eff)
    if not world.model.layout.instances:
        return plain
    known = _with_zero(world, plain)
    _, loop = world.rollout(known, theta, eff)
    gain, feed, A, B, code = lqr(world, theta, eff, along(world, theta, eff, loop))
    fitted = known._replace(gain=gain, feed=feed, code=code)
    tried = [plain, known, fitted, known._replace(share=jnp.float32(0.5)), known._replace(share=jnp.float32(1.0))]
    if any(_remembers(e) for e in world.model.layout.effects if e.place != "force"):
        tried += [_ahead(world, policy, A, B) for policy in tried[1:]]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tried)
    cost = jax.vmap(lambda p: world.rollout(p, theta, eff)[0].cost)(stacked)
    return jax.tree.map(lambda leaf: leaf[jnp.argmin(cost)], stacked)


def _with_zero(world: World, policy: MendedPolicy) -> MendedPolicy:
    """The same, reading its encoders as the model says they err."""
    n = world.model.plant.joint_dim
    still = jnp.zeros((2, 2 * n))
    said = sensed(world.model, policy.eff, still, jnp.zeros(n), DT)
    return policy._replace(zero=said[:n])


@broadcasts
def _ahead(world: World, policy: MendedPolicy, A, B) -> MendedPolicy:
    """The same, acting on where the state will be when its command arrives (a predictor for a late input)."""
    late = group_delay(world.model, policy.eff, DT) + _sensor_delay(world, policy.eff)
    n = B.shape[1]
    both = jnp.zeros((4 + n, 4 + n)).at[:4, :4].set(A).at[:4, 4:].set(B)
    power = transition(both, late)
    weight = jnp.clip(late / DT - jnp.arange(world.history, dtype=A.dtype), 0.0, 1.0)
    recent = weight / jnp.maximum(jnp.sum(weight), 1e-9)
    return policy._replace(phi=power[:4, :4], gamma=power[:4, 4:], recent=recent)


@broadcasts
def _sensor_delay(world: World, eff) -> jax.Array:
    """Sum of the time constants of the sensors, the later joint's."""
    layout, total = world.model.layout, jnp.zeros(world.model.plant.joint_dim)
    for effect in layout.placed("measurement"):
        for p in effect.parameters:
            if p.unit == "s":
                total = total + layout.params(effect, eff, 0)[p.name]
    return jnp.max(total)


# --- the task -------------------------------------------------------------------------------------------------------
def mended_space(given: ModelFile) -> tuple[Space, list[tuple[str, ...]]]:
    """Omega around a mended model, and what each parameter is: `(theta,)` or `(effect, where, parameter)`."""
    plant = given.plant()
    parameters, keys = [], []
    for name, low, high in zip(plant.theta_names, plant.low, plant.high, strict=True):
        fitted = given.declared[name]
        damping = name.startswith("b")
        share = 0.5 if damping or given.model == "linearized" else 0.1  # rigid moments only make sense together
        half = max(share * abs(fitted.value), 0.05 if damping else 1e-3)
        ends = max(fitted.value - half, 0.0 if damping else low), fitted.value + half
        parameters.append(
            Parameter(name, *ends, fitted.unit, physical_low=min(low, ends[0]), physical_high=max(high, ends[1]))
        )
        keys.append((name,))
    for e in given.effects:
        effect = given.effect(e.name)
        for p in effect.amplitudes:
            v = e.parameters[p.name]
            half = max(0.5 * abs(v.value), v.high - v.low, 1e-3)
            low = max(v.value - half, 0.0) if p.sign > 0 else v.value - half
            inside = 0.0 if p.sign > 0 else -np.inf
            parameters.append(
                Parameter(f"{e.name}_{e.where}_{p.name}", low, v.value + half, p.unit, physical_low=inside)
            )
            keys.append((e.name, e.where, p.name))
    return Space(tuple(parameters)), keys


def make_mended_pendulum(source: str | Path | Mapping[str, Any] | ModelFile, reward_gain: float = 10.0) -> Task:
    """The pendulum task on the mended model of a `model.toml` (or its table): Phase 1 and 2 take it as any other.

    Raises BadInput where the file is no model.
    """
    given = _given(source)
    space, keys = mended_space(given)
    top = [p.high for p in space.parameters]
    split = _splitter(given, keys)
    world = make_world(given, np.asarray(split(np.asarray(top))[1]))

    def train(key, dist, policy):
        return train_policy(world, *split(space.physical(dist.mean)))

    def rollout(key, policy, params):
        return world.rollout(policy, *split(params))[0]

    def own(params):
        theta, eff = split(params)
        return world.rollout(train_policy(world, theta, eff), theta, eff)[0].cost

    def reference(params):
        return (
            own(params)
            if given.model == "linearized"
            else jnp.minimum(own(params), cheapest(space, train, rollout, params))
        )

    fitted = {p.name: _fitted(given, key) for p, key in zip(space.parameters, keys, strict=True)}
    settings = {"fitted": fitted}
    if given.model == "linearized":
        settings |= {name: fitted | dict(table) for name, table in SETTINGS.items()}
    empty = jax.eval_shape(lambda: train_policy(world, *split(jnp.asarray(list(fitted.values()), jnp.float32))))
    return Task(
        name="pendulum", space=space, targets=space, obs_dim=24, settings=settings,
        init_policy=lambda key: jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), empty),
        train=train, rollout=rollout, observe=_paper_scaling, score=lambda trajectory: -trajectory.cost,
        reference=reference, reward=lambda trajectory, best: 1.0 - reward_gain * (trajectory.cost / best - 1.0),
    )  # fmt: skip


def cheapest(space: Space, train, rollout, params) -> jax.Array:
    """Least cost `[]` at `params` of the policies of `SPREAD` points of Omega; they are the same for all `params`."""
    points = jnp.asarray(Sobol(space.dim, rng=0).random(SPREAD), jnp.float32)
    policies = jax.vmap(lambda u: train(None, gaussian(space, u), None))(points)
    return jnp.min(jax.vmap(lambda policy: rollout(None, policy, params).cost)(policies))


def _given(source) -> ModelFile:
    if isinstance(source, ModelFile):
        return source
    return model_of(source, "model.toml") if isinstance(source, Mapping) else read_model(source)


def _fitted(given: ModelFile, key: tuple[str, ...]) -> float:
    if len(key) == 1:
        return given.declared[key[0]].value
    return next(e.parameters[key[2]].value for e in given.effects if (e.name, e.where) == key[:2])


def _splitter(given: ModelFile, keys):
    """From task parameters `[D]` to theta `[P]` and effect parameters `[E]`; shapes stay as they were fitted."""
    names = dict.fromkeys(name for name, _ in given.active)
    layout = make_model(given.plant(), tuple(given.effect(n) for n in names)).layout
    base = np.asarray(given.effect_vector(layout), np.float32)
    every = layout.names()
    at = np.array([every.index(key) for key in keys if len(key) == 3], int)
    count = sum(len(key) == 1 for key in keys)

    def split(params):
        params = jnp.asarray(params, jnp.float32)
        return params[:count], jnp.asarray(base).at[at].set(params[count:]) if len(at) else jnp.asarray(base)

    return split
