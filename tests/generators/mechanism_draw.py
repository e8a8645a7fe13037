"""Which effects a world has, and how large: sizes from what the same machine does without them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.generators.mechanism_engine import STEP, Run
from tests.generators.mechanism_forces import Effect
from tests.generators.mechanism_machines import G, Machine
from tests.generators.mechanism_mjcf import Extras


@dataclass(frozen=True)
class Scales:
    """By joint `[n]`, on a short run without effects, RMS: torque (the actuator's, or what moves a
    free joint), rate of the torque commanded, speed, speed squared, acceleration; own inertia; low
    and high: 2 and 98 % quantiles of angles; u `[M, n]`: torques.
    """

    torque: np.ndarray
    rate: np.ndarray
    speed: np.ndarray
    square: np.ndarray
    acceleration: np.ndarray
    own: np.ndarray
    low: np.ndarray
    high: np.ndarray
    u: np.ndarray

    def span(self, j: int) -> float:
        return float(self.high[j] - self.low[j])


def scales(run: Run, own: np.ndarray, servo: np.ndarray) -> Scales:
    """own `[n]`: inertia of each joint, for those without an actuator; servo `[n, 2]`: kp and kv
    (0: torques).
    """

    def rms(x):
        return np.sqrt(np.mean(x**2, (0, 1)))

    driven, apart = rms(run.u) > 0, len(run.u) / run.command.shape[1] * STEP
    command = run.command * np.where(servo[:, 0] > 0, servo[:, 0], 1.0)
    return Scales(
        np.where(driven, rms(run.u), own * rms(run.a)),
        rms(np.diff(command, axis=1)) / apart,
        rms(run.v),
        rms(run.v**2),
        rms(run.a),
        own,
        *np.quantile(run.q, [0.02, 0.98], (0, 1)),
        run.u[::8].reshape(-1, run.u.shape[2]),
    )


@dataclass(frozen=True)
class Kind:
    """How a kind of effect is drawn. at: one, driven, all, all_driven, pair, base. size(rng,
    scales, joint, share, slides) gives the params; beside: kinds that come with it at the same
    joint; family: kinds of which a world has one.
    """

    at: str
    size: Callable[..., dict[str, float]]
    name: str = ""
    modes: tuple[str, ...] = ("torque", "position")
    beside: tuple[str, ...] = ()
    family: str = ""
    outside: bool = False


def _either(rng, low, high):
    return float(rng.choice([-1, 1]) * rng.uniform(low, high))


def _late(rng, s, j, share, most=0.03):
    """A lateness that makes about the share of the torque, whole steps of 2 to `most` s."""
    return (
        round(float(np.clip(share * s.torque[j] / max(s.rate[j], 1e-9), 0.002, most)) / STEP) * STEP
    )


def _limit(rng, s, j, share):
    """A torque above which so much is lost as makes the share."""
    u = np.abs(s.u[:, j])

    def lost(limit):
        return np.sqrt(np.mean(np.maximum(u - limit, 0) ** 2) / np.mean(u**2))

    limits = np.linspace(0.5, 1.0, 51) * u.max()
    return {"limit": float(limits[np.argmin([abs(lost(x) - 0.4 * share) for x in limits])])}


def _spring(rng, s, j, share):
    away = rng.uniform(-0.5, 0.5) * s.span(j)
    wide = np.hypot(away, 0.3 * s.span(j))
    return {"stiffness": share * s.torque[j] / wide, "rest": 0.5 * (s.low[j] + s.high[j]) + away}


def _cogging(rng, s, j, share):
    """At least one and a half periods over the range; whole periods a turn."""
    least = np.ceil(2 * np.pi * 1.5 / s.span(j))
    return {
        "size": 1.41 * share * s.torque[j],
        "order": float(np.clip(rng.integers(least, least + 20), 2, 190)),
        "phase": rng.uniform(0, 2 * np.pi),
    }


def _stop(rng, s, j, share):
    side = float(rng.choice([-1, 1]))
    edge = s.high[j] if side > 0 else s.low[j]
    depth = rng.uniform(0.12, 0.25) * s.span(j)
    return {
        "stiffness": rng.uniform(3, 8) * s.torque[j] / (0.1 * s.span(j)),
        "angle": edge - side * depth,
        "side": side,
        "loss": 0.02 / max(s.span(j), 1e-3),
    }


def _drive(rng, s, j, hertz, ratio, gap):
    stiffness = (2 * np.pi * hertz) ** 2 * s.own[j]
    return {
        "stiffness": stiffness,
        "damping": 2 * ratio * np.sqrt(stiffness * s.own[j]),
        "gap": gap,
        "link_side": float(rng.integers(2)),
    }


def _magnet(rng, s, j, share):
    return {
        "size": 1.6 * share * s.torque[j],
        "angle": rng.uniform(s.low[j], s.high[j]),
        "width": rng.uniform(0.06, 0.15) * s.span(j),
    }


def _place_friction(rng, s, j, share):
    order = 2 * np.pi * rng.uniform(0.7, 2.0) / s.span(j)
    return {
        "level": 1.2 * share * s.torque[j],
        "depth": rng.uniform(0.7, 1.0),
        "order": order,
        "phase": rng.uniform(0, 6.28),
    }


def ONE(key, scale):
    return lambda r, s, j, k: {key: k * float(s.torque[j] / scale(s, j))}


def PLAIN(s, j):
    return 1.0


KINDS: dict[str, Kind] = {
    "coulomb": Kind("one", ONE("level", PLAIN)),
    "coulomb_all": Kind("all", ONE("level", PLAIN), "coulomb"),
    "asymmetric_coulomb": Kind(
        "one",
        lambda r, s, j, k: {"difference": _either(r, 0.6, 1.0) * max(k, 0.08) * s.torque[j]},
        beside=("coulomb",),
        family="bias",
    ),
    "stribeck": Kind(
        "one",
        lambda r, s, j, k: {
            "excess": 2 * k * s.torque[j],
            "speed": r.uniform(0.2, 0.6) * s.speed[j],
        },
        beside=("coulomb",),
    ),
    "load_friction": Kind("driven", lambda r, s, j, k: {"share": k}),
    "quadratic_drag": Kind("one", ONE("drag", lambda s, j: s.square[j])),
    "spring": Kind("one", _spring, family="bias"),
    "armature": Kind("one", ONE("inertia", lambda s, j: s.acceleration[j])),
    "cogging": Kind("one", _cogging),
    "bias": Kind(
        "one", lambda r, s, j, k: {"torque": _either(r, 1, 1) * k * s.torque[j]}, family="bias"
    ),
    "torque_gain": Kind(
        "driven", lambda r, s, j, k: {"gain": _either(r, 1, 1) * min(1.2 * k, 0.4)}, family="gain"
    ),
    "position_gain": Kind(
        "driven",
        lambda r, s, j, k: {"gain": _either(r, 1, 1) * min(1.5 * k, 0.4)},
        modes=("position",),
        family="gain",
    ),
    "delay": Kind("all_driven", lambda r, s, j, k: {"delay": _late(r, s, j, k)}, family="late"),
    "log_late": Kind(
        "all_driven", lambda r, s, j, k: {"delay": -_late(r, s, j, k)}, "delay", family="late"
    ),
    "actuator_lag": Kind(
        "all_driven", lambda r, s, j, k: {"lag": _late(r, s, j, k, 0.05)}, family="late"
    ),
    "saturation": Kind("driven", _limit, family="gain"),
    "dead_zone": Kind("driven", lambda r, s, j, k: {"width": k * s.torque[j]}, family="gain"),
    "encoder_offset": Kind(
        "one",
        lambda r, s, j, k: {"offset": _either(r, 0.3, 0.5) * k * min(1.5, s.span(j))},
        family="bias",
    ),
    "encoder_scale": Kind(
        "one", lambda r, s, j, k: {"scale": _either(r, 1, 1) * min(0.6 * k, 0.2)}, family="gain"
    ),
    "sensor_delay": Kind("all", lambda r, s, j, k: {"delay": _late(r, s, j, k)}, family="late"),
    "sensor_lag": Kind("all", lambda r, s, j, k: {"lag": _late(r, s, j, k)}, family="late"),
    "tilt": Kind(
        "base",
        lambda r, s, j, k: {
            "angle": np.deg2rad(r.uniform(1.5, 6.0)),
            "toward": r.uniform(0, 2 * np.pi),
        },
        family="bias",
    ),
    "payload": Kind("base", lambda r, s, j, k: {"share": r.uniform(0.1, 0.4)}, family="drop"),
    "backlash": Kind(
        "one", lambda r, s, j, k: {"gap": r.uniform(0.02, 0.06) * s.span(j)}, family="drive"
    ),
    "drive_elasticity": Kind(
        "driven", lambda r, s, j, k: _drive(r, s, j, r.uniform(5, 10), 0.05, 0.0), family="drive"
    ),
    "drive_play": Kind(
        "driven",
        lambda r, s, j, k: _drive(r, s, j, 25.0, 0.3, r.uniform(0.02, 0.06) * s.span(j)),
        family="drive",
    ),
    "hard_stop": Kind("one", _stop),
    "magnet": Kind("one", _magnet),
    "periodic_torque": Kind(
        "one",
        lambda r, s, j, k: {
            "size": 1.41 * k * s.torque[j],
            "frequency": r.uniform(0.7, 2.5),
            "phase": r.uniform(0, 6.28),
        },
        outside=True,
    ),
    "place_friction": Kind("one", _place_friction),
    "wandering_torque": Kind(
        "one",
        lambda r, s, j, k: {"size": k * s.torque[j], "seed": float(r.integers(2**31))},
        outside=True,
    ),
    "dropped_mass": Kind(
        "base",
        lambda r, s, j, k: {"share": r.uniform(0.15, 0.5), "time": r.uniform(2, 3)},
        family="drop",
        outside=True,
    ),
    "coupling": Kind(
        "pair",
        lambda r, s, j, k: {
            "size": 1.41 * k * s.torque[j],
            "ratio": _either(r, 0.5, 1.0),
            "order": np.pi / s.span(j),
            "rest": r.uniform(0, 6.28),
        },
        outside=True,
    ),
    "torque_coupling": Kind(
        "neighbours",
        lambda r, s, j, k: {
            "onto": _either(r, 1, 1) * min(k * float(s.torque[j] / s.torque[j - 1]), 0.8),
            "back": 0.0,
        },
        family="coupled",
    ),
    "friction_coupling": Kind(
        "neighbours",
        lambda r, s, j, k: {
            "damping": _either(r, 1, 1)
            * k
            * float(min(s.torque[j] / s.speed[j - 1], s.torque[j - 1] / s.speed[j]))
        },
        family="coupled",
    ),
}
INSIDE = tuple(k for k, v in KINDS.items() if not v.outside)
OUTSIDE = tuple(k for k, v in KINDS.items() if v.outside)
ABSORBED = ("payload",)
"""What inertias take up whole, whatever the machine."""

Plan = tuple[str, tuple[int, ...]]  # a kind and its joints


def joints_of(rng: np.random.Generator, machine: Machine, kind: str) -> tuple[int, ...]:
    every, driven = tuple(range(machine.n)), machine.driven
    return {
        "all": every,
        "all_driven": driven,
        "base": (),
        "one": (int(rng.choice(every)),),
        "driven": (int(rng.choice(driven)),),
        "pair": tuple(int(j) for j in rng.permutation(machine.n)[:2]),
        "neighbours": _neighbours(rng, machine, kind),
    }[KINDS[kind].at]


def _neighbours(rng: np.random.Generator, machine: Machine, kind: str) -> tuple[int, ...]:
    """A joint and the one before it; of a torque, one whose motor turns."""
    if KINDS[kind].at != "neighbours":
        return ()
    first = [j for j in range(machine.n - 1) if kind != "torque_coupling" or j in machine.driven]
    j = int(rng.choice(first))
    return j, j + 1


def fits(machine: Machine, mode: str, kind: str) -> bool:
    return mode in KINDS[kind].modes and not (
        KINDS[kind].at in ("pair", "neighbours") and machine.n < 2
    )


def plan(
    rng: np.random.Generator, machine: Machine, mode: str, suite: str, effect: str | None
) -> list[Plan]:
    """What is to be hidden: nothing, one kind, or 3 to 5 of unlike families, one of them outside
    the catalogue.
    """
    if suite == "null":
        return []
    inside = [k for k in INSIDE if fits(machine, mode, k)]
    if suite == "single":
        kind = effect or str(rng.choice(inside))
        if kind not in KINDS or not fits(machine, mode, kind):
            raise ValueError(
                f"no effect {kind!r} on a {machine.name} by {mode}; there are {', '.join(inside)}"
            )
        return [(kind, joints_of(rng, machine, kind))]
    chosen: list[Plan] = []
    count = int(rng.integers(3, 6))
    first = str(rng.choice([k for k in OUTSIDE if fits(machine, mode, k)]))
    for kind in [first, *map(str, rng.permutation([k for k in inside if k not in ABSORBED]))]:
        joints, family = joints_of(rng, machine, kind), KINDS[kind].family or kind
        if len(chosen) < count and all(
            (KINDS[k].family or k) != family and _apart(kind, joints, k, js) for k, js in chosen
        ):
            chosen.append((kind, joints))
    return chosen


FRICTION = (
    "coulomb",
    "coulomb_all",
    "asymmetric_coulomb",
    "stribeck",
    "load_friction",
    "place_friction",
)


def _apart(kind: str, joints: tuple[int, ...], other: str, others: tuple[int, ...]) -> bool:
    """No two laws of dry friction at one joint, nor anything beside a drive's own joint."""
    drives = {KINDS[kind].family, KINDS[other].family} & {"drive"}
    alike = kind in FRICTION and other in FRICTION
    return not ((drives or alike) and set(joints) & set(others))


