"""Machines drawn at random within a family.

A link's inertia is about its centre of mass, along the axes of its body. Joint values are 0 in the
file's own pose.
"""

from dataclasses import dataclass, field, replace

import numpy as np

G = 9.81
MACHINES = ("pendulum", "double_pendulum", "cart_pole", "furuta", "arm3", "arm6")


@dataclass(frozen=True)
class Link:
    """A body with one joint. `at [3]`: the joint in the parent's body; `com [3]` m; `inertia [3]`
    kg m^2, principal, turned about the axes by `turn [3]` rad; `reach`: amplitude of the motion
    wanted, rad or m; `home`: value it moves about.
    """

    name: str
    kind: str
    axis: tuple[float, float, float]
    at: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    damping: float
    armature: float = 0.0
    turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    reach: float = 0.8
    home: float = 0.0


@dataclass(frozen=True)
class Machine:
    """`driven`: numbers of the joints that have an actuator. `tip [3]`: in the last body, where a
    payload hangs.
    """

    name: str
    links: tuple[Link, ...]
    driven: tuple[int, ...]
    tip: np.ndarray

    @property
    def n(self) -> int:
        return len(self.links)

    @property
    def joints(self) -> list[str]:
        return [link.name for link in self.links]


def draw_machine(rng: np.random.Generator, name: str) -> Machine:
    """A member of the family."""
    return {
        "pendulum": _pendulum,
        "double_pendulum": _double_pendulum,
        "cart_pole": _cart_pole,
        "furuta": _furuta,
        "arm3": _arm3,
        "arm6": _arm6,
    }[name](rng)


def _rod(rng, name, axis, at, length, mass, along=(0.0, 0.0, -1.0), damping=None, **more) -> Link:
    """A rod with its centre of mass near its middle, a little off its line; damping about 0.1 to
    0.3 of what stops a swing.
    """
    along = np.asarray(along)
    com = along * length * rng.uniform(0.4, 0.65) + rng.normal(0, 0.01, 3) * length
    thin, wide = (
        mass * length**2 * rng.uniform(0.003, 0.01),
        mass * length**2 * rng.uniform(0.06, 0.1),
    )
    inertia = np.where(np.abs(along) > 0.5, thin, wide * np.array([1.0, 0.99, 0.98]))
    if damping is None:
        damping = rng.uniform(0.06, 0.2) * mass * length**2 * np.sqrt(G / length) / 3
    return Link(
        name,
        "hinge",
        axis,
        np.asarray(at, float),
        mass,
        com,
        inertia,
        damping,
        turn=rng.normal(0, 0.03, 3),
        **more,
    )


def _pendulum(rng) -> Machine:
    length, mass = rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.5)
    link = _rod(rng, "swing", (0, 1, 0), (0, 0, 0), length, mass, reach=rng.uniform(0.9, 1.5))
    return Machine("pendulum", (link,), (0,), np.array([0, 0, -length]))


def _double_pendulum(rng) -> Machine:
    l1, l2 = rng.uniform(0.2, 0.4, 2)
    m1, m2 = rng.uniform(0.4, 1.0), rng.uniform(0.2, 0.6)
    first = _rod(rng, "upper", (0, 1, 0), (0, 0, 0), l1, m1, reach=rng.uniform(0.6, 1.0))
    second = _rod(rng, "lower", (0, 1, 0), (0, 0, -l1), l2, m2, reach=rng.uniform(0.7, 1.2))
    return Machine("double_pendulum", (first, second), (0, 1), np.array([0, 0, -l2]))


