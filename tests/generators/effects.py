"""The effects that a generator can hide in its world: physics, how each is drawn, and its one size.

An effect is drawn as a dictionary of scalars; `size` multiplies or sets the one parameter that
makes it larger. `Table` stacks those of all lanes of a batch to `[2, L]`, zero where absent.
"""

from dataclasses import dataclass

import numpy as np

EFFECTS = (
    "coulomb",
    "stribeck",
    "quadratic_drag",
    "spring",
    "bias",
    "tilt",
    "encoder_offset",
    "torque_gain",
    "delay",
    "actuator_lag",
    "saturation",
    "dead_zone",
    "presliding",
    "backlash",
    "cogging",
    "rotor_inertia",
    "friction_drift",
    "periodic_disturbance",
    "hard_stop",
    "load_friction",
    "sensor_lag",
)

# Inner step [s]: friction and contact need short steps, smooth forces do not.
STEP = {
    "coulomb": 2.5e-4,
    "stribeck": 2.5e-4,
    "load_friction": 2.5e-4,
    "presliding": 2.5e-4,
    "hard_stop": 2.5e-4,
    "backlash": 2.5e-4,
    "delay": 5e-4,
    "cogging": 5e-4,
    "actuator_lag": 2.5e-4,
    "sensor_lag": 2.5e-4,
}
SMOOTH_STEP = 1.25e-3


@dataclass(frozen=True)
class Scale:
    """What a nominal run of the same rig looks like at one joint: the ruler for drawing
    parameters.
    """

    torque: float  # RMS of the command [N m]
    torque_peak: float
    speed: float  # RMS [rad/s]
    q_low: float  # 2 % and 98 % quantiles [rad]
    q_high: float
    inertia: float  # effective inertia [kg m2]

    @property
    def middle(self) -> float:
        return 0.5 * (self.q_low + self.q_high)


def draw(name: str, rng: np.random.Generator, s: Scale) -> dict[str, float]:
    """Parameters of one effect apart from its size, with the `size` to start the search from."""
    span = s.q_high - s.q_low
    sign = float(rng.choice([-1.0, 1.0]))
    u = rng.random()
    few = 0.03 * s.torque
    return {
        "coulomb": lambda: {"size": few},
        "stribeck": lambda: {
            "size": few,
            "ratio": 1.8 + 1.4 * u,
            "velocity": s.speed * (0.08 + 0.25 * rng.random()),
        },
        "quadratic_drag": lambda: {"size": few / s.speed**2},
        "spring": lambda: {
            "size": few / max(span / 3, 0.05),
            "rest": s.q_low + span * (u * 1.2 - 0.1),
        },
        "bias": lambda: {"size": few, "sign": sign},
        "tilt": lambda: {"size": 0.02, "sign": sign},
        "encoder_offset": lambda: {"size": 0.02, "sign": sign},
        "torque_gain": lambda: {"size": 0.05, "sign": sign if rng.random() < 0.3 else -1.0},
        "delay": lambda: {"size": 0.004},
        "actuator_lag": lambda: {"size": 0.005},
        "saturation": lambda: {"size": 0.15, "peak": s.torque_peak},
        "dead_zone": lambda: {"size": few},
        "presliding": lambda: {
            "size": few,
            "stiffness_angle": min(span / 12, 0.01 + 0.05 * u),
            "lugre": float(rng.random() < 0.5),
        },
        "backlash": lambda: {"size": 0.01},
        "cogging": lambda: {
            "size": few * 1.4,
            "order": float(rng.integers(3, 25)),
            "phase": 2 * np.pi * u,
        },
        "rotor_inertia": lambda: {"size": 0.03 * s.inertia},
        "friction_drift": lambda: {"size": few * 2 / s.speed, "decay": 0.8 + 2.5 * u},
        "periodic_disturbance": lambda: {
            "size": few * 1.4,
            "frequency": float(np.exp(rng.uniform(np.log(0.7), np.log(12)))),
            "free_phase": float(rng.random() < 0.5),
            "phase": 2 * np.pi * u,
        },
        "hard_stop": lambda: {
            "size": 20 * few,
            "side": sign,
            "angle": s.middle + sign * span / 2 * rng.uniform(0.6, 0.85),
        },
        "load_friction": lambda: {"size": 0.04},
        "sensor_lag": lambda: {"size": 0.004},
    }[name]()


# Size past which an effect would be implausible, in the unit of `size`.
LARGEST = {
    "tilt": 0.35,
    "encoder_offset": 0.35,
    "torque_gain": 0.5,
    "delay": 0.06,
    "actuator_lag": 0.08,
    "saturation": 0.85,
    "backlash": 0.2,
    "load_friction": 0.5,
    "sensor_lag": 0.06,
}

# Filters faster than this are beyond the inner step.
SMALLEST = {"actuator_lag": 5e-4, "sensor_lag": 5e-4}

UNITS = {
    "coulomb": "N m",
    "stribeck": "N m",
    "quadratic_drag": "N m s2/rad2",
    "spring": "N m/rad",
    "bias": "N m",
    "tilt": "rad",
    "encoder_offset": "rad",
    "torque_gain": "1",
    "delay": "s",
    "actuator_lag": "s",
    "saturation": "1 (share of peak cut off)",
    "dead_zone": "N m",
    "presliding": "N m",
    "backlash": "rad",
    "cogging": "N m",
    "rotor_inertia": "kg m2",
    "friction_drift": "N m s/rad",
    "periodic_disturbance": "N m",
    "hard_stop": "N m/rad",
    "load_friction": "1",
    "sensor_lag": "s",
}


class Table:
    """Parameters of every effect of a batch, `[2, L]` each; joint 0 also stands for the base."""

    def __init__(self, lanes: int):
        self.lanes = lanes
        self.values: dict[str, dict[str, np.ndarray]] = {}

    def add(self, name: str, joint: int, where: slice, params: dict[str, float]) -> None:
        """Enter one effect of one data set (`where`: its lanes). Neutral values elsewhere come from
        `size` = 0.
        """
        entry = self.values.setdefault(name, {})
        for key, value in params.items():
            neutral = {"size": 0.0, "ratio": 1.0}.get(key, 1.0)
            array = entry.setdefault(key, np.full((2, self.lanes), neutral))
            array[joint, where] = value

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __getitem__(self, name: str) -> dict[str, np.ndarray]:
        return self.values[name]

    def step(self) -> float:
        """The longest inner step that every effect of this batch bears [s]."""
        return min([SMOOTH_STEP, *(STEP.get(n, SMOOTH_STEP) for n in self.values)])
