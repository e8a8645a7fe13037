"""Two double-pendulum worlds in plain NumPy: rigid bodies, and the linearisation about upright of
the paper.

Everything is vectorised over lanes (one lane = one trial of one data set); joint quantities are
`[2, L]`.
q2 is relative to link 1. Textbook equations of motion of two links in a plane, written out here by
hand.
"""

from dataclasses import dataclass, fields

import numpy as np

G = 9.81


@dataclass(frozen=True)
class Rig:
    """True parameters of one rig. SI units; `sign` is +1 if q1 = 0 hangs down, -1 if it stands
    upright.
    """

    world: str  # rigid_body | linearized
    m: np.ndarray  # [2] kg
    l: np.ndarray  # [2] m
    c: np.ndarray  # [2] m, centre of mass from the joint
    inertia: np.ndarray  # [2] kg m2 about the centre of mass
    b: np.ndarray  # [2] N m s, viscous damping
    sign: float = 1.0

    def gravity_torque(self) -> np.ndarray:
        """Largest gravity torque of each joint, `[2]` N m: the natural scale of commands on this
        rig.
        """
        first = self.m[0] * self.c[0] + self.m[1] * (self.l[0] + self.c[1])
        return G * np.array([first, self.m[1] * self.c[1]])

    def declared(self) -> dict[str, float]:
        """True values of what a declared model can identify: masses and damping, or the rigid base
        parameters.

        p1, p3 are the inertias about joints 1 and 2 (with q2's cosine left out), h1, h2 the first
        moments.
        """
        (m1, m2), (c1, c2), (i1, i2), l1 = self.m, self.c, self.inertia, self.l[0]
        damping = {"b1": float(self.b[0]), "b2": float(self.b[1])}
        if self.world == "linearized":
            return {"m1": float(m1), "m2": float(m2)} | damping
        p3 = i2 + m2 * c2**2
        p1 = i1 + m1 * c1**2 + m2 * l1**2 + p3
        moments = {"p1": p1, "p3": p3, "h1": m1 * c1 + m2 * l1, "h2": m2 * c2}
        return {k: float(v) for k, v in moments.items()} | damping

    def truth(self) -> dict:
        return {f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}


def draw_rig(rng: np.random.Generator, world: str, angle_zero: str) -> Rig:
    """A random plausible rig. Linearised: unit lengths, point masses and damping in [1, 2] as in
    the paper.
    """
    if world == "linearized":
        one, zero = np.ones(2), np.zeros(2)
        return Rig(world, rng.uniform(1, 2, 2), one, one, zero, rng.uniform(1, 2, 2), -1.0)
    length = (
        rng.uniform(0.2, 0.5, 2) if rng.random() < 0.85 else np.array([1.0, rng.uniform(0.6, 1.0)])
    )
    length = np.round(length, 3)  # as somebody would have measured it
    m = rng.uniform(0.3, 1.5, 2)
    m[1] = min(m[1], 1.3 * m[0])
    c = length * rng.uniform(0.45, 0.9, 2)
    inertia = m * length**2 * rng.uniform(0.04, 0.12, 2)
    # Damping such that a free swing dies over a few to some tens of periods.
    scale = np.sqrt(G * m * c * (inertia + m * c**2))
    b = scale * rng.uniform(0.01, 0.06, 2)
    return Rig(world, m, length, c, inertia, b, 1.0 if angle_zero == "hanging" else -1.0)


@dataclass(frozen=True)
class Lanes:
    """Coefficients of the equations of motion, each `[L]` (b: `[2, L]`): what a batch of rigs needs
    to move.
    """

    linear: bool
    a1: np.ndarray  # rigid: I1 + m1 c1^2 + m2 l1^2;   linearised: m1
    a2: np.ndarray  # rigid: I2 + m2 c2^2;             linearised: m2
    a3: np.ndarray  # m2 c2
    a4: np.ndarray  # m1 c1 + m2 l1
    l1: np.ndarray
    b: np.ndarray
    sign: np.ndarray


