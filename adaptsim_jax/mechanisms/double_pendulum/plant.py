"""The declared double pendulum as the closed loop knows it: the paper's linear one, and two rigid
links in base parameters.

q1 is the angle of link 1 from `angle_zero` (hanging or upright), q2 that of link 2 relative to link
1, both in rad and counter-clockwise. All dynamics of rigid links go through six *base parameters*
p1, p3, h1, h2 and the joints' dampings b1, b2, the most that motion and torque can fix (Gautier &
Khalil, "Direct calculation of minimum set of inertial parameters", IEEE T-RA 6(3), 1990):

    M11 = p1 + 2 l1 h2 cos q2    M12 = p3 + l1 h2 cos q2    M22 = p3
    p1 = I1 + m1 c1^2 + I2 + m2 (l1^2 + c2^2)    p3 = I2 + m2 c2^2    (kg m^2)
    h1 = m1 c1 + m2 l1                           h2 = m2 c2           (kg m)
"""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.mechanisms.plant import Plant


def base_parameters(mass, l1, com, inertia, damping):
    """`theta [6, ...] = p1, p3, h1, h2, b1, b2` of both links' masses kg, centres along the links
    m, moments about these kg m^2 and dampings N m s/rad, and the length l1 m. Many of these share
    one theta.
    """
    (m1, m2), (c1, c2), (I1, I2) = mass, com, inertia
    p3 = I2 + m2 * c2**2
    p1 = I1 + m1 * c1**2 + p3 + m2 * l1**2
    h1 = m1 * c1 + m2 * l1
    h2 = m2 * c2
    return jnp.stack([jnp.asarray(x) for x in (p1, p3, h1, h2, *damping)])


def _rigid_mass(c, theta, q):
    p1, p3, h2 = theta[0], theta[1], theta[3]
    couple = c["l1"] * h2 * sin_cos(q[1])[1]
    m12 = p3 + couple
    m11 = p1 + 2.0 * couple
    return (m11, m12), (m12, p3)


def _rigid_gravity(c, theta, q):
    first, second = sin_cos(jnp.stack([q[0], q[0] + q[1]]))[0]
    return jnp.stack(_rigid_weight(c, theta, first, second))


def _rigid_weight(c, theta, first, second):
    """Gravity on each joint from the sines of the links' angles."""
    weight = -c["gravity_sign"] * c["g"]
    outer = weight * theta[3] * second
    return weight * theta[2] * first + outer, outer


def _rigid_push(c, theta, q, v):
    """Coriolis, gravity and viscous forces of the rigid double pendulum (q2 relative to link 1)."""
    first, elbow, second = sin_cos(jnp.stack([q[0], q[1], q[0] + q[1]]))[0]
    bend = c["l1"] * theta[3] * elbow
    g1, g2 = _rigid_weight(c, theta, first, second)
    f1 = bend * v[1] * (2.0 * v[0] + v[1]) + g1 - theta[4] * v[0]
    f2 = g2 - bend * v[0] * v[0] - theta[5] * v[1]
    return jnp.stack([f1, f2])


def _linear_mass(c, theta, q):
    m1, m2 = theta[0], theta[1]
    return (m1 + 4.0 * m2, 2.0 * m2), (2.0 * m2, m2)


def _linear_gravity(c, theta, q):
    """Linearized about upright: g [[m1 + 2 m2, m2], [m2, m2]] q (the paper's A times M)."""
    return jnp.stack(_linear_weight(c, theta, q))


def _linear_weight(c, theta, q):
    m1, m2 = theta[0], theta[1]
    second = m2 * (q[0] + q[1])
    return c["g"] * ((m1 + m2) * q[0] + second), c["g"] * second


def _linear_push(c, theta, q, v):
    g1, g2 = _linear_weight(c, theta, q)
    return jnp.stack([g1 - theta[2] * v[0], g2 - theta[3] * v[1]])


def linearized_pendulum(
    angle_zero: str, geometry: Mapping[str, float], known: Mapping[str, float]
) -> Plant:
    """Links of unit length about upright; theta = m1, m2 [kg], b1, b2 [N m s/rad]. geometry: g
    [m/s^2]. A `known` name of theta is held at its value.
    """
    low, high = np.array([1e-3, 1e-3, 0.0, 0.0]), np.array([1e3, 1e3, 1e3, 1e3])
    names, units = ("m1", "m2", "b1", "b2"), ("kg", "kg", "N m s/rad", "N m s/rad")
    hold(names, known, low, high)
    constants = {"g": np.asarray(float(geometry.get("g", GRAVITY)))}
    return Plant(
        "pendulum/linearized",
        2,
        2,
        names,
        units,
        _linear_mass,
        _linear_push,
        _linear_gravity,
        constants,
        low,
        high,
    )


