"""The push as a slide in two dimensions: the planar model with lateral motion, and what may act on
it beside the declared.

The bottle is a disc at (x, y), which turns only where its inertia is not declared to be too large
for that (`spin`): friction at the sole's points then couples force and moment (Goyal, Ruina and
Papadopoulos, 1991). The plate's face is a line with a normal. It meets the bottle along that normal
as in `planar` (the same damped spring, the same lift) and drags it across by friction. Where
nothing acts sideways the motion is that of `planar`, where asked for with its step of 5 ms. A
measured slide follows no step, and that one ends 5 mm from the converged motion (median; 28 mm at
most). So the default here is a scheme of second order with a step of 1 ms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing.model import PAPER, ElasticityMap, PushOptions
from adaptsim_jax.tasks.pushing.planar import (
    DEFAULT,
    IMPEDANCE,
    PlanarCoefficients,
    edge_motion,
    edge_of,
)

Array = Any

STEP = 0.001  # s
ROW = 0.005  # s between the rows that are kept
DRAKE = PlanarCoefficients(
    ElasticityMap((4.440, 0.615, -0.176), (-1.366, 0.263, 0.086), (0.737, 0.701)), -0.498, 0.958
)
"""Twin of Drake's scene in converged steps, fitted to tracks by `experiments/slide_twin.py`:
`planar.DRAKE` was fitted in steps of 5 ms to where bottles end, and is 9 mm away (RMS) while the
plate touches, this one 3.
"""


@dataclass(frozen=True)
class Lacking:
    """What acts on the slide and is not declared; 0 does nothing (a second patch's place is free
    then).

    speed_scale 1, speed_offset m/s, heading_offset rad; start_x, start_y m beside the declared
    start; hardening, the power of the hit's speed by which the contact is stiffer and more damped;
    heavier: Share of the mass beyond the declared; plate_turn rad of the face against its motion.
    Tilt_x, tilt_y rad, positive downhill towards +x, +y; speed_friction s/m, the growth of friction
    with speed, of its size; drag 1/s of speed by itself. Grain_a, grain_b: friction larger by about
    that share along x than along y, and along the diagonal; patch_x m and patch_size m (half the
    growth of its side); other_x, other_y m and other_mu of a second patch, as large as the
    declared, and what it adds. spin: A solid cylinder's moment of inertia about the vertical over
    the bottle's (0: it does not turn). Com_x, com_y m of its centre of mass from its axis, as it
    stands.
    """

    speed_scale: float = 0.0
    speed_offset: float = 0.0
    heading_offset: float = 0.0
    start_x: float = 0.0
    start_y: float = 0.0
    hardening: float = 0.0
    heavier: float = 0.0
    plate_turn: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    speed_friction: float = 0.0
    drag: float = 0.0
    grain_a: float = 0.0
    grain_b: float = 0.0
    patch_x: float = 0.0
    patch_size: float = 0.0
    other_x: float = 0.75
    other_y: float = 0.0
    other_mu: float = 0.0
    spin: float = 0.0
    com_x: float = 0.0
    com_y: float = 0.0


NEUTRAL = asdict(Lacking())


def rollout(
    values: Mapping[str, Array],
    action: Array,
    options: PushOptions = PAPER,
    coefficients: PlanarCoefficients = DEFAULT,
    start: Array = pushing.START,
    step: float = STEP,
    as_planar: bool = False,
) -> Array:
    """`[rows + 1, 4]`: x, y m and vx, vy m/s at 0, 5 ms, 10 ms, .... Pure, jit, vmap and
    differentiate it. With `spin` other than a plain 0, `[rows + 1, 6]`: yaw rad and its rate rad/s
    as well.

    values: mu, e (Pa), mu_p, y_p (m), and any of `NEUTRAL`; action `[2]` (m/s, rad). `options`,
        `coefficients`, `step` static.
    as_planar: semi-implicit Euler's steps as `planar` makes them (`step` 5 ms). Else half a drift,
        a kick, half a drift, and where `coefficients` are `planar.DRAKE`, `DRAKE` stands for them.
    """
    if not as_planar and isinstance(coefficients.lift, float) and coefficients == planar.DRAKE:
        coefficients = DRAKE
    v = NEUTRAL | dict(values)
    speed = action[0] * (1.0 + v["speed_scale"]) + v["speed_offset"]
    heading = action[1] + v["heading_offset"]
    start = jnp.asarray(start) + jnp.stack([v["start_x"] + 0.0 * speed, v["start_y"] + 0.0 * speed])
    turns = not _is_zero(v["spin"])
    scheme = _Scheme(options, coefficients, step, as_planar)
    numbers = _numbers(v, _Drive(speed, heading, start), scheme)
    per_row = round(ROW / step)

    def row(state, edges):
        state, _ = jax.lax.scan(lambda s, e: (_step(numbers, s, e), None), state, edges)
        return state, jnp.stack(state)

    still = 0.0 * speed + 0.0 * heading + 0.0 * sum(jnp.asarray(z) for z in v.values())
    if as_planar:
        edge = edge_motion(options.duration, step)
    else:
        edge = edge_halfway(options.duration, step)
    edges = jnp.asarray(edge).reshape(-1, per_row, 6)
    state = (still,) * (6 if turns else 4)
    _, rows = jax.lax.scan(row, state, edges)
    rows = jnp.concatenate([jnp.zeros_like(rows[:1]), rows])
    return rows + jnp.concatenate([start, jnp.zeros(len(state) - 2)])[None]


def _is_zero(value: Array) -> bool:
    """Known to be none before anything is compiled, so that the work is not done."""
    return isinstance(value, float) and value == 0.0


def edge_halfway(duration: float, step: float) -> np.ndarray:
    """As `planar.edge_motion`, in the middle of each step and of the profile as it is: `[steps,
    6]`.
    """
    t = (np.arange(round(duration / step)) + 0.5) * step
    begin = np.array([0.0, pushing.STILL, pushing.STILL + pushing.RAMP_UP])
    corners = np.array([*begin, begin[-1] + pushing.HOLD, pushing.PUSH_ENDS])
    h = pushing.ramp(corners)
    spans, rises = np.diff(corners), np.diff(h)
    travels = spans * h[1:] - spans * rises / 2
    travelled = np.concatenate([[0.0], np.cumsum(travels)])
    at = np.clip(np.searchsorted(corners, t, "right") - 1, 0, len(corners) - 1)
    rate, slope = pushing.ramp(t), np.append(rises / spans, 0.0)[at]
    travel = travelled[at] + (t - corners[at]) * (h[at] + rate) / 2
    return edge_of(travel, rate, slope)


class _Scheme(NamedTuple):
    """Steps of `dt` s; as_planar: semi-implicit Euler's, else half a drift, a kick, half a
    drift.
    """

    options: PushOptions
    coefficients: PlanarCoefficients
    dt: float
    as_planar: bool

    @property
    def drifts(self) -> tuple[float, float]:
        """s of drift before and after the kick."""
        if self.as_planar:
            return 0.0, self.dt
        return self.dt / 2, self.dt / 2


class _Drive(NamedTuple):
    """The plate's speed m/s and heading rad, and where the bottle starts `[2]` m."""

    speed: Array
    heading: Array
    start: Array


