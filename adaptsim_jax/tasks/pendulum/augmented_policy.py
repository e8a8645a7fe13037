"""Policies for the pendulum's task on a mended model, and the simulator that they are tried in.

The policy is an LQR that knows the effects: gains of the model linearized with them along its own
motion (statistical linearization), a constant torque where they push one way, cancellation of the
modelled force, and prediction across a late command. Which of these pays is tried in the model.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.control.riccati import solve_care
from adaptsim_jax.control.small_matrix import mm, solve, transpose
from adaptsim_jax.mechanisms.closed_loop import (
    Course,
    Loop,
    broadcasts,
    group_delay,
    history_rows,
    run_loop,
    sensed,
)
from adaptsim_jax.mechanisms.double_pendulum.linear import HORIZON, SAMPLES, SNAPSHOTS, transition
from adaptsim_jax.mechanisms.stepping import Instant, PlantModel, Sample, acting, make_model
from adaptsim_jax.mend.pendulum_model import ModelFile
from adaptsim_jax.tasks.pendulum.task import PendulumTrajectory

ROWS = 500  # a command is held for 5 ms
DT = HORIZON / ROWS
COST_CEILING = 1e9
SLIDING = 0.05  # rad/s: where the policy takes a joint to slide


class MendedPolicy(NamedTuple):
    """gain `[2, 4]` and constant torque feed `[2]` N m; share `[]` of the modelled force that is
    cancelled. phi `[4, 4]`, gamma `[4, 2]`, recent `[H]`: The state when a command arrives, from
    now's and the mean of recent commands; zero `[2]` rad: error of the encoders; theta, eff: the
    model that it was trained on. code: The Riccati solver's.
    """

    gain: Array
    feed: Array
    share: Array
    phi: Array
    gamma: Array
    recent: Array
    zero: Array
    theta: Array
    eff: Array
    code: Array


@dataclass(frozen=True)
class MendedWorld:
    """A mended model as a simulator of the task. goal, start: `[4]`. history: Rows that its effects
    remember.
    """

    model: PlantModel
    goal: np.ndarray
    start: np.ndarray
    history: int

    def rollout(self, policy: MendedPolicy, theta, eff) -> tuple[PendulumTrajectory, Loop]:
        """The task's trajectory under a policy, and all of it."""

        def law(y, past, t):
            return command(self, policy, y, past, t)

        sample = Sample(self.model, theta, eff)
        start = jnp.asarray(self.start, jnp.float32)
        loop = run_loop(sample, law, start, Course(ROWS, DT, self.history))
        return self.evaluated(loop), loop

    @broadcasts
    def evaluated(self, loop: Loop) -> PendulumTrajectory:
        """Angles from the goal at the task's samples, and the cost on the scale of its 1000
        samples.
        """
        gap = loop.state - jnp.asarray(self.goal, jnp.float32)[None]
        cost = (SAMPLES / ROWS) * (jnp.sum(jnp.square(gap)) + jnp.sum(jnp.square(loop.command)))
        at = np.round(np.asarray(SNAPSHOTS) * ROWS / (SAMPLES - 1)).astype(int)
        angles = gap[at, :2]
        fine = jnp.isfinite(cost) & (cost < COST_CEILING) & jnp.all(jnp.isfinite(angles))
        angles = jnp.where(fine, angles, 0.0)
        return PendulumTrajectory(
            angles, jnp.where(fine, cost, COST_CEILING), jnp.where(fine, 0, 2).astype(jnp.int32)
        )


def make_world(
    given: ModelFile, largest: np.ndarray | None = None, history: int = 2
) -> MendedWorld:
    """The simulator of a mended model; `largest`: effect parameters `[E]` at which its memory is
    measured.
    """
    names = [name for name, _ in given.active]
    effects = tuple(given.effect(n) for n in dict.fromkeys(names))
    model = make_model(given.plant(), effects)
    up = 0.0 if given.angle_zero == "upright" else np.pi
    goal = np.array([up, 0.0, 0.0, 0.0])
    if largest is None:
        largest = given.effect_vector(model.layout)
    rows = max(history, history_rows(model, np.asarray(largest, float), DT))
    return MendedWorld(model, goal, goal - [np.pi, 0.0, 0.0, 0.0], rows)


@broadcasts
def command(world: MendedWorld, policy: MendedPolicy, y, past, t) -> Array:
    """Torque `[2]` N m of a policy that sees `y: [4]` and its own `past: [H, 2]` commands (the
    newest last).
    """
    n = world.model.plant.joint_dim
    gap = (
        y - jnp.asarray(world.goal, y.dtype) - jnp.concatenate([policy.zero, jnp.zeros(n, y.dtype)])
    )
    gap = policy.phi @ gap + policy.gamma @ (policy.recent @ past[::-1])
    u = -policy.gain @ gap - policy.feed
    x = (gap + jnp.asarray(world.goal, y.dtype))[:, None]
    force = modelled_force(world.model, policy.theta, policy.eff, x, u[:, None], t[None])[:, 0]
    wanted = u - force
    return u + policy.share * (_inverse(world.model, policy.eff, wanted) - u)