def _cart_pole(rng) -> Machine:
    mass, length, m2 = rng.uniform(0.5, 1.5), rng.uniform(0.25, 0.6), rng.uniform(0.1, 0.4)
    cart = Link(
        "rail",
        "slide",
        (1, 0, 0),
        np.zeros(3),
        mass,
        np.zeros(3),
        mass * 0.003 * np.ones(3),
        damping=rng.uniform(0.5, 2.0) * mass,
        reach=rng.uniform(0.07, 0.15),
    )
    pole = _rod(
        rng,
        "pole",
        (0, 1, 0),
        (0, 0, 0),
        length,
        m2,
        damping=rng.uniform(0.02, 0.06) * m2 * length**1.5 * np.sqrt(G),
    )
    return Machine("cart_pole", (cart, pole), (0,), np.array([0, 0, -length]))


def _furuta(rng) -> Machine:
    r, length = rng.uniform(0.15, 0.3), rng.uniform(0.15, 0.35)
    m1, m2 = rng.uniform(0.2, 0.6), rng.uniform(0.06, 0.2)
    arm = _rod(
        rng,
        "arm",
        (0, 0, 1),
        (0, 0, 0.1),
        r,
        m1,
        along=(1.0, 0.0, 0.0),
        damping=rng.uniform(0.5, 2.0) * (m1 * r**2 / 3 + m2 * r**2),
        reach=rng.uniform(0.6, 1.1),
    )
    free = _rod(
        rng,
        "free",
        (1, 0, 0),
        (r, 0, 0),
        length,
        m2,
        damping=rng.uniform(0.02, 0.06) * m2 * length**1.5 * np.sqrt(G),
    )
    return Machine("furuta", (arm, free), (0,), np.array([0, 0, -length]))


def _arm3(rng) -> Machine:
    l2, l3 = rng.uniform(0.2, 0.4, 2)
    m1, m2, m3 = rng.uniform(0.8, 2.0), rng.uniform(0.8, 2.0), rng.uniform(0.4, 1.2)

    def fall(m, l):
        return rng.uniform(0.1, 0.3) * m * l**1.5 * np.sqrt(G) / 3

    pan = Link(
        "pan",
        "hinge",
        (0, 0, 1),
        np.array([0, 0, 0.1]),
        m1,
        rng.normal(0, 0.01, 3),
        m1 * rng.uniform(0.002, 0.004, 3),
        damping=fall(m2 + m3, l2 + l3),
        reach=rng.uniform(0.7, 1.2),
    )
    lift = _rod(
        rng,
        "lift",
        (0, 1, 0),
        (0, rng.uniform(-0.05, 0.05), 0.1),
        l2,
        m2,
        along=(1.0, 0.0, 0.0),
        damping=fall(m2 + 2 * m3, l2),
        reach=rng.uniform(0.5, 0.8),
        home=rng.uniform(-0.6, 0.3),
    )
    elbow = _rod(
        rng,
        "elbow",
        (0, 1, 0),
        (l2, rng.uniform(-0.04, 0.04), 0),
        l3,
        m3,
        along=(1.0, 0.0, 0.0),
        damping=fall(m3, l3),
        reach=rng.uniform(0.6, 1.0),
        home=rng.uniform(0.2, 1.0),
    )
    return Machine("arm3", (pan, lift, elbow), (0, 1, 2), np.array([l3, 0, 0]))