def rigid_pendulum(
    angle_zero: str, geometry: Mapping[str, float], known: Mapping[str, float]
) -> Plant:
    """Two rigid links; theta = p1 = I1 + m1 lc1^2 + m2 l1^2 + p3, p3 = I2 + m2 lc2^2 [kg m^2], h1 =
    m1 lc1 + m2 l1, h2 = m2 lc2 [kg m], b1, b2 [N m s/rad]. geometry: l1 [m], g [m/s^2]. A `known`
    name of theta is held at its value.

    Raises BadInput on an unknown angle zero or a missing length.
    """
    if angle_zero not in ("upright", "hanging"):
        raise BadInput(
            f"meta.toml: angle_zero {angle_zero!r} is unknown; use 'upright' or 'hanging'"
        )
    if "l1" not in geometry:
        raise BadInput("meta.toml: [geometry] lacks l1, the length of link 1; add it in metres")
    names = ("p1", "p3", "h1", "h2", "b1", "b2")
    units = ("kg m^2", "kg m^2", "kg m", "kg m", "N m s/rad", "N m s/rad")
    low = np.array([1e-6, 1e-6, -1e2, -1e2, 0.0, 0.0])
    high = np.array([1e3, 1e3, 1e3, 1e3, 1e3, 1e3])
    hold(names, known, low, high)
    sign = 1.0 if angle_zero == "hanging" else -1.0
    constants = {"l1": geometry["l1"], "g": geometry.get("g", GRAVITY), "gravity_sign": sign}
    return Plant(
        "pendulum/rigid_body",
        2,
        2,
        names,
        units,
        _rigid_mass,
        _rigid_push,
        _rigid_gravity,
        {k: np.asarray(float(v)) for k, v in constants.items()},
        low,
        high,
    )


def hold(
    names: Sequence[str], known: Mapping[str, float], low: np.ndarray, high: np.ndarray
) -> None:
    """Set both bounds `[P]` of what is known to its value."""
    for i, name in enumerate(names):
        if name in known:
            low[i] = high[i] = known[name]


JOINTS = ("joint1", "joint2")
THIN = 1e-2  # of a link's moment about its joint's axis: the moment about its own length


def links_of(theta: np.ndarray, l1: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, centres along the links and moments about the centres [2] each (kg, m, kg m^2) of
    base parameters [6].

    Many links share one theta. These are in the middle of what is physical: the second mass between
    the least that its own moments allow and the most that the first link's do. Base parameters that
    no two bodies have are moved to the nearest that some have.
    """
    p1, p3, h1, h2 = (float(z) for z in theta[:4])
    p3 = max(p3, 1e-9)
    rest = max(p1 - p3, 1.1 * (l1 * h2) ** 2 / p3, 1e-9)  # I1 + m1 c1^2 + m2 l1^2
    lowest, most = 1.02 * h2 * h2 / p3, 0.98 * rest / l1**2
    m2 = np.sqrt(max(lowest, 1e-3 * most) * most)
    first, own = h1 - m2 * l1, rest - m2 * l1**2  # m1 c1, I1 + m1 c1^2
    m1 = max(2.0 * first * first / own, 0.5 * m2)
    centre = np.array([first / m1, h2 / m2])
    mass = np.array([m1, m2])
    return mass, centre, np.array([own, p3]) - mass * centre**2


def double_pendulum_mjcf(theta: np.ndarray, geometry: Mapping[str, float], angle_zero: str) -> str:
    """MJCF text of base parameters `theta [6] = p1, p3, h1, h2, b1, b2` (`plant.py`), geometry `l1`
    m and `g` m/s^2.

    Joints `joint1` and `joint2` (relative) turn about the world's y axis; at zero the links hang or
    stand as `angle_zero` says. Links are thin: a body that is as thick as long has no less of a
    moment than its thickness gives it, however it is fitted.
    """
    length = float(geometry["l1"])
    mass, centre, moment = links_of(theta, length)
    down = -1.0 if angle_zero == "hanging" else 1.0
    link = []
    for k in range(2):
        damping = max(float(theta[4 + k]), 0.0)
        joint = f'<joint name="{JOINTS[k]}" type="hinge" axis="0 1 0" damping="{damping:.9g}"/>'
        inertial = (
            f'<inertial pos="0 0 {down * centre[k]:.9g}" mass="{mass[k]:.9g}" '
            f'diaginertia="{moment[k]:.9g} {moment[k]:.9g} {THIN * moment[k]:.9g}"/>'
        )
        link.append(joint + inertial)
    gravity = -float(geometry.get("g", GRAVITY))
    motors = "".join(f'    <motor name="{name}" joint="{name}"/>\n' for name in JOINTS)
    return (
        '<mujoco model="double_pendulum">\n'
        '  <compiler angle="radian" inertiafromgeom="false"/>\n'
        f'  <option timestep="0.001" gravity="0 0 {gravity:.9g}" integrator="implicitfast"/>\n'
        "  <worldbody>\n"
        f'    <body name="link1">{link[0]}\n'
        f'      <body name="link2" pos="0 0 {down * length:.9g}">{link[1]}</body>\n'
        "    </body>\n"
        "  </worldbody>\n"
        f"  <actuator>\n{motors}  </actuator>\n</mujoco>\n"
    )