def draw_effects(
    rng: np.random.Generator, machine: Machine, plans: list[Plan], s: Scales, factors: list[float]
) -> tuple[Effect, ...]:
    """Sizes for what is planned: 3 to 30 % of the torque, times a factor where that was too little
    to see.
    """
    out = []
    for (kind, joints), factor in zip(plans, factors, strict=True):
        k = KINDS[kind]
        share = min(factor * np.exp(rng.uniform(np.log(0.06), np.log(0.25))), 0.4)
        params = [k.size(rng, s, j, share) for j in joints or (machine.n - 1,)]
        if k.at == "pair":
            params = params[:1]
        elif k.at == "neighbours":
            params = params[1:]
        if k.family == "late":  # one computer: one lateness
            share_of = [j for j in joints if j in machine.driven]
            params = [params[joints.index(max(share_of, key=lambda j: s.torque[j]))]] * len(joints)
        for other in k.beside:
            extra = [KINDS[other].size(rng, s, j, share * rng.uniform(1.2, 1.8)) for j in joints]
            out.append(Effect(KINDS[other].name or other, joints, tuple(extra)))
        if kind == "asymmetric_coulomb":  # friction drives nothing
            level = out[-1].params[0]["level"]
            params = [
                {"difference": float(np.clip(params[0]["difference"], -0.9 * level, 0.9 * level))}
            ]
        if kind in ("payload", "dropped_mass"):
            share_of_mass = params[0].pop("share")
            params = [
                {
                    "mass": share_of_mass
                    * max(
                        machine.links[-1].mass, 0.3 * machine.links[-2].mass if machine.n > 2 else 0
                    )
                }
                | params[0]
            ]
        if kind == "tilt" and machine.name in ("pendulum", "double_pendulum", "cart_pole"):
            params[0]["toward"] = float(rng.integers(2)) * np.pi  # in the plane
        out.append(Effect(k.name or kind, joints, tuple(params), k.outside))
    return tuple(out)


