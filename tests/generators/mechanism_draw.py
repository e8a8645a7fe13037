"""Which effects a world has, and how large: sizes from what the same machine does without them."""

from dataclasses import dataclass, replace

import numpy as np

from tests.generators.mechanism_engine import STEP, Run
from tests.generators.mechanism_forces import Effect
from tests.generators.mechanism_machines import Extras, Machine


@dataclass(frozen=True)
class Scales:
    """RMS by joint `[n]` on a short run without effects: torque (the actuator's, or what moves a free joint), rate of the
    torque commanded, peak, speed,
    speed squared, acceleration; low and high: quantiles 2 and 98 % of the angles."""

    torque: np.ndarray
    rate: np.ndarray
    peak: np.ndarray
    speed: np.ndarray
    square: np.ndarray
    acceleration: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        return 0.5 * (self.low + self.high)


def scales(run: Run, own: np.ndarray, servo: np.ndarray) -> Scales:
    """own `[n]`: inertia of each joint, for those without an actuator; servo `[n, 2]`: kp and kv (0: torques)."""
    rms = lambda x: np.sqrt(np.mean(x**2, (0, 1)))
    driven, apart = rms(run.u) > 0, len(run.u) / run.command.shape[1] * STEP
    command = run.command * np.where(servo[:, 0] > 0, servo[:, 0], 1.0)
    torque = np.where(driven, rms(run.u), own * rms(run.a))
    return Scales(
        torque, rms(np.diff(command, axis=1)) / apart, np.quantile(np.abs(run.u), 0.999, (0, 1)), rms(run.v),
        rms(run.v**2), rms(run.a), *np.quantile(run.q, [0.02, 0.98], (0, 1)),
    )  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """How an effect is drawn. size(rng, scales, joint, share) -> params; at: one, driven, all, all_driven, base."""

    at: str
    size: object
    modes: tuple[str, ...] = ("torque", "position")


def _late(rng, s, j, share):
    wanted = np.clip(share * s.torque[j] / max(s.rate[j], 1e-9), 0.002, 0.03)
    return round(wanted / STEP) * STEP


def _spring(rng, s, j, share):
    rest = s.middle[j] + rng.uniform(-0.5, 0.5) * (s.high[j] - s.low[j])
    wide = np.sqrt((rest - s.middle[j]) ** 2 + (0.3 * (s.high[j] - s.low[j])) ** 2)
    return {"stiffness": share * s.torque[j] / wide, "rest": rest}


KINDS: dict[str, Kind] = {
    "coulomb": Kind("one", lambda r, s, j, k: {"level": k * s.torque[j]}),
    "coulomb_all": Kind("all", lambda r, s, j, k: {"level": k * s.torque[j]}),
    "spring": Kind("one", _spring),
    "armature": Kind("one", lambda r, s, j, k: {"inertia": k * s.torque[j] / s.acceleration[j]}),
    "delay": Kind("all_driven", lambda r, s, j, k: {"delay": _late(r, s, j, k)}),
}


def draw_effect(rng: np.random.Generator, machine: Machine, kind: str, s: Scales) -> Effect:
    """One effect of the kind, of 3 to 30 % of the torque."""
    k = KINDS[kind]
    share = np.exp(rng.uniform(np.log(0.05), np.log(0.3)))
    every, driven = tuple(range(machine.n)), machine.driven
    joints = {
        "all": every,
        "all_driven": driven,
        "one": (int(rng.choice(every)),),
        "driven": (int(rng.choice(driven)),),
    }[k.at]
    params = [k.size(rng, s, j, share) for j in joints]
    if k.at == "all_driven":
        params = [params[int(np.argmax([s.torque[j] for j in joints]))]] * len(joints)
    return Effect(kind.removesuffix("_all"), joints, tuple(params))


def extras_of(machine: Machine, effects: tuple[Effect, ...], file: bool) -> Extras:
    """What of the effects MJCF holds; file False: only what the engine leaves to MuJoCo's model."""
    x = Extras()
    for e in effects:
        for j, p in zip(e.joints, e.params, strict=True):
            name = machine.links[j].name
            if e.name == "armature":
                x.armature[name] = p["inertia"]
            elif file and e.name in ("coulomb", "stribeck"):
                x.frictionloss[name] = p["level"]
            elif file and e.name == "spring":
                x.stiffness[name] = (p["stiffness"], p["rest"])
    return replace(x)