@broadcasts
def modelled_force(model: PlantModel, theta, eff, x, u, t) -> Array:
    """Force of all force effects `[n, T]` at states `x: [S, T]`, dry friction by a smooth sign."""
    n = model.plant.joint_dim
    way = jnp.tanh(x[n:] / SLIDING)
    memory = tuple(way for e in model.layout.placed("force") if e.memory)
    act = acting(Sample(model, theta, eff), Instant(x, memory, u, t))
    return act.force - act.level * way


@broadcasts
def _static(model: PlantModel, eff, u) -> Array:
    """Command effects that do not remember, on `u: [T, U]`."""
    t = DT * jnp.arange(u.shape[0], dtype=u.dtype)[:, None, None]
    u = u[:, :, None]
    for effect in model.layout.placed("command"):
        if not _remembers(effect):
            u = effect.apply(
                {k: v[None] for k, v in model.layout.params(effect, eff, 1).items()}, t, u
            )
    return u[:, :, 0]


def _remembers(effect) -> bool:
    return any(p.unit == "s" for p in effect.parameters)


def _inverse(model: PlantModel, eff, wanted) -> Array:
    """The command after which the static command effects give `wanted: [U]`, by a few fixed-point
    steps.
    """
    u = wanted
    for _ in range(3):
        u = u + wanted - _static(model, eff, u[None])[0]
    return u


class AffineLaw(NamedTuple):
    """Forces taken as `slope_q q + slope_v v + push` from the goal, and commands as `1 + gain` of
    themselves; `[n]`.
    """

    slope_q: Array
    slope_v: Array
    push: Array
    gain: Array


@broadcasts
def along(world: MendedWorld, theta, eff, loop: Loop) -> AffineLaw:
    """The effects' best affine stand-in along a motion (least squares; statistical
    linearization).
    """
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
    return AffineLaw(a, b, c, jnp.maximum(share, -0.9))


@broadcasts
def lqr(
    world: MendedWorld, theta, eff, affine: AffineLaw
) -> tuple[Array, Array, Array, Array, Array]:
    """Optimal gain `[2, 4]` and constant torque `[2]` of the model with affine forces, with its A,
    B and Riccati code.
    """
    model, n = world.model, world.model.plant.joint_dim
    goal = jnp.asarray(world.goal, jnp.float32)
    zeros = jnp.zeros((n, 1))
    memory = tuple(zeros for e in model.layout.placed("force") if e.memory)
    at = Instant(goal[:, None], memory, zeros, jnp.zeros(1))
    inertia = acting(Sample(model, theta, eff), at).inertia

    def deriv(gap, u):
        force = affine.slope_q * gap[:n] + affine.slope_v * gap[n:] + affine.push
        arrives = (1.0 + affine.gain) * u
        return model.plant.deriv(
            theta, (goal + gap)[:, None], arrives[:, None], force[:, None], inertia
        )[:, 0]

    x, u = jnp.zeros(4), jnp.zeros(n)
    A, B = jax.jacfwd(deriv, (0, 1))(x, u)
    P, _, code = solve_care(A, B, jnp.eye(4), jnp.eye(n))
    gain = mm(transpose(B), P)
    drift = deriv(x, u)[:, None]
    s = -solve(transpose(A - mm(B, gain)), mm(P, drift))
    return gain, mm(transpose(B), s)[:, 0], A, B, code


def plain_policy(world: MendedWorld, theta, eff) -> MendedPolicy:
    """The LQR of the declared part alone: it knows nothing of the effects (but of added
    inertia).
    """
    n, rows = world.model.plant.joint_dim, world.history
    nothing = AffineLaw(*(jnp.zeros(n) for _ in range(4)))
    gain, _, _, _, code = lqr(world, theta, eff, nothing)
    return MendedPolicy(
        gain,
        jnp.zeros(n),
        jnp.zeros(()),
        jnp.eye(4),
        jnp.zeros((4, n)),
        jnp.zeros(rows),
        jnp.zeros(n),
        jnp.asarray(theta, jnp.float32),
        jnp.asarray(eff, jnp.float32),
        code,
    )


@broadcasts
def train_policy(world: MendedWorld, theta, eff) -> MendedPolicy:
    """The cheapest in the model of: knowing nothing, affine stand-ins, cancelling half or all; each
    with prediction too.
    """
    plain = plain_policy(world, theta, eff)
    if not world.model.layout.instances:
        return plain
    known = _with_zero(world, plain)
    _, loop = world.rollout(known, theta, eff)
    gain, feed, A, B, code = lqr(world, theta, eff, along(world, theta, eff, loop))
    fitted = known._replace(gain=gain, feed=feed, code=code)
    tried = [
        plain,
        known,
        fitted,
        known._replace(share=jnp.float32(0.5)),
        known._replace(share=jnp.float32(1.0)),
    ]
    if any(_remembers(e) for e in world.model.layout.effects if e.place != "force"):
        tried += [_ahead(world, policy, A, B) for policy in tried[1:]]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tried)
    cost = jax.vmap(lambda p: world.rollout(p, theta, eff)[0].cost)(stacked)
    return jax.tree.map(lambda leaf: leaf[jnp.argmin(cost)], stacked)


