"""Right-hand sides: the force of each hidden effect and what each does to a command."""

import numpy as np

from tests.generators.effects import Table


def stick_speed(level: np.ndarray, inertia: np.ndarray, step: float) -> np.ndarray:
    """Width of the sign function `tanh(v / width)` [rad/s]: 1 mrad/s, or as small as RK4 at `step`
    stays stable.

    A joint that should stick creeps by that width times torque over friction: some mrad/s on these
    rigs.
    """
    return np.maximum(1e-3, step * level / (1.5 * inertia))


def force_terms(table: Table, inertia: np.ndarray, step: float, free_phase: np.ndarray):
    """Functions f(q, v, t, u) -> torque `[2, L]`, one for each memoryless force in the table.

    inertia: `[2, L]` smallest effective inertia; free_phase: `[L]` phases of disturbances not tied
    to the trial.
    """
    terms = []
    if "coulomb" in table:
        f = table["coulomb"]["size"]
        w = stick_speed(f, inertia, step)
        terms.append(lambda q, v, t, u, f=f, w=w: -f * np.tanh(v / w))
    if "stribeck" in table:
        e = table["stribeck"]
        f, rise, vs = e["size"], e["ratio"] - 1, e["velocity"]
        w = stick_speed(f * e["ratio"], inertia, step)
        terms.append(
            lambda q, v, t, u, f=f, w=w: -f * (1 + rise * np.exp(-((v / vs) ** 2))) * np.tanh(v / w)
        )
    if "quadratic_drag" in table:
        drag = table["quadratic_drag"]["size"]
        terms.append(lambda q, v, t, u: -drag * v * np.abs(v))
    if "spring" in table:
        k, rest = table["spring"]["size"], table["spring"]["rest"]
        terms.append(lambda q, v, t, u: -k * (q - rest))
    if "bias" in table:
        bias = table["bias"]["size"] * table["bias"]["sign"]
        terms.append(lambda q, v, t, u: bias)
    if "cogging" in table:
        e = table["cogging"]
        terms.append(lambda q, v, t, u, e=e: -e["size"] * np.sin(e["order"] * q + e["phase"]))
    if "friction_drift" in table:
        e = table["friction_drift"]
        terms.append(lambda q, v, t, u, e=e: -e["size"] * np.exp(-t / e["decay"]) * v)
    if "periodic_disturbance" in table:
        e = table["periodic_disturbance"]
        phase = e["phase"] + e["free_phase"] * free_phase
        terms.append(
            lambda q, v, t, u, e=e: e["size"] * np.sin(2 * np.pi * e["frequency"] * t + phase)
        )
    if "hard_stop" in table:
        terms.append(hard_stop(table["hard_stop"]))
    if "load_friction" in table:
        mu = table["load_friction"]["size"]
        terms.append(
            lambda q, v, t, u: (
                -mu * np.abs(u) * np.tanh(v / stick_speed(mu * np.abs(u), inertia, step))
            )
        )
    return terms


def hard_stop(e: dict[str, np.ndarray]):
    """A spring and damper beyond an angle that the motion reaches; it never pulls."""

    def force(q, v, t, u):
        depth = np.maximum(e["side"] * (q - e["angle"]), 0.0)
        push = e["size"] * (depth + 0.002 * e["side"] * v * (depth > 0))
        return -e["side"] * np.maximum(push, 0.0)

    return force


def static_command(table: Table, u: np.ndarray) -> np.ndarray:
    """Gain, dead zone and saturation of the command `[2, L]`, in that order."""
    if "torque_gain" in table:
        u = u * (1 + table["torque_gain"]["size"] * table["torque_gain"]["sign"])
    if "dead_zone" in table:
        w = table["dead_zone"]["size"]
        u = u - np.clip(u, -w, w)
    if "saturation" in table:
        e = table["saturation"]
        limit = np.where(e["size"] > 0, e["peak"] * (1 - e["size"]), np.inf)
        u = np.clip(u, -limit, limit)
    return u


def bristle_rate(e: dict[str, np.ndarray], z: np.ndarray, v: np.ndarray) -> np.ndarray:
    """dz/dt of a Dahl bristle in units of its break-away deflection: z' = v/zs - |v|/zs z."""
    return (v - np.abs(v) * z) / e["stiffness_angle"]


def bristle_force(e: dict[str, np.ndarray], z: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Dahl: -F z; LuGre adds bristle damping, here a hundredth of a second of the bristle's
    rate.
    """
    return -e["size"] * (z + 0.01 * e["lugre"] * rate)
