"""Between the command that was recorded and the torque that reaches a joint.

Delays and lags act on commands, held from their row to the next. What they return is each row's
mean, so impulses are exact: `t: [T, ...]` s and `u: [T, ...]` have time first, parameters are
`[1, ...]`, the last row lasts no time. An actuator's own law makes the torque of a command, so that
gains and limits are forces.
"""

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Effect, Quantity, Traits


def _durations(t):
    return jnp.concatenate([jnp.diff(t, axis=0), jnp.zeros_like(t[:1])])


def delay(p, t, u):
    """Exact mean of the shifted command over each row, through its running integral (differentiable
    in the delay).
    """
    duration = _durations(t)
    integral = jnp.concatenate([jnp.zeros_like(u[:1]), jnp.cumsum(u * duration, 0)[:-1]])
    t, shifted_time = jnp.broadcast_arrays(t, t - p["delay"] * jnp.ones_like(u))
    integral_at_rows = _integral_at(t, u, integral, shifted_time, p["before"] * u[:1])
    mean = jnp.diff(integral_at_rows, axis=0) / jnp.where(duration > 0, duration, 1.0)[:-1]
    return jnp.concatenate([jnp.where(duration[:-1] > 0, mean, u[:-1]), u[-1:]])


def _integral_at(t, u, integral, at, before):
    """Running integral of the held command at times `at`, with a command `before: [1, ...]` ahead
    of the first row.
    """

    def one(t, u, integral, at, before):
        row = jnp.clip(
            jnp.searchsorted(t, at, side="left") - 1, 0, len(t) - 1
        )  # left: a knot belongs to the row before
        return integral[row] + jnp.where(at < t[0], before[0], u[row]) * (at - t[row])

    flat = [z.reshape(z.shape[0], -1) for z in (t, u, integral, at, before)]
    return jax.vmap(one, 1, 1)(*flat).reshape(u.shape)


def actuator_lag(p, t, u):
    """First-order lag, from a share of the first command on: exact state at each row, exact mean
    over it.
    """
    duration = _durations(t) * jnp.ones_like(u)
    lag = jnp.maximum(p["lag"], 1e-9)
    decay = jnp.exp(-duration / lag)

    def row(state, now):
        u, decay = now
        return u + (state - u) * decay, state

    _, state = jax.lax.scan(row, (p["before"] * u[:1])[0], (u, decay))
    share = p["lag"] * (1.0 - decay) / jnp.where(duration > 0, duration, 1.0)
    return u + (state - u) * share


LATEST = 0.05  # s: a bus and a driver together delay less


def torque_gain_force(p, m):
    return p["gain"] * m.u


def position_gain(p, m):
    return p["gain"] * m.pull


def saturation_force(p, m):
    """The limit is a share cut off the largest force, so that no cut changes nothing."""
    limit = (1.0 - p["cut"]) * p["peak"]
    return jnp.clip(m.u, -limit, limit) - m.u


def dead_zone_force(p, m):
    return -jnp.clip(m.u, -p["width"], p["width"])


def _delays(reach, joint):
    return [{"delay": s} for s in (-0.02, -0.01, -0.004, 0.004, 0.01, 0.02, 0.04)]


def lags(reach, joint):
    return [{"lag": s} for s in (0.004, 0.01, 0.025, 0.06)]


def _limits(reach, joint):
    """Limits from nearly what is exceeded now and then down to a twelfth of it."""
    peak, torque = float(reach.peak[joint]), float(reach.torque[joint])
    return [{"cut": 1.0 - 0.9 * torque * 0.8**k / peak, "peak": peak} for k in range(12)]


def _widths(reach, joint):
    return [{"width": float(reach.torque[joint]) * s} for s in (0.01, 0.03, 0.08)]


BEFORE = Quantity(
    "before",
    "1",
    0.0,
    1.0,
    1.0,
    shape=True,
    held=True,
    optional=True,
    meaning="share of its first command ahead of the log",
)

TORQUE_GAIN = Effect(
    "torque_gain",
    "force",
    (Quantity("gain", "1", -0.9, 2.0, factor=True, mjcf="gain"),),
    torque_gain_force,
    "the actuator's torque is off by a share",
    "driven motion beside free swings",
    ("torque_gain", "position_gain", "load_friction", "inertia"),
    formula="(1 + gain) torque",
    traits=Traits(on_actuator=True, scales_drive=True, shared=True, prior=0.3),
)

POSITION_GAIN = Effect(
    "position_gain",
    "force",
    (Quantity("gain", "1", -0.9, 2.0, factor=True, mjcf="kp"),),
    position_gain,
    "the stiffness of the position controller is off by a share",
    "large position errors",
    ("torque_gain", "spring"),
    formula="(1 + gain) kp (target - q)",
    traits=Traits(on_actuator=True, scales_drive=True, of_controller=True),
)

SATURATION = Effect(
    "saturation",
    "force",
    (
        Quantity(
            "cut",
            "1",
            0.0,
            0.99,
            sign=1,
            meaning="share cut off the largest torque",
            mjcf="limit",
        ),
        Quantity(
            "peak",
            "N m",
            0.0,
            1e9,
            1e9,
            shape=True,
            held=True,
            meaning="the largest torque; not fitted",
        ),
    ),
    saturation_force,
    "the torque cannot exceed a limit",
    "torques near and below the limit",
    ("torque_gain",),
    jump=True,
    grid=_limits,
    starts=_limits,
    formula="torque within +-(1 - cut) peak",
    traits=Traits(on_actuator=True),
)

DEAD_ZONE = Effect(
    "dead_zone",
    "force",
    (Quantity("width", "N m", 0.0, 0.9, sign=1),),
    dead_zone_force,
    "torques below a width move nothing, larger ones lose it",
    "small and large torques",
    ("coulomb", "torque_gain"),
    jump=True,
    grid=_widths,
    formula="torque less width, zero within +-width",
    traits=Traits(on_actuator=True),
)

DELAY = Effect(
    "delay",
    "command",
    (Quantity("delay", "s", -LATEST, LATEST, mjcf="delay"), BEFORE),
    delay,
    "the command reaches the joint late; below zero, its log is late",
    "fast changes of the command",
    ("actuator_lag", "sensor_delay", "sensor_lag"),
    jump=True,
    grid=_delays,
    formula="command(t - delay)",
    traits=Traits(shared=True, tried_first=1),
    title="command delay",
)

ACTUATOR_LAG = Effect(
    "actuator_lag",
    "command",
    (Quantity("lag", "s", 0.0, 0.2, sign=1, mjcf="lag"), BEFORE),
    actuator_lag,
    "the joint follows its command as a first-order lag",
    "fast changes of the command",
    ("delay", "sensor_lag", "sensor_delay"),
    jump=True,
    grid=lags,
    formula="lag torque' = command - torque",
    traits=Traits(shared=True),
)
