"""The balance of forces of a group of joints: what its motion takes, linear in inertial parameters,
and what acts, by effect.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse

from adaptsim_jax.attribution.acting import Values, actuated
from adaptsim_jax.attribution.criteria import BALANCE, WINDOW
from adaptsim_jax.attribution.equation.windows import EvenTrial, runs_of
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import Group, TreeProblem, group_inertia, values_of
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.effects.base import Dry, Effect, Motion
from adaptsim_jax.effects.joints.actuator import TORQUE_GAIN
from adaptsim_jax.mechanisms import dynamics, equations
from adaptsim_jax.mechanisms.tree import Tree

GAIN = TORQUE_GAIN.name
"""Effects that change what an actuator does by what it was told."""
At = Mapping[str, np.ndarray]  # parameters of an effect, [n] each
Driven = tuple[np.ndarray, np.ndarray]
PROGRAM_ROWS = 2048  # rows that one compiled program takes


@dataclass(frozen=True)
class Balance:
    """Of a group of n joints in K windows: regressor [K, n, 10 n] (N m by inertial parameter),
    acceleration [K, n], trial [K], time [K], clear [K, n]: whether a joint moved and was not at the
    end of its range; known [K, n]: what acts whatever
    is fitted, which is what holds bodies up against gravity, less what bodies of joints that follow
    others take.

    q, v, a, u [n, T]: the motion of all runs one after the other; ahead, width [n, T]: the
    speed that dry friction goes by, and below which it is not told from zero; clock [T] s; mean
    [K, T] averages over windows; runs: the rows of each.
    """

    group: Group
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    ahead: np.ndarray
    width: np.ndarray
    clock: np.ndarray
    runs: tuple[slice, ...]
    mean: scipy.sparse.csr_matrix
    regressor: np.ndarray
    acceleration: np.ndarray
    clear: np.ndarray
    trial: np.ndarray
    time: np.ndarray
    names: tuple[str, ...]
    inertia: np.ndarray
    known: np.ndarray | float = 0.0

    @property
    def joints(self) -> int:
        return len(self.group.joints)

    @property
    def sign(self) -> np.ndarray:
        """Of the speed [n, T], between -1 and 1 where it is not told from zero."""
        return np.tanh(self.ahead / self.width)

    def averaged(self, z: np.ndarray) -> np.ndarray:
        """Of something along the motion [n, T] its mean over windows, [K, n]."""
        return self.mean @ np.asarray(z, float).T


def balances(
    problem: TreeProblem,
    tracks: tuple[JointTrack, ...],
    span: float = WINDOW.span,
) -> tuple[Balance, ...]:
    """By group of joints; none of a group whose trials hold no window. Windows at stops do not
    count.
    """
    out = []
    for group in problem.groups:
        own = list(group.joints)
        part = [JointTrack(t.name, t.time, t.q[:, own], None, t.u[:, own]) for t in tracks]
        runs = runs_of(part, problem.floor[own], span)
        if not runs:
            continue
        values = values_of(problem, group, Vector((), np.zeros(0)))
        made = _of_runs(group, runs, tuple(t.name for t in tracks), group_inertia(values, group)[0])
        sure = inside(group.model.tree, made.q) & ~np.isin(own, problem.unlike)[:, None]
        clear = np.concatenate([r.clear for r in runs], 1)
        moves = np.maximum(made.mean @ clear.T, BALANCE.still_weight)
        certain = made.mean @ (~sure).T < BALANCE.pushed
        out.append(replace(made, clear=np.where(certain, moves, BALANCE.no_weight)))
    return tuple(out)


def _of_runs(
    group: Group, runs: Sequence[EvenTrial], names: tuple[str, ...], inertia: np.ndarray
) -> Balance:
    """Without `clear`. names: of all trials."""
    tree = group.model.tree
    q, v, a, u, smooth = (
        np.concatenate([getattr(r, k) for r in runs], 1) for k in ("q", "v", "a", "u", "smooth")
    )
    width = np.concatenate([np.outer(r.width, np.ones(len(r.time))) for r in runs], 1)
    ends = np.cumsum([0, *(len(r.time) for r in runs)])
    mean = scipy.sparse.csr_matrix(scipy.sparse.block_diag([r.mean for r in runs], "csr"))
    table = regressor_along(tree, q, v, a)
    regressor = mean @ table.reshape(-1, table.shape[-1]).T
    return Balance(
        group,
        q,
        v,
        a,
        u,
        ahead=ahead_of(tree, smooth, a),
        width=width,
        clock=np.concatenate([r.time for r in runs]),
        runs=tuple(slice(int(i), int(j)) for i, j in itertools.pairwise(ends)),
        mean=mean,
        regressor=regressor.reshape(-1, *table.shape[:2]),
        acceleration=mean @ a.T,
        clear=np.zeros(0),
        trial=np.concatenate([np.full(len(r.at), r.trial) for r in runs]),
        time=np.concatenate([r.at for r in runs]),
        names=names,
        inertia=inertia,
        known=_known(tree, mean, q, v, a),
    )


def inside(tree: Tree, q: np.ndarray) -> np.ndarray:
    """Which of the angles [n, T] are within a joint's range, whose end pushes back."""
    low, high = np.asarray(tree.range, float).T[:, :, None]
    near = np.minimum(BALANCE.at_end, BALANCE.at_end_share * (high - low))
    return ~np.asarray(tree.limited)[:, None] | ((q > low + near) & (q < high - near))


