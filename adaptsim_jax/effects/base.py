"""What a model may lack: `Effect`, one record for joints of machines, short trials, MuJoCo and
simulators of one's own.

An effect of a joint acts on the *command*, as a *force*, or on the *measurement*. Its one pure
function is written elementwise on arrays, so the same lines serve one joint, all joints, and a
batch. Any other frees parameters that the model has in its own equations (which way gravity pulls,
how hard a contact is) and has no function.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

from adaptsim_jax.core.errors import BadInput

PLACES = ("command", "force", "drive", "measurement", "model")
UNITS = {
    "1": (0, 0),
    "1/rad": (0, 0),
    "1/rad^2": (0, 0),
    "rad": (0, 0),
    "rad/s": (0, -1),
    "s": (0, 1),
    "Hz": (0, -1),
    "N m": (1, 0),
    "N m/rad": (1, 0),
    "N m s/rad": (1, 1),
    "N m s^2/rad^2": (1, 2),
    "kg m^2": (1, 2),
    "kg m": (1, 2),
    "kg": (1, 2),
    "N m s": (1, 1),
    "rad/(N m)": (-1, 0),
}
"""Exponents (torque, time) of each unit: multiply torques by a and times by b and a value goes up
by a^i b^j.
"""
OF_A_SLIDE = {
    "rad": "m",
    "rad/s": "m/s",
    "1/rad": "1/m",
    "1/rad^2": "1/m^2",
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "kg m^2": "kg",
    "N m s": "N s",
    "rad/(N m)": "m/N",
}
"""The units of a joint that slides, where those of one that turns are written."""
OF_SPEED = re.compile(r"N m s\^([1-9])/rad\^\1")  # a torque by a power of the speed
SLOWEST = 0.1  # rad/s: a joint that hardly moves says nothing of what its motion could do


def unit_at(unit: str, kind: str) -> str:
    """A parameter's unit at a joint of that kind, `hinge` or `slide`."""
    if power := OF_SPEED.fullmatch(unit):
        if kind == "slide":
            return f"N s^{power[1]}/m^{power[1]}"
        return unit
    if kind == "slide":
        return OF_A_SLIDE.get(unit, unit)
    return unit


def exponents(unit: str) -> tuple[int, int] | None:
    """Exponents (torque, time) of a unit (`UNITS`); None where it is unknown."""
    power = OF_SPEED.fullmatch(unit)
    if power:
        return (1, int(power[1]))
    return UNITS.get(unit)


@dataclass(frozen=True)
class Quantity:
    """One number of a model. `default` is the value of an amplitude at which its effect is not
    there, of a shape (a speed, an order, an angle) one to begin with, of a declared number where
    its fit begins.

    - `low`, `high`: Bounds in `unit`; of an effect at a joint times the rig's torque scale where
      the unit holds N m (`UNITS`). So one entry serves a finger and an excavator. Wider for slow
      joints (`bounds`).
    - `shape`: It says how an effect acts, not how much.
    - `sign`: It is +1 where only positive values are that effect.
    - `held`: A shape that is chosen on the grid and not fitted.
    - `optional`: It may be left out of a `model.toml`, and is `default` there.
    - `meaning`: What it is, where its name does not say.
    - `prior`: Standard deviation about `default` beforehand, in `unit`; at a joint scaled as the
      bounds are.
    - `mjcf`: What of a joint (damping, frictionloss, armature, stiffness, preload), of its actuator
      (gain, kp, delay, lag, limit), or of a tossed body (inertia, ipos, size) and its world
      (gravity), a model file changes to hold it; empty where none.
    - `factor`: A share more (0: none), which people read as a factor (1: none).
    - `scale`: A size that matters, in `unit`: the unit of steps of fits to short trials.
    """

    name: str
    unit: str
    low: float
    high: float
    default: float = 0.0
    shape: bool = False
    sign: int = 0
    held: bool = False
    optional: bool = False
    meaning: str = ""
    prior: float = float("inf")
    mjcf: str = ""
    factor: bool = False
    scale: float = 1.0

    def bounds(self, torque: float, speed: float = 1.0) -> tuple[float, float]:
        """Bounds for a rig whose torques are of size `torque` N m. Of a joint slower than 1 rad/s,
        `speed` rad/s, those of what makes a torque of its motion (a drag) are as much wider as it
        takes for the same torque.
        """
        torques, times = exponents(self.unit) or (0, 0)
        if torques:
            slowness = max(1.0, 1.0 / max(speed, SLOWEST)) ** max(times, 0)
        else:
            slowness = 1.0
        return self.low * torque**torques * slowness, self.high * torque**torques * slowness


