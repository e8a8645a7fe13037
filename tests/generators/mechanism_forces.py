"""The effects' own formulas, each a function of the true motion; signs as a torque on the joint. SI units."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Effect:
    """An effect at joints (numbers), each with its own params; outside: no catalogue has it."""

    name: str
    joints: tuple[int, ...]
    params: tuple[dict[str, float], ...]
    outside: bool = False


class Motion(NamedTuple):
    """At time t: q, v, u (actuators' forces), c (commands as they arrive) `[K, n]`; servo `[n, 2]`."""

    t: float
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    c: np.ndarray
    servo: np.ndarray


Force = Callable[[dict[str, float], Motion, int], np.ndarray]


def stop(p, x, j):
    depth = np.maximum(p["side"] * (x.q[:, j] - p["angle"]), 0.0)
    speed = p["side"] * x.v[:, j]
    return -p["side"] * p["stiffness"] * depth * np.clip(1 + p["loss"] * speed, 0.0, 3.0)


FORCES: dict[str, Force] = {
    "quadratic_drag": lambda p, x, j: -p["drag"] * x.v[:, j] * np.abs(x.v[:, j]),
    "spring": lambda p, x, j: -p["stiffness"] * (x.q[:, j] - p["rest"]),
    "bias": lambda p, x, j: np.full(len(x.q), p["torque"]),
    "cogging": lambda p, x, j: p["size"] * np.sin(p["order"] * x.q[:, j] + p["phase"]),
    "hard_stop": stop,
}

LEVELS: dict[str, Force] = {
    "coulomb": lambda p, x, j: np.full(len(x.q), p["level"]),
    "asymmetric_coulomb": lambda p, x, j: p["level"] + p["difference"] * np.tanh(x.v[:, j] / 1e-3),
    "stribeck": lambda p, x, j: p["level"] + p["excess"] * np.exp(-((x.v[:, j] / p["speed"]) ** 2)),
    "load_friction": lambda p, x, j: p["share"] * np.abs(x.u[:, j]),
}

WHOLE: dict[str, Callable[[Effect, Motion], np.ndarray]] = {}


def _delay(e, c, history, s, memory, step):
    for j, p in zip(e.joints, e.params, strict=True):
        c[:, j] = history[max(s - round(p["delay"] / step), 0), :, j]


def _lag(e, c, history, s, memory, step):
    for j, p in zip(e.joints, e.params, strict=True):
        key = (e.name, j)
        old = memory.get(key, c[:, j].copy())
        memory[key] = c[:, j] + (old - c[:, j]) * np.exp(-step / p["lag"])
        c[:, j] = memory[key]


COMMAND = {"delay": _delay, "actuator_lag": _lag}
"""Effects on the command `c [K, n]` on its way, in place."""


def _output(law):
    def apply(e: Effect, u: np.ndarray, x: Motion) -> np.ndarray:
        out = u.copy()
        for j, p in zip(e.joints, e.params, strict=True):
            out[:, j] = law(p, x, j)
        return out

    return apply


OUTPUT = {
    "torque_gain": _output(lambda p, x, j: (1 + p["gain"]) * x.u[:, j]),
    "position_gain": _output(lambda p, x, j: x.u[:, j] + p["gain"] * x.servo[j, 0] * (x.c[:, j] - x.q[:, j])),
    "saturation": _output(lambda p, x, j: np.clip(x.u[:, j], -p["limit"], p["limit"])),
    "dead_zone": _output(lambda p, x, j: x.u[:, j] - np.clip(x.u[:, j], -p["width"], p["width"])),
}
"""Effects on the actuators' forces."""