def lanes_of(rigs: list[Rig], repeats: list[int]) -> Lanes:
    """Stack rigs (all of one world), each repeated for its trials."""
    linear = rigs[0].world == "linearized"
    rows = []
    for r in rigs:
        (m1, m2), (c1, c2), (i1, i2), l1 = r.m, r.c, r.inertia, r.l[0]
        if linear:
            rows.append((m1, m2, m2, m1 + m2, l1, *r.b, r.sign))
        else:
            a1, a2 = i1 + m1 * c1**2 + m2 * l1**2, i2 + m2 * c2**2
            rows.append((a1, a2, m2 * c2, m1 * c1 + m2 * l1, l1, *r.b, r.sign))
    t = np.repeat(np.array(rows), repeats, axis=0).T.copy()
    return Lanes(linear, t[0], t[1], t[2], t[3], t[4], t[5:7], t[7])


def mass_matrix(p: Lanes, q: np.ndarray, rotor: np.ndarray | float = 0.0):
    """(M11, M12, M22), each `[L]`, with optional rotor inertia `[2, L]` added on the diagonal."""
    j = np.broadcast_to(rotor, (2, *p.a1.shape)) if np.ndim(rotor) < 2 else rotor
    if p.linear:
        return p.a1 + 4 * p.a2 + j[0], 2 * p.a2, p.a2 + j[1]
    x = p.a3 * p.l1 * np.cos(q[1])
    return p.a1 + p.a2 + 2 * x + j[0], p.a2 + x, p.a2 + j[1]


def bias_torque(
    p: Lanes, q: np.ndarray, v: np.ndarray, tilt: np.ndarray | float = 0.0
) -> np.ndarray:
    """Coriolis plus gravity torque `[2, L]`; `tilt` turns the base against gravity [rad]."""
    if p.linear:
        q1 = q[0] + tilt
        return -G * np.stack([p.a1 * q1 + p.a2 * (2 * q1 + q[1]), p.a2 * (q1 + q[1])])
    q1 = q[0] + tilt
    h = p.a3 * p.l1 * np.sin(q[1])
    lower = p.sign * G * p.a3 * np.sin(q1 + q[1])
    upper = p.sign * G * p.a4 * np.sin(q1) + lower
    out = np.empty_like(q)
    out[0] = upper - h * v[1] * (2 * v[0] + v[1])
    out[1] = lower + h * v[0] ** 2
    return out


def acceleration(p: Lanes, q, v, torque, tilt=0.0, rotor=0.0) -> np.ndarray:
    """Joint accelerations `[2, L]` under the net joint torque `[2, L]` (friction already
    subtracted).
    """
    m11, m12, m22 = mass_matrix(p, q, rotor)
    r = torque - bias_torque(p, q, v, tilt)
    out = np.empty_like(q)
    det = m11 * m22 - m12 * m12
    out[0] = (m22 * r[0] - m12 * r[1]) / det
    out[1] = (m11 * r[1] - m12 * r[0]) / det
    return out


def regressor(rig: Rig, q, v, a) -> np.ndarray:
    """Declared inverse dynamics, linear in base parameters: torque = Y theta. q, v, a `[N, 2]` -> Y
    `[2, N, P]`.
    """
    (q1, q2), (v1, v2), (a1, a2) = q.T, v.T, a.T
    z = np.zeros_like(q1)
    if rig.world == "linearized":
        m1 = [a1 - G * q1, z]
        m2 = [4 * a1 + 2 * a2 - G * (2 * q1 + q2), 2 * a1 + a2 - G * (q1 + q2)]
        cols = [m1, m2, [v1, z], [z, v2]]
    else:
        l1, s, co, si = rig.l[0], rig.sign, np.cos(q2), np.sin(q2)
        low = s * G * np.sin(q1 + q2)
        mc = [
            l1 * (co * (2 * a1 + a2) - si * v2 * (2 * v1 + v2)) + low,
            l1 * (co * a1 + si * v1**2) + low,
        ]
        cols = [[a1, z], [a1 + a2, a1 + a2], mc, [s * G * np.sin(q1), z], [v1, z], [z, v2]]
    return np.array(cols).transpose(1, 2, 0)


def base_parameters(rig: Rig) -> np.ndarray:
    """The true theta that belongs to `regressor`, `[P]`."""
    p = lanes_of([rig], [1])
    if rig.world == "linearized":
        return np.array([p.a1[0], p.a2[0], *rig.b])
    return np.array([p.a1[0], p.a2[0], p.a3[0], p.a4[0], *rig.b])
