"""The effects' own formulas, each a function of the true motion; signs as a force on the joint. SI
units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Effect:
    """An effect at joints (numbers), each with its own params; outside: no catalogue has it."""

    name: str
    joints: tuple[int, ...]
    params: tuple[dict[str, float], ...]
    outside: bool = False

    def each(self) -> list[tuple[int, dict[str, float]]]:
        """Joints with their params; none where the params are the whole machine's."""
        return (
            list(zip(self.joints, self.params, strict=True))
            if len(self.joints) == len(self.params)
            else []
        )


class Motion(NamedTuple):
    """At time t, step s: q, v, u (actuators' forces), c (commands as they arrive) `[K, n]`; servo
    `[n, 2]`.
    """

    t: float
    s: int
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    c: np.ndarray
    servo: np.ndarray


Force = Callable[[dict[str, float], Motion, int], np.ndarray]


def _stop(p, x, j):
    depth = np.maximum(p["side"] * (x.q[:, j] - p["angle"]), 0.0)
    speed = p["side"] * x.v[:, j]
    return -p["side"] * p["stiffness"] * depth * np.clip(1 + p["loss"] * speed, 0.0, 3.0)


def _magnet(p, x, j):
    away = (x.q[:, j] - p["angle"]) / p["width"]
    return -1.65 * p["size"] * away * np.exp(-0.5 * away**2)


def _periodic(p, x, j):
    start = p["phase"] + 2.4 * np.arange(len(x.q))  # a trial begins at any time of the period
    return p["size"] * np.sin(2 * np.pi * p["frequency"] * x.t + start)


@lru_cache(maxsize=4)
def _wander_paths(seed: int, trials: int, steps: int = 14000, step: float = 5e-4) -> np.ndarray:
    """Ornstein-Uhlenbeck processes of unit variance and 0.5 s, smoothed over 50 ms, `[steps,
    trials]`.
    """
    rng = np.random.default_rng(seed)
    out, x, keep = np.zeros((steps, trials)), rng.normal(size=trials), np.exp(-step / 0.5)
    y = x.copy()
    for s, kick in enumerate(rng.normal(size=(steps, trials)) * np.sqrt(1 - keep**2)):
        x = keep * x + kick
        y = y + (x - y) * step / 0.05
        out[s] = y
    return out


FORCES: dict[str, Force] = {
    "quadratic_drag": lambda p, x, j: -p["drag"] * x.v[:, j] * np.abs(x.v[:, j]),
    "spring": lambda p, x, j: -p["stiffness"] * (x.q[:, j] - p["rest"]),
    "bias": lambda p, x, j: np.full(len(x.q), p["torque"]),
    "cogging": lambda p, x, j: p["size"] * np.sin(p["order"] * x.q[:, j] + p["phase"]),
    "hard_stop": _stop,
    "magnet": _magnet,
    "periodic_torque": _periodic,
    "wandering_torque": lambda p, x, j: p["size"] * _wander_paths(int(p["seed"]), len(x.q))[x.s],
}
"""Of one joint."""

LEVELS: dict[str, Force] = {
    "coulomb": lambda p, x, j: np.full(len(x.q), p["level"]),
    "asymmetric_coulomb": lambda p, x, j: p["difference"] * np.tanh(x.v[:, j] / 1e-3),
    "stribeck": lambda p, x, j: p["excess"] * np.exp(-((x.v[:, j] / p["speed"]) ** 2)),
    "load_friction": lambda p, x, j: p["share"] * np.abs(x.u[:, j]),
    "place_friction": lambda p, x, j: (
        p["level"] * (1 + p["depth"] * np.sin(p["order"] * x.q[:, j] + p["phase"]))
    ),
}
"""Levels of dry friction, which add up; an asymmetry and an excess stand beside a `coulomb` of the
same joint.
"""


def _coupling(e: Effect, x: Motion) -> np.ndarray:
    """From the potential size cos(qa - ratio qb - rest): a cable over two joints that grips
    unevenly.
    """
    (a, b), p, out = e.joints, e.params[0], np.zeros(x.q.shape)
    pull = p["size"] * np.sin(p["order"] * (x.q[:, a] - p["ratio"] * x.q[:, b]) - p["rest"])
    out[:, a], out[:, b] = pull, -p["ratio"] * pull
    return out


def _torque_coupling(e: Effect, x: Motion) -> np.ndarray:
    (a, b), p, out = e.joints, e.params[0], np.zeros(x.q.shape)
    out[:, b], out[:, a] = p["onto"] * x.u[:, a], p["back"] * x.u[:, b]
    return out


def _friction_coupling(e: Effect, x: Motion) -> np.ndarray:
    (a, b), p, out = e.joints, e.params[0], np.zeros(x.q.shape)
    out[:, b], out[:, a] = -p["damping"] * x.v[:, a], -p["damping"] * x.v[:, b]
    return out


WHOLE: dict[str, Callable[[Effect, Motion], np.ndarray]] = {
    "coupling": _coupling,
    "torque_coupling": _torque_coupling,
    "friction_coupling": _friction_coupling,
}
"""Of several joints at once."""


def _delay(e, c, history, s, memory, step):
    """Half of the change a step before, as everywhere; a negative delay is one of the log alone."""
    for j, p in e.each():
        back = round(p["delay"] / step)
        if back > 0:
            c[:, j] = 0.5 * (history[max(s - back, 0), :, j] + history[max(s - back - 1, 0), :, j])


def _lag(e, c, history, s, memory, step):
    for j, p in e.each():
        old = memory.get(j, c[:, j].copy())
        memory[j] = c[:, j] + (old - c[:, j]) * np.exp(-step / p["lag"])
        c[:, j] = memory[j]


COMMAND = {"delay": _delay, "actuator_lag": _lag}
"""Effects on the command `c [K, n]` on its way, in place."""


def _output(law):
    def apply(e: Effect, u: np.ndarray, x: Motion) -> np.ndarray:
        out = u.copy()
        for j, p in e.each():
            out[:, j] = law(p, x, j)
        return out

    return apply


OUTPUT = {
    "torque_gain": _output(lambda p, x, j: (1 + p["gain"]) * x.u[:, j]),
    "position_gain": _output(
        lambda p, x, j: x.u[:, j] + p["gain"] * x.servo[j, 0] * (x.c[:, j] - x.q[:, j])
    ),
    "saturation": _output(lambda p, x, j: np.clip(x.u[:, j], -p["limit"], p["limit"])),
    "dead_zone": _output(lambda p, x, j: x.u[:, j] - np.clip(x.u[:, j], -p["width"], p["width"])),
}
"""Effects on the actuators' forces."""