class _Numbers(NamedTuple):
    """What every step of a slide takes.

    friction: Of table, patch and plate; stiffness, damping of the plate's contact by the mass;
    normal, across: Directions of its face. forward, aside: Shares of its motion along them; behind:
    m that it begins behind the contact; pull: m/s2 downhill. spots: Points of the sole and the
    share of the load that each bears. light: Mass over moment of inertia, 1/m2.
    """

    v: Mapping[str, Array]
    scheme: _Scheme
    drive: _Drive
    friction: pushing.Frictions
    stiffness: Array
    damping: Array
    normal: tuple[Array, Array]
    across: tuple[Array, Array]
    forward: Array
    aside: Array
    behind: Array
    pull: tuple[Array, Array]
    spots: list[tuple[float, float, Array]]
    light: Array


class _Touch(NamedTuple):
    """Of plate and bottle in a step: force m/s2 by the mass, the most that it grips m/s, what
    presses the sole m/s2, and the face's speed along itself over the bottle's m/s.
    """

    force: Array
    grip: Array
    pressed: Array
    slip: Array


def _numbers(v: Mapping[str, Array], drive: _Drive, scheme: _Scheme) -> _Numbers:
    c, options = scheme.coefficients, scheme.options
    speed, heading, start = drive
    friction = pushing.frictions(
        jnp.stack([jnp.asarray(v[n]) for n in pushing.PARAMETERS]), options.friction
    )
    k, b = pushing.spring(c.elasticity, v["e"], speed, options.mass, jnp)
    struck = (speed + pushing.PITCH_RATE * pushing.EDGE_DROP) / 0.7
    hit = jnp.exp(v["hardening"] * jnp.log(struck)) / (1.0 + v["heavier"])
    along = (jnp.cos(heading), jnp.sin(heading))
    normal = (jnp.cos(heading + v["plate_turn"]), jnp.sin(heading + v["plate_turn"]))
    across = (-normal[1], normal[0])
    forward, aside = (along[0] * w[0] + along[1] * w[1] for w in (normal, across))
    behind = (pushing.START[0] - start[0]) * normal[0] + (pushing.START[1] - start[1]) * normal[1]
    behind -= (pushing.LINK_BACK - pushing.EDGE_RADIUS - pushing.RADIUS) * forward
    g = pushing.GRAVITY
    pull = (g * jnp.sin(v["tilt_x"]), g * jnp.sin(v["tilt_y"]))
    light = v["spin"] * 2.0 / pushing.RADIUS**2
    points = pushing.sole().tolist()
    spread = sum(a * a for a, _ in points) / len(points)
    spots = [
        (c.sole * a, c.sole * q, (1.0 + (v["com_x"] * a + v["com_y"] * q) / spread) / len(points))
        for a, q in points
    ]
    contact = (k * hit, b * hit, normal, across, forward, aside, behind)
    return _Numbers(v, scheme, drive, friction, *contact, pull, spots, light)


