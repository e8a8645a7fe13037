"""Actuators of a mechanism: what a command makes of a joint's position and speed.

All kinds are one law, MuJoCo's with affine bias: with `length = gear q` and `speed = gear v`,

    force = gain ctrl + offset - kp length - kv speed        the joint gets gear * (force within
    forcerange)

A motor has gain 1, kp = kv = 0; a position servo gain = kp, a velocity servo gain = kv; a dcmotor
(volts) gain = K / R and kv = K^2 / R; `general` is any other. Ranges are nan where there is none.
"""

from dataclasses import dataclass

NO_RANGE = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Actuator:
    """One actuator. `joint` is an index into the tree; `delay` and `lag` (a first-order filter of
    the command) in s; more: other joints that it pulls by a tendon, each with its own gear.
    """

    name: str
    joint: int
    kind: str
    gear: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    kp: float = 0.0
    kv: float = 0.0
    forcerange: tuple[float, float] = NO_RANGE
    ctrlrange: tuple[float, float] = NO_RANGE
    delay: float = 0.0
    lag: float = 0.0
    more: tuple[tuple[int, float], ...] = ()