def _arm6(rng) -> Machine:
    """In the proportions of a UR5e (masses, lengths and inertias as its maker's data sheet and its
    MJCF have them), or with a rolling forearm and wrist as other arms of six joints.
    """
    s, w = rng.uniform(0.8, 1.2), rng.uniform(0.7, 1.3)
    rolls = bool(rng.integers(2))
    arm = rng.uniform(0.05, 0.15, 6) * [1, 1, 1, 0.1, 0.1, 0.1] * w
    damping = rng.uniform(1.0, 4.0, 6) * [1, 1, 0.6, 0.12, 0.12, 0.08] * w
    home = np.array([0.0, -1.0, 1.2, -0.6, 0.4, 0.0]) + rng.uniform(-0.25, 0.25, 6)
    reach = rng.uniform(0.5, 1.0, 6) * [1.0, 0.6, 0.7, 1.0, 1.0, 1.3]
    tool = rng.uniform(0.4, 0.9) * w
    mass = np.array([3.7, 8.393, 2.275, 1.219, 1.219, 0.1889]) * w
    size = (
        np.array(
            [
                [0.0103, 0.0103, 0.0067],
                [0.0151, 0.1339, 0.1339],
                [0.0041, 0.0312, 0.0312],
                [0.0026, 0.0022, 0.0026],
                [0.0026, 0.0026, 0.0022],
                [0.0002, 0.0002, 0.0002],
            ]
        )
        * w
        * s**2
    )
    com = (
        np.array(
            [[0, 0, 0], [0.2125, 0, 0], [0.196, 0, 0], [0, 0.127, 0], [0, 0, -0.1], [0, 0.077, 0]]
        )
        * s
    )
    at = (
        np.array(
            [
                [0, 0, 0.163],
                [0, 0.138, 0],
                [0.425, -0.131, 0],
                [0.392, 0, 0],
                [0, 0.127, 0],
                [0, 0, -0.1],
            ]
        )
        * s
    )
    axes: list[tuple[float, float, float]] = [
        (0, 0, 1),
        (0, 1, 0),
        (0, 1, 0),
        (0, 1, 0),
        (0, 0, -1),
        (0, 1, 0),
    ]
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    if rolls:
        axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
        at = (
            np.array(
                [
                    [0, 0, 0.25],
                    [0, 0, 0],
                    [0.425, 0, 0],
                    [0.15, 0, 0.03],
                    [0.24, 0, 0],
                    [0.09, 0, 0],
                ]
            )
            * s
        )
        com = (
            np.array(
                [
                    [0, 0, 0],
                    [0.2, 0, 0],
                    [0.07, 0, 0.02],
                    [0.15, 0, 0],
                    [0.04, 0, 0.01],
                    [0.06, 0, 0],
                ]
            )
            * s
        )
        names = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6"]
    # the tool, off the last axis so that the last joint carries something
    grip = com[5] + (np.array([0, 0.08, 0.06]) if not rolls else np.array([0.08, 0, 0.06])) * s
    com[5] = (mass[5] * com[5] + tool * grip) / (mass[5] + tool)
    mass[5] += tool
    size[5] += tool * 0.0016 * np.array([1.0, 1.1, 0.9])
    com = com + rng.normal(0, 0.004, (6, 3))
    links = tuple(
        Link(
            names[j],
            "hinge",
            axes[j],
            at[j],
            float(mass[j]),
            com[j],
            size[j],
            float(damping[j]),
            float(arm[j]),
            rng.normal(0, 0.03, 3),
            float(reach[j]),
            float(home[j]),
        )
        for j in range(6)
    )
    return Machine("arm6", links, tuple(range(6)), grip)


def misjudged(rng: np.random.Generator, machine: Machine) -> Machine:
    """As its file declares it: masses, centres of mass, inertias and dampings 10 to 30 % off, all
    else as it is.
    """

    def off(*shape):
        return 1 + rng.choice([-1, 1], shape or None) * rng.uniform(0.1, 0.3, shape or None)

    links = []
    for link in machine.links:
        com = link.com * off() + rng.normal(0, 0.02, 3) * np.linalg.norm(link.com)
        inertia = link.inertia * off()
        links.append(
            replace(
                link,
                mass=link.mass * float(off()),
                com=com,
                inertia=inertia,
                damping=link.damping * float(off()),
            )
        )
    return replace(machine, links=tuple(links))


def turned(link: Link) -> np.ndarray:
    """Inertia [3, 3] about the centre of mass, along the body's axes."""
    out = np.diag(link.inertia)
    for axis, angle in enumerate(link.turn):
        r = np.eye(3)
        i, k = (axis + 1) % 3, (axis + 2) % 3
        r[i, i] = r[k, k] = np.cos(angle)
        r[i, k], r[k, i] = -np.sin(angle), np.sin(angle)
        out = r @ out @ r.T
    return out