def _inside(z: Array, size: Array) -> Array:
    return jnp.clip((size - jnp.abs(z)) / pushing.PATCH_EDGE + 0.5, 0.0, 1.0)


def _friction_at(n: _Numbers, x: Array, y: Array) -> Array:
    """Of one point of the ground."""
    v, half = n.v, pushing.PATCH_SIDE / 2
    own = half + v["patch_size"]
    on = _inside(x - pushing.PATCH_X - v["patch_x"], own) * _inside(y - v["y_p"], own)
    mu = n.friction.table + on * (n.friction.patch - n.friction.table)
    if _is_zero(v["other_mu"]):
        return mu
    other = _inside(x - v["other_x"], half) * _inside(y - v["other_y"], half)
    return mu + other * v["other_mu"]


def _grained(n: _Numbers, vx: Array, vy: Array) -> tuple[Array, Array]:
    """B v: friction of greatest dissipation in an elliptic cone has its direction, and the size
    sqrt(v B v) of the speed.
    """
    a, b = n.v["grain_a"], n.v["grain_b"]
    return (1.0 + a) * vx + b * vy, b * vx + (1.0 - a) * vy


def _step(n: _Numbers, state: tuple[Array, ...], edge: Array) -> tuple[Array, ...]:
    """`(dx, dy, vx, vy)` a step later; with yaw and its rate where the bottle turns. edge `[6]`: the
    plate's.
    """  # noqa: E501
    dx, dy, vx, vy, *turning = state
    before, _ = n.scheme.drifts
    dx, dy = dx + before * vx, dy + before * vy
    x, y = n.drive.start[0] + dx, n.drive.start[1] + dy
    size = jnp.sqrt(vx * vx + vy * vy + 1e-16)
    faster = 1.0 + n.v["speed_friction"] * size
    local = [
        share * jnp.maximum(_friction_at(n, x + a, y + q) * faster, 0.0) for a, q, share in n.spots
    ]
    touch = _touch(n, (dx, dy), (vx, vy), edge, sum(local))
    if turning:
        return _slid_and_turned(n, (dx, dy, vx, vy, *turning), touch, local)
    return _slid(n, (dx, dy, vx, vy), touch, sum(local))


def _touch(n: _Numbers, moved: Any, velocity: Any, edge: Array, mu: Array) -> _Touch:
    """The plate's damped spring at where the bottle has `moved`, with its `velocity`."""
    (dx, dy), (vx, vy), normal, across = moved, velocity, n.normal, n.across
    dt, b, g = n.scheme.dt, n.damping, pushing.GRAVITY
    at, rate, gain = (n.drive.speed * edge[2 * i] + edge[2 * i + 1] for i in range(3))
    out = vx * normal[0] + vy * normal[1]
    over = vx * across[0] + vy * across[1]
    depth = at * n.forward + n.behind - (dx * normal[0] + dy * normal[1])
    free = gain * n.forward + jnp.where(out > 0, mu * g, 0.0)
    closing = rate * n.forward - out
    if n.scheme.as_planar:
        within, touching = 1.0, jnp.where(depth > 0, 1.0, 0.0)
    else:
        # damping by the mean of the speeds before and after; and the share of the step after the
        # first touch: the damper's force begins at once, wherever a step begins
        within = 1.0 / (1.0 + b * dt / 2)
        touching = jnp.clip(0.5 + depth / (dt * jnp.maximum(jnp.abs(closing), 1e-3)), 0.0, 1.0)
        depth = jnp.where(touching < 1.0, 0.5 * touching * dt * closing, depth)
    push = b * closing + n.stiffness * depth + IMPEDANCE * free
    force = touching * jnp.maximum(within * push, 0.0)
    grip = n.friction.plate * force * dt
    pressed = jnp.maximum(g - n.scheme.coefficients.lift * force, 0.0)
    return _Touch(force, grip, pressed, rate * n.aside - over)