def owners(plans: list[Plan]) -> list[int]:
    """Which plan each effect of `draw_effects` is of."""
    return [i for i, (kind, _) in enumerate(plans) for _ in range(1 + len(KINDS[kind].beside))]


def tilted(effects: tuple[Effect, ...]) -> np.ndarray:
    """Gravity [3] m/s^2."""
    for e in effects:
        if e.name == "tilt":
            a, b = e.params[0]["angle"], e.params[0]["toward"]
            return G * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)])
    return np.array([0, 0, -G])


def extras_of(machine: Machine, effects: tuple[Effect, ...], file: bool) -> Extras:
    """What of the effects MJCF holds; file False: only what `mechanism_engine` leaves to MuJoCo's
    model.
    """
    x = Extras(
        gravity=tilted(effects),
        payload=next((e.params[0]["mass"] for e in effects if e.name == "payload"), 0.0),
    )
    for e in effects:
        for j, p in e.each():
            name = machine.links[j].name
            if e.name == "armature":
                x.armature[name] = p["inertia"]
            elif e.name in ("drive_elasticity", "drive_play"):
                x.twist[name] = (p["stiffness"], p["damping"]) if file else (0.0, 0.0)
            elif file and e.name == "coulomb":
                x.frictionloss[name] = p["level"]
            elif file and e.name == "spring":
                x.stiffness[name] = (p["stiffness"], p["rest"])
            elif file and e.name == "saturation":
                x.force[name] = p["limit"]
            elif file and e.name in ("torque_gain", "position_gain"):
                x.kp[name] = x.gear[name] = 1 + p["gain"]
                x.kv[name] = 1 + p["gain"] if e.name == "torque_gain" else 1.0
    return x