class Motion(NamedTuple):
    """What a force effect is given.

    - `q, v, u [n, ...]`: Angle, speed and the actuator's torque, rad, rad/s, N m.
    - `t [1, ...]`: Time since the trial began, s.
    - `gravity(q) -> [n, ...]`: Force of gravity, N m.
    - `pull [n, ...]`: The part of `u` that follows the command and the angle.
    - `target [n, ...]`: The command.
    """

    q: Any
    v: Any
    u: Any
    t: Any
    gravity: Callable
    pull: Any
    target: Any


class Dry(NamedTuple):
    """Dry friction: a `level` [N m] that opposes the motion or holds the joint still, and a smooth
    `force` beside it.

    The level is a number, not a force, because only the integrator knows which force at rest stops
    the motion. What holds it is a spring that gives way by `yielding` [rad/(N m)].
    """

    level: jax.Array
    force: jax.Array | float = 0.0
    yielding: jax.Array | float = 0.0


class Drive(NamedTuple):
    """What an effect of the place `drive` says of joints, `[n, .]` each.

    - `compliance`: Of its spring, rad/(N m). 0: rigid.
    - `damping`: Of a dashpot beside the spring, over its stiffness, s.
    - `gap`: Its play, rad.
    - `link`: 1 where the log's encoder is on the link's side, 0 on the rotor's.
    - `control`: The same of the encoder that the controller has.
    """

    compliance: jax.Array
    damping: jax.Array
    gap: jax.Array
    link: jax.Array
    control: jax.Array


@dataclass(frozen=True)
class Reach:
    """What the data cover, per joint `[n]`: from it shape grids and bounds are made."""

    torque: np.ndarray  # N m, exceeded by 0.2 % of the samples
    peak: np.ndarray  # N m, the largest
    speed: np.ndarray  # rad/s, 90 % quantile of |v|
    q_low: np.ndarray
    q_high: np.ndarray
    duration: float  # s, of a trial
    dt: float  # s, median row, of trials at several rates the longest
    inertia: np.ndarray  # kg m^2


@dataclass(frozen=True)
class Traits:
    """What searches, reports and model files ask of an effect, whatever its name (of mechanisms).

    - on_actuator: A force that changes what an actuator gives. None at joints without one.
    - of_controller: Only joints that a position controller holds have it.
    - scales_drive: A share more of what the drive gives.
    - shared: Tried with one value for all joints too, as of one computer that commands them.
    - family: Tried at all joints at once too, with own values, as of like drives.
    - tried_first: Its place among what the balance adds at all joints before all else; 0: none.
    - prior: Standard deviation of its amplitudes beforehand, in the balance of torques.
    - in_balance: Whether the balance of torques shows it; None: forces and commands, no sensors.
    - at_parents: It shows at all joints that carry its own.
    - resists: It opposes the motion, whatever the time and the torque's direction.
    - fitted: Its parameters are fitted whatever is named.
    """

    on_actuator: bool = False
    of_controller: bool = False
    scales_drive: bool = False
    shared: bool = False
    family: bool = False
    tried_first: int = 0
    prior: float = float("inf")
    in_balance: bool | None = None
    at_parents: bool = False
    resists: bool = False
    fitted: bool = False


def of_the_engine(*_):
    """`apply` of what frees parameters of the model itself, which the engine has in its
    equations.
    """
    raise TypeError("this effect has no function of its own: its parameters are the model's")