STIFFER = (16.0, 32.0, 64.0)  # times the damping that a motion's affine stand-in has


@broadcasts
def descended(world: MendedWorld, theta, eff) -> MendedPolicy:
    """The cheapest after `polished` of `train_policy`'s and of gains for more damping.

    Dry friction brakes most, for its size, where a motion is slow. The affine stand-in, fitted
    where it is fast, hardly damps.
    """
    policy = train_policy(world, theta, eff)
    if not world.model.layout.instances:
        return policy
    _, loop = world.rollout(_with_zero(world, plain_policy(world, theta, eff)), theta, eff)
    affine = along(world, theta, eff, loop)
    starts = [policy]
    for times in STIFFER:
        gain, feed, _, _, code = lqr(
            world, theta, eff, affine._replace(slope_v=times * affine.slope_v)
        )
        starts.append(policy._replace(gain=gain, feed=feed, code=code))
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)
    better = jax.vmap(lambda p: polished(world, p, theta, eff))(stacked)
    cost = jax.vmap(lambda p: world.rollout(p, theta, eff)[0].cost)(better)
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf)
    return jax.tree.map(lambda leaf: leaf[jnp.argmin(cost)], better)


@broadcasts
def polished(world: MendedWorld, policy: MendedPolicy, theta, eff, steps: int = 6) -> MendedPolicy:
    """The policy after Levenberg-Marquardt steps on its gain and constant torque, in the model: the
    cost is a sum of squares.

    What no affine stand-in gives, as damping that makes up for dry friction, is found so. Never
    worse than it was; a step costs eleven rollouts, which Phase 1 does without.
    """
    scale = jnp.sqrt(SAMPLES / ROWS)

    def with_(z):
        return policy._replace(gain=z[:8].reshape(2, 4), feed=z[8:])

    def residual(z):
        loop = world.rollout(with_(z), theta, eff)[1]
        return scale * jnp.concatenate(
            [(loop.state - jnp.asarray(world.goal, z.dtype)).ravel(), loop.command.ravel()]
        )

    def body(carry, _):
        z, cost, damping = carry
        r, jac = residual(z), jax.jacfwd(residual)(z)
        normal = jac.T @ jac
        damped = normal + damping * jnp.diag(jnp.diag(normal) + 1e-6)
        step = -solve(damped, (jac.T @ r)[:, None])[:, 0]
        new = world.rollout(with_(z + step), theta, eff)[0].cost
        good = jnp.isfinite(new) & (new < cost)

        def keep(a, b):
            return jnp.where(good, a, b)

        return (keep(z + step, z), keep(new, cost), keep(damping * 0.2, damping * 10.0)), None

    first = jnp.concatenate([policy.gain.ravel(), policy.feed])
    begin = (first, world.rollout(policy, theta, eff)[0].cost, jnp.float32(1e-2))
    (z, _, _), _ = jax.lax.scan(body, begin, length=steps)
    return with_(z)


def _with_zero(world: MendedWorld, policy: MendedPolicy) -> MendedPolicy:
    """The same, reading its encoders as the model says they err."""
    n = world.model.plant.joint_dim
    still = jnp.zeros((2, 2 * n))
    text = sensed(world.model, policy.eff, still, jnp.zeros(n), DT)
    return policy._replace(zero=text[:n])


@broadcasts
def _ahead(world: MendedWorld, policy: MendedPolicy, A, B) -> MendedPolicy:
    """The same, acting on where the state will be when its command arrives (a predictor for a late
    input).
    """
    late = group_delay(world.model, policy.eff, DT) + _sensor_delay(world, policy.eff)
    n = B.shape[1]
    both = jnp.zeros((4 + n, 4 + n)).at[:4, :4].set(A)
    both = both.at[:4, 4:].set(B)
    power = transition(both, late)
    weight = jnp.clip(late / DT - jnp.arange(world.history, dtype=A.dtype), 0.0, 1.0)
    recent = weight / jnp.maximum(jnp.sum(weight), 1e-9)
    return policy._replace(phi=power[:4, :4], gamma=power[:4, 4:], recent=recent)


@broadcasts
def _sensor_delay(world: MendedWorld, eff) -> Array:
    """Sum of the time constants of the sensors, the later joint's."""
    layout, total = world.model.layout, jnp.zeros(world.model.plant.joint_dim)
    for effect in layout.placed("measurement"):
        for p in effect.parameters:
            if p.unit == "s":
                total = total + layout.params(effect, eff, 0)[p.name]
    return jnp.max(total)