def _kicked(n: _Numbers, velocity: Any, force: Array, drag: Array) -> list[Array]:
    """The velocity after all but the ground's friction acted for a step."""
    return [
        w + n.scheme.dt * (force * n.normal[i] + n.pull[i] - n.v["drag"] * w) + drag * n.across[i]
        for i, w in enumerate(velocity)
    ]


def _slid(n: _Numbers, state: Any, touch: _Touch, mu: Array) -> tuple[Array, ...]:
    dx, dy, *velocity = state
    drag = jnp.clip(touch.slip, -touch.grip, touch.grip)
    vx, vy = _kicked(n, velocity, touch.force, drag)
    bx, by = _grained(n, vx, vy)
    share = n.scheme.dt * mu * touch.pressed / jnp.sqrt(vx * bx + vy * by + 1e-16)
    vx, vy = (jnp.where(share < 1.0, w - share * z, 0.0) for w, z in ((vx, bx), (vy, by)))
    _, after = n.scheme.drifts
    return dx + after * vx, dy + after * vy, vx, vy


def _slid_and_turned(n: _Numbers, state: Any, touch: _Touch, local: list) -> tuple[Array, ...]:
    dx, dy, vx, vy, yaw, rate_z = state
    dt, (before, after), normal, light = n.scheme.dt, n.scheme.drifts, n.normal, n.light
    yaw = yaw + before * rate_z
    cx = jnp.cos(yaw) * n.v["com_x"] - jnp.sin(yaw) * n.v["com_y"]
    cy = jnp.sin(yaw) * n.v["com_x"] + jnp.cos(yaw) * n.v["com_y"]
    # of the plate's grip about the centre of mass
    arm = pushing.RADIUS + cx * normal[0] + cy * normal[1]
    drag = jnp.clip(
        (touch.slip + pushing.RADIUS * rate_z) / (1.0 + light * arm * arm), -touch.grip, touch.grip
    )
    # from here on the speed of the centre of mass
    vx, vy = vx - rate_z * cy, vy + rate_z * cx
    turning = dt * touch.force * (cy * normal[0] - cx * normal[1]) - drag * arm
    rate_z = rate_z + light * turning
    vx, vy = _kicked(n, (vx, vy), touch.force, drag)
    vx, vy, rate_z = _rubbed(n, (vx, vy, rate_z), (cx, cy), touch.pressed, local)
    turned = dt * rate_z * rate_z  # the mass goes round the axis
    vx, vy = vx + rate_z * cy + turned * cx, vy - rate_z * cx + turned * cy  # the axis's again
    return dx + after * vx, dy + after * vy, vx, vy, yaw + after * rate_z, rate_z


def _rubbed(n: _Numbers, motion: Any, centre: Any, pressed: Array, local: list) -> Any:
    """Velocity and rate of turning after the ground's friction at each point of the sole.

    Below the speed that a step's friction takes away it is viscous, so that no step turns a slip
    round. What is slower than 1e-6 m/s then is at rest.
    """
    (vx, vy, rate_z), (cx, cy), dt = motion, centre, n.scheme.dt
    slow = jnp.square(dt * sum(local) * pressed * (1.0 + n.v["spin"])) + 1e-16
    fx = fy = moment = 0.0
    for (a, q, _), friction in zip(n.spots, local, strict=True):
        lx, ly = a - cx, q - cy  # from the centre of mass
        sx, sy = vx - rate_z * ly, vy + rate_z * lx
        bx, by = _grained(n, sx, sy)
        by_slip = friction * pressed * jax.lax.rsqrt(jnp.maximum(sx * bx + sy * by, slow))
        px, py = by_slip * bx, by_slip * by
        fx, fy, moment = fx + px, fy + py, moment + lx * py - ly * px
    vx, vy, rate_z = vx - dt * fx, vy - dt * fy, rate_z - dt * n.light * moment
    moves = vx * vx + vy * vy + jnp.square(pushing.RADIUS * rate_z) > 1e-12
    return tuple(jnp.where(moves, z, 0.0) for z in (vx, vy, rate_z))
