"""MJCF files of machines: as declared, and with what the true machine has beside."""

from dataclasses import dataclass, field

import numpy as np

from tests.generators.mechanism_machines import G, Link, Machine, turned


@dataclass(frozen=True)
class Extras:
    """What the true machine has in its MJCF beside the declared: by joint name, in SI units;
    `gravity [3]`, `payload` kg.

    gear, kp and kv are factors; stiffness with its angle of rest; twist: stiffness and damping
    between a drive and its link.
    """

    frictionloss: dict[str, float] = field(default_factory=dict)
    armature: dict[str, float] = field(default_factory=dict)
    stiffness: dict[str, tuple[float, float]] = field(default_factory=dict)
    gear: dict[str, float] = field(default_factory=dict)
    kp: dict[str, float] = field(default_factory=dict)
    kv: dict[str, float] = field(default_factory=dict)
    force: dict[str, float] = field(default_factory=dict)
    twist: dict[str, tuple[float, float]] = field(default_factory=dict)
    gravity: np.ndarray = field(default_factory=lambda: np.array([0, 0, -G]))
    payload: float = 0.0


def number(values) -> str:
    return " ".join(f"{v:.9g}" for v in np.atleast_1d(values))


def to_xml(
    machine: Machine,
    mode: str,
    gains: np.ndarray,
    extras: Extras | None = None,
    actuators: bool = True,
) -> str:
    """mode: torque (motors) or position (servos with `gains [n, 2]`: kp, kv)."""
    x = extras or Extras()
    lines = [
        f'<mujoco model="{machine.name}">',
        '  <compiler angle="radian"/>',
        f'  <option timestep="0.0005" integrator="implicitfast" gravity="{number(x.gravity)}"/>',
        "  <worldbody>",
    ]
    depth = 2
    for link in machine.links:
        body = _body(link, x)
        lines += _nested(body, depth)
        depth += len(body)
    pad = "  " * depth
    if x.payload:
        r = 0.4 * x.payload * 0.03**2
        lines += [
            f'{pad}<body name="payload" pos="{number(machine.tip)}">',
            f'{pad}  <inertial pos="0 0 0" mass="{x.payload:.9g}" '
            f'diaginertia="{number([r, r, r])}"/>',
            f"{pad}</body>",
        ]
    lines += ["  " * k + "</body>" for k in range(depth - 1, 1, -1)] + ["  </worldbody>"]
    if actuators:
        lines += [
            "  <actuator>",
            *(_actuator(machine.links[j].name, mode, gains[j], x) for j in machine.driven),
            "  </actuator>",
        ]
    return "\n".join([*lines, "</mujoco>", ""])


def _nested(bodies: list[list[str]], depth: int) -> list[str]:
    """Each body within the one before; the first line of each opens it."""
    return [
        "  " * (depth + k + (i > 0)) + line
        for k, body in enumerate(bodies)
        for i, line in enumerate(body)
    ]


def _body(link: Link, x: Extras) -> list[list[str]]:
    """The link, behind a massless drive where it has a spring between."""
    joint = {"damping": link.damping, "armature": link.armature + x.armature.get(link.name, 0.0)}
    if loss := x.frictionloss.get(link.name, 0.0):
        joint |= {
            "frictionloss": loss,
            "solreffriction": [2e-3, 1.0],
            "solimpfriction": [0.99, 0.999, 1e-3, 0.5, 2.0],
        }
    if link.name in x.stiffness:
        joint["stiffness"], joint["springref"] = x.stiffness[link.name]
    text = " ".join(f'{key}="{number(v)}"' for key, v in joint.items() if np.any(v))
    i = turned(link)
    full = number([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
    mass = f'<inertial pos="{number(link.com)}" mass="{link.mass:.9g}" fullinertia="{full}"/>'
    own = f'<joint name="{link.name}" type="{link.kind}" axis="{number(link.axis)}" {text}/>'
    opened = f'<body name="link_{link.name}" pos="{number(link.at)}">'
    if link.name not in x.twist:
        return [[opened, mass, own]]
    stiff, damp = x.twist[link.name]
    spring = f'stiffness="{stiff:.9g}" damping="{damp:.9g}"'
    bend = (
        f'<joint name="twist_{link.name}" type="{link.kind}" axis="{number(link.axis)}" {spring}/>'
    )
    tiny = '<inertial pos="0 0 0" mass="1e-4" diaginertia="1e-8 1e-8 1e-8"/>'
    return [
        [f'<body name="drive_{link.name}" pos="{number(link.at)}">', tiny, own],
        [f'<body name="link_{link.name}">', mass, bend],
    ]


def _actuator(name: str, mode: str, gains: np.ndarray, x: Extras) -> str:
    more = f' gear="{x.gear[name]:.9g}"' if name in x.gear and mode == "torque" else ""
    if name in x.force:
        more += f' forcerange="{-x.force[name]:.9g} {x.force[name]:.9g}"'
    if mode == "torque":
        return f'    <motor name="{name}" joint="{name}"{more}/>'
    kp, kv = gains * [x.kp.get(name, 1.0), x.kv.get(name, 1.0)]
    return f'    <position name="{name}" joint="{name}" kp="{kp:.9g}" kv="{kv:.9g}"{more}/>'
