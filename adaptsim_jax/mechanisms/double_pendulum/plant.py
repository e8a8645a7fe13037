"""The declared double pendulum as MJCF, of its base parameters.

q1 is the angle of link 1 from `angle_zero` (hanging or upright), q2 that of link 2 relative to link
1, both in rad and counter-clockwise. All dynamics of rigid links go through six *base parameters*
p1, p3, h1, h2 and the joints' dampings b1, b2, the most that motion and torque can fix (Gautier &
Khalil, "Direct calculation of minimum set of inertial parameters", IEEE T-RA 6(3), 1990):

    M11 = p1 + 2 l1 h2 cos q2    M12 = p3 + l1 h2 cos q2    M22 = p3
    p1 = I1 + m1 c1^2 + I2 + m2 (l1^2 + c2^2)    p3 = I2 + m2 c2^2    (kg m^2)
    h1 = m1 c1 + m2 l1                           h2 = m2 c2           (kg m)
"""

from collections.abc import Mapping

import numpy as np

from adaptsim_jax.core.constants import GRAVITY

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
    remainder = max(p1 - p3, 1.1 * (l1 * h2) ** 2 / p3, 1e-9)  # I1 + m1 c1^2 + m2 l1^2
    lowest, highest = 1.02 * h2 * h2 / p3, 0.98 * remainder / l1**2
    m2 = np.sqrt(max(lowest, 1e-3 * highest) * highest)
    first, own_inertia = h1 - m2 * l1, remainder - m2 * l1**2  # m1 c1, I1 + m1 c1^2
    m1 = max(2.0 * first * first / own_inertia, 0.5 * m2)
    centre = np.array([first / m1, h2 / m2])
    mass = np.array([m1, m2])
    return mass, centre, np.array([own_inertia, p3]) - mass * centre**2


def double_pendulum_mjcf(theta: np.ndarray, geometry: Mapping[str, float], angle_zero: str) -> str:
    """MJCF text of base parameters `theta [6] = p1, p3, h1, h2, b1, b2`, geometry `l1`
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
        "    </body>\n  </worldbody>\n"
        f"  <actuator>\n{motors}  </actuator>\n</mujoco>\n"
    )