@dataclass(frozen=True)
class Effect:
    """One effect. `apply` is its one function, by place:

    - command: `apply(p, t [T, ...], u [T, ...]) -> u'`: a whole trial's command, each value held to
      the next row;
    - force: `apply(p, motion) -> force [n, ...]`, or `Dry` friction. Where `inertia` is true,
      `apply(p) -> kg m^2` added to the joint.
    - drive: `apply(p) -> Drive` (`attribution/drive.py`) between a joint's rotor and its link;
    - measurement: `apply(p, t [T, ...], q [T, ...], v [T, ...], first [...]) -> (q', v')`: what the
      sensor of one joint says; `first` is the angle that it did say at the first time, for sensors
      that remember;
    - model, or a simulator's own name for where it acts: `of_the_engine`.

    `p` maps parameter names to arrays that broadcast, of the rank of `u` or `q`. `grid(reach,
    joint) -> [{shape: value}, ...]` lists the fixed shapes at which the effect is scored; with
    `jump` the amplitude is on the grid too, as it does not act linearly.

    - `starts(reach, joint) -> [{parameter: value}, ...]`: Where plain fits of it start as well, if
      a linear score is a poor guide.
    - `look_alikes`: What it is mistaken for at its joint, or itself, at another; of short trials
      declared quantities that may take it up. `contains` names effects that this one includes as a
      special case (of mechanisms it is tried where one of these is).
    - `same`: Other effects (`name@place`) that no recording of that kind tells apart from it;
      `separated_by`: what does.
    - `pair`: Its force is on the joint and on the one before it, too.
    - `carried`: A measurement effect that is also given the torque [N m] which the joint's drive
      carries, `apply(p, t, q, v, first, torque)`.
    - `slack`: Of a measurement effect, its parameter within which the reading does not tell the
      angle: stretches are also begun with the angle at either end of it.
    - `describes`: It is no law but a form that fits many (of mechanisms it must take off
      `Criteria.described`).
    - `formula`: The physics in a line, for people.
    - `title`: Its name in reports, where the name with blanks says too little.
    - `traits`: What searches ask of it; those below are derived.
    """

    name: str
    place: str
    parameters: tuple[Quantity, ...]
    apply: Callable = of_the_engine
    physics: str = ""
    excitation: str = ""
    look_alikes: tuple[str, ...] = ()
    scope: str = "joint"
    inertia: bool = False
    jump: bool = False
    pair: bool = False
    carried: bool = False
    slack: str = ""
    describes: bool = False
    contains: tuple[str, ...] = ()
    grid: Callable[[Reach, int], list[dict[str, float]]] | Sequence[Mapping[str, float]] | None = (
        field(
            default=None,
            # a list of dictionaries has no hash, and effects are static arguments of compiled
            # functions
            hash=False,
        )
    )
    starts: Callable[[Reach, int], list[dict[str, float]]] | None = None
    formula: str = ""
    title: str = ""
    traits: Traits = Traits()
    same: tuple[str, ...] = ()
    separated_by: str = ""

    def __post_init__(self):
        if self.apply is of_the_engine:
            return
        if self.place not in PLACES:
            raise BadInput(
                f"effect {self.name}: place {self.place!r} is unknown; use one of "
                f"{', '.join(PLACES)}"
            )
        if self.scope not in ("joint", "base"):
            raise BadInput(
                f"effect {self.name}: scope {self.scope!r} is unknown; use 'joint' or 'base'"
            )
        for p in self.parameters:
            if exponents(p.unit) is None:
                valid = f"{', '.join(UNITS)}, N m s^K/rad^K"
                raise BadInput(
                    f"effect {self.name}: unit {p.unit!r} is unknown; use one of {valid}"
                )
        if not self.amplitudes:
            raise BadInput(
                f"effect {self.name}: no parameter turns it off; give one that is no shape"
            )

    @property
    def key(self) -> str:
        """The name by which a search of short trials knows it."""
        return self.name

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def amplitudes(self) -> tuple[Quantity, ...]:
        return tuple(p for p in self.parameters if not p.shape)

    @property
    def shapes(self) -> tuple[Quantity, ...]:
        return tuple(p for p in self.parameters if p.shape)

    @property
    def on_actuator(self) -> bool:
        """Whether only a joint with an actuator can have it."""
        return self.place in ("command", "drive") or self.carried or self.traits.on_actuator

    @property
    def scales_torque(self) -> bool:
        """Whether it changes the torque that an actuator makes of its command, row by row."""
        return self.place == "force" and self.traits.on_actuator

    @property
    def in_balance(self) -> bool:
        """Whether the balance of torques along the measured motion shows it."""
        if self.traits.in_balance is not None:
            return self.traits.in_balance
        return self.place in ("force", "command", "model")

    @property
    def shifts_time(self) -> bool:
        """Whether it moves commands or readings in time, by an amplitude in s."""
        return self.place in ("command", "measurement") and self.amplitudes[0].unit == "s"

    @property
    def shifts_commands(self) -> bool:
        """Whether it moves commands in time."""
        return self.place == "command" and self.shifts_time

    @property
    def pairs_rows(self) -> bool:
        """Whether it says how commands and angles were paired: they may be early, too."""
        return self.shifts_commands and self.amplitudes[0].low < 0.0

    @property
    def in_mjcf(self) -> bool:
        """Whether an MJCF can hold it, at a joint, at its actuator, or as a body."""
        return self.place == "model" or any(p.mjcf for p in self.parameters)

    @property
    def held_by_file(self) -> bool:
        """Whether any model file holds it, whatever drives its joints."""
        return self.in_mjcf and not self.on_actuator

    @property
    def points(self) -> Sequence[Mapping[str, float]]:
        """Fixed shapes to score at, whatever the data cover; one point of defaults where it lists
        none.
        """
        if self.grid is None or callable(self.grid):
            return [{p.name: p.default for p in self.shapes}]
        return self.grid

    def grid_points(self, reach: Reach, joint: int) -> Sequence[Mapping[str, float]]:
        """Return shapes to score at over what the data cover."""
        if callable(self.grid):
            return self.grid(reach, joint)
        return self.points