def _known(
    tree: Tree, mean: scipy.sparse.csr_matrix, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray | float:
    every = tree if tree.all_joints is None else tree.all_joints.tree
    if tree.all_joints is None and not any(every.compensated):
        return 0.0
    return mean @ _by_pieces(partial(_given, tree), q, v, a).T


@jax.jit
def _given(tree, q, v, a):
    up = dynamics.compensation(tree, q)
    up = 0.0 * q if up is None else up
    if tree.all_joints is None:
        return up
    return up - dynamics.inverse_dynamics(
        tree, 0.0 * jnp.asarray(tree.inertial), q, v, a, jnp.asarray(tree.gravity)
    )


def _by_pieces(make, *along: np.ndarray) -> np.ndarray:
    """`make(*pieces)` of arrays [..., T], by pieces of one length, so that a program is compiled
    once.
    """
    out, count = [], along[0].shape[-1]
    with jax.enable_x64(True):
        for first in range(0, count, PROGRAM_ROWS):
            piece = [z[..., first : first + PROGRAM_ROWS] for z in along]
            own = piece[0].shape[-1]
            full = [
                np.pad(z, [(0, 0)] * (z.ndim - 1) + [(0, PROGRAM_ROWS - own)], mode="edge")
                for z in piece
            ]
            out.append(np.asarray(make(*full))[..., :own])
    return np.concatenate(out, -1)


def regressor_along(tree: Tree, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Forces of the joints by inertial parameters [n, 10 n, T] along a motion [n, T]."""
    return _by_pieces(partial(_regressed, tree), q, v, a)


@jax.jit
def _regressed(tree, q, v, a):
    return equations.regressor(tree, q, v, a, jnp.asarray(tree.gravity))


@jax.jit
def _taken(tree, inertial, offset, scale, q, v, a):
    size = 1.0 + scale[:, None]

    def force(q, v, a):
        return equations.inverse_dynamics(tree, inertial, q, v, a, jnp.asarray(tree.gravity))

    return force((q - offset[:, None]) / size, v / size, a / size) - force(q, v, a)


@jax.jit
def _taken_more(tree, inertial, offset, scale, q, v, a):
    none = jnp.zeros_like(offset)

    def change(by, of):
        return _taken(tree, inertial, by, of, q, v, a)

    return jax.jvp(change, (none, none), (offset, scale))[1]


@cache
def read_more(effect: Effect, parameter: str) -> tuple[float, float]:
    """What one more of a sensor effect's amplitude adds to the reading: at the angle zero, and for
    each rad (m) of the angle.
    """
    p = {a.name: jnp.full((1, 1), a.default) for a in effect.parameters}
    angle = jnp.array([[0.0], [1.0]])

    def reading(z):
        return effect.apply(p | {parameter: z}, angle, angle, 0.0 * angle, angle[0])[0]

    slope = jax.jvp(reading, (p[parameter],), (jnp.ones((1, 1)),))[1]
    return float(slope[0, 0]), float(slope[1, 0] - slope[0, 0])


def read_wrong(
    balance: Balance,
    inertial: np.ndarray,
    offset: np.ndarray,
    scale: np.ndarray,
    slope: bool = False,
) -> np.ndarray:
    """What a motion takes more [K, n] than the measured one, where encoders read `(1 + scale) q +
    offset` ([n]); with `slope` to first order.
    """
    make = partial(
        _taken_more if slope else _taken,
        balance.group.model.tree,
        inertial,
        np.asarray(offset, float),
    )
    at = partial(make, np.asarray(scale, float))
    return balance.averaged(_by_pieces(at, balance.q, balance.v, balance.a))


@jax.jit
def _pulled(tree, inertial, gravity, q):
    return equations.gravity_force(tree, inertial, q, gravity)


def tilting(balance: Balance, inertial: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Force of a gravity `way` [3] alone, [K, n]."""
    return balance.averaged(
        _by_pieces(partial(_pulled, balance.group.model.tree, inertial, way), balance.q)
    )


def actuator_force(balance: Balance, values: Values, u: np.ndarray | None = None) -> Driven:
    """Force of the actuators and the part of it that follows command and angle, [n, T], by the law
    of `values`. Controllers see what is logged, an encoder's offset included. u: what was
    commanded, where not what was logged.
    """
    given = balance.u if u is None else u
    with jax.enable_x64(True):
        tau, pull = _actuated(values._replace(effects={}), balance.q, balance.v, given)
    return np.asarray(tau) + 0.0 * balance.q, np.asarray(pull) + 0.0 * balance.q


@jax.jit
def _actuated(values: Values, q, v, u):
    return actuated(values, q, v, u)


@partial(jax.jit, static_argnames="effect")
def _acted(tree, inertial, effect: Effect, p, q, v, tau, t, pull, u, ahead, width):
    def gravity(q):
        return equations.gravity_force(tree, inertial, q, jnp.asarray(tree.gravity))

    answer = effect.apply(p, Motion(q, v, tau, t, gravity, pull, u))
    if isinstance(answer, Dry):
        rate, more = jnp.asarray(tree.friction_softness).T[..., None]
        sign = ramp(ahead, width, more * jnp.abs(answer.level) / jnp.maximum(rate, 1e-9))
        return answer.force - answer.level * sign + 0.0 * q
    return answer + 0.0 * q


def ahead_of(tree: Tree, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """The speed [n, T] that dry friction goes by: that of the joints, or where it gives as it will
    be a time constant on.
    """
    rate, more = np.asarray(tree.friction_softness, float).T[..., None]
    return np.where(more > 0.0, v + a / np.maximum(rate, 1e-9), v)


def ramp(v, width, wide):
    """The sign of v as it is told from zero beyond `width`: the mean of tanh(v / width) over
    +-`wide`, about which it turns.
    """

    def log_cosh(x):
        return jnp.abs(x) + jnp.log1p(jnp.exp(-2.0 * jnp.abs(x)))

    some = jnp.maximum(wide, 1e-3 * width)
    mean = (log_cosh((v + some) / width) - log_cosh((v - some) / width)) * width / (2.0 * some)
    return jnp.where(wide > 0.0, mean, jnp.tanh(v / width))


def effect_force(
    balance: Balance, values: Values, effect: Effect, p: At, driven: Driven
) -> np.ndarray:
    """Mean force [K, n] of a force effect at parameters p {name: [n]} along the measured motion.
    Dry friction against it. driven: `actuator_force` of these values.
    """
    if effect.inertia:
        with jax.enable_x64(True):
            return (
                -np.asarray(effect.apply({k: np.asarray(z) for k, z in p.items()}))
                * balance.acceleration
            )
    at = {k: np.asarray(z, float)[:, None] for k, z in p.items()}
    b = balance
    tau, pull = driven

    def make(*z):
        return _acted(b.group.model.tree, values.inertial[..., 0], effect, at, *z)

    return b.averaged(_by_pieces(make, b.q, b.v, tau, b.clock[None], pull, b.u, b.ahead, b.width))


@partial(jax.jit, static_argnames="effect")
def _commanded(effect: Effect, p, t, u):
    return effect.apply(p, t[:, None, None], u.T[..., None])[..., 0].T


def command_force(
    balance: Balance, values: Values, effect: Effect, p: At, driven: Driven
) -> np.ndarray:
    """Change of the actuators' mean force [K, n] by an effect on their command (a delay, a lag)."""
    at = {k: np.asarray(z, float)[None, :, None] for k, z in p.items()}
    late = balance.u.copy()
    longest = max(run.stop - run.start for run in balance.runs)
    with jax.enable_x64(True):
        for run in balance.runs:
            short = longest - (run.stop - run.start)
            clock = balance.clock[run]
            time = clock[0] + (clock[1] - clock[0]) * np.arange(longest)
            u = np.pad(balance.u[:, run], ((0, 0), (0, short)), mode="edge")
            late[:, run] = np.asarray(_commanded(effect, at, time, u))[:, : longest - short]
    return balance.averaged(actuator_force(balance, values, late)[0] - driven[0])


def force_of(balance: Balance, values: Values, effect: Effect, p: At, driven: Driven) -> np.ndarray:
    """Mean force [K, n] of an effect on forces or commands at parameters p {name: [n]}."""
    return (command_force if effect.place == "command" else effect_force)(
        balance, values, effect, p, driven
    )


def residual(
    problem: TreeProblem,
    balance: Balance,
    vector: Vector,
    acts: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Force that is missing [K, n]: what the motion takes less all that acts, at the values of a
    vector; of an actuator that does less than it was told, in terms of what it was told.

    Else a gain of -1 (a limit of 0) beside a body that weighs nothing would leave nothing, whatever
    the motion: a dead model.
    """
    group = balance.group
    values = values_of(problem, group, vector)
    n = balance.joints

    offset, scale = np.zeros(n), np.zeros(n)
    for effect in problem.effects:
        if effect.place == "measurement" and effect.in_balance:
            for a in effect.amplitudes:
                at_zero, by_angle = read_more(effect, a.name)
                off = values.effects[effect.name][a.name][:, 0] - a.default
                offset, scale = offset + at_zero * off, scale + by_angle * off
    inertial = values.inertial[..., 0]
    takes = balance.regressor @ inertial.ravel() - balance.known
    if np.any(offset) or np.any(scale):  # the bodies are where their encoders do not say
        takes = takes + read_wrong(balance, inertial, offset, scale)
    gravity = values.gravity[:, 0] - np.asarray(group.model.tree.gravity)
    if np.any(gravity):
        takes = takes - tilting(balance, inertial, gravity)
    force, share = acting(balance, values) if acts is None else acts
    return (takes - force) / share


def acting(balance: Balance, values: Values) -> tuple[np.ndarray, np.ndarray]:
    """Force of actuators and effects [K, n], and what actuators do over what they were told [n]."""
    now = actuator_force(balance, values)
    acts = reported = driven = balance.averaged(now[0])
    for effect in balance.group.model.effects:
        p = {k: z[:, 0] for k, z in values.effects.get(effect.name, {}).items()}
        on = any(np.any(p[a.name] != a.default) for a in effect.amplitudes if a.name in p)
        if on and effect.place in ("force", "command"):
            force = force_of(balance, values, effect, p, now)
            acts = acts + force
            driven = driven + force if effect.scales_torque else driven
    return acts, in_proportion(reported, driven)


def in_proportion(reported: np.ndarray, driven: np.ndarray) -> np.ndarray:
    """What actuators do [K, n] over what they were told, root mean squares [n]."""
    told = rms(reported)
    share = rms(driven) / np.maximum(told, 1e-300)
    return np.where(told > 0, np.maximum(share, BALANCE.min_scale), 1.0)


def rms(z: np.ndarray) -> np.ndarray:
    """Root mean squares [...] over windows, of z [K, ...]."""
    return np.sqrt(np.mean(np.square(z), 0))
