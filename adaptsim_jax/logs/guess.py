"""A `meta.toml` guessed from the data: which column is what, in which units. Every guess is marked as one.

Nothing here decides anything for good: a person reads the text, mends it, and takes the marks away.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.config import dumps, nearest
from adaptsim_jax.logs.columns import STEMS, TIME, role
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_checks import LARGE
from adaptsim_jax.logs.quality.consistency import velocity_agreement
from adaptsim_jax.logs.scales import Scale, scales_of
from adaptsim_jax.logs.table_checks import SLOWEST

TIME_STEPS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
WORDS = {word: stem for stem, words in STEMS.items() for word in words} | {
    "angle": "q", "angles": "q", "positions": "q", "qpos": "q", "theta": "q", "state": "q",
    "speed": "v", "velocities": "v", "qvel": "v", "omega": "v", "rate": "v",
    "efforts": "tau", "torques": "tau", "moment": "tau", "force": "tau",
    "command": "target", "cmd": "target", "desired": "target", "des": "target", "goal": "target", "reference": "target",
    "commands": "target", "targets": "target", "actions": "target",
    "ref": "target", "setpoint": "target", "action": "target", "control": "ctrl", "volts": "u", "amps": "i",
}  # fmt: skip
TARGETS = {word for word, stem in WORDS.items() if stem == "target"}
CLOCKS = ("time", "times", "timestamp", "timestamps", "stamp", "stamps", "t", "ts", "seconds", "clock")


@dataclass(frozen=True)
class Guess:
    """`columns`: our name -> the file's, those that need it; `units`: quantity -> (unit, why), or a whole line of [units], known
    but for words in capitals; `ignored`: columns."""

    columns: dict[str, str]
    units: dict[str, tuple[str | Scale, str]]
    ignored: tuple[str, ...]
    unknown_joints: tuple[str, ...]


def guess(columns: dict[str, np.ndarray], model: ModelNames | None, lerobot: bool = False) -> Guess:
    """What the columns of one trial (by the file's names, as written) seem to be. `model`: its joints, where known; lerobot: whether
    they are of a LeRobot data set."""
    joints = model.joints if model else ()
    actuators = {a.name for a in (model.actuators or ())} if model else set()
    names: dict[str, str] = {}
    ignored: list[str] = []
    unknown: list[str] = []
    for name in columns:
        told = role(name, joints)
        named = told and (told.joint in joints or (told.stem == "ctrl" and told.joint in actuators))
        known = told and (not isinstance(told.joint, str) or not joints or named)
        ours = name if known else _ours(name, joints)
        if ours is not None and ours not in names.values():
            names[name] = ours
        elif told and isinstance(told.joint, str):
            unknown.append(name if told.joint in actuators else told.joint)  # ctrl_ACTUATOR is kept
        else:
            ignored.append(name)
    if not any(role(ours, joints) and ours in TIME for ours in names.values()):
        clock = next((n for n in columns if is_clock(n) and _increases(columns[n])), None)
        if clock is not None:
            names[clock] = "time"
            ignored = [name for name in ignored if name != clock]
    by_ours = {ours: columns[name] for name, ours in names.items()}
    return Guess(
        columns={ours: name for name, ours in names.items() if ours != name},
        units=guess_units(by_ours, joints, lerobot, model),
        ignored=tuple(ignored),
        unknown_joints=tuple(dict.fromkeys(unknown)),
    )


def array_name(name: str) -> str | None:
    """Our name of an array `[T, n]` such as `joint_positions`, whose columns are joints in order; None where it is none of ours."""
    ours = name if role(name) else _ours(name, ())
    told = role(ours) if ours else None
    return ours if told and told.joint is None and told.stem not in ("time", "trial") else None


def is_clock(name: str) -> bool:
    """Whether a column is called as a time."""
    return bool(set(_tokens(name)) & set(CLOCKS))


def _tokens(name: str) -> list[str]:
    return [token.lower() for token in re.split(r"[^A-Za-z0-9]+", name) if token]


def _ours(name: str, joints: Sequence[str]) -> str | None:
    """Our name of a column such as `/joint_states/elbow/position`, `shoulder_vel` or `joint_2_pos`."""
    tokens = [part for token in _tokens(name) for part in _word_and_number(token)]
    found = [token for token in tokens if token in WORDS]
    if not found or (set(tokens) & {"error", "err", "std", "min", "max", "raw"}):
        return None
    # "elbow_pos_desired" is a target, whatever quantity is desired
    stem = "target" if set(found) & TARGETS else WORDS[found[-1]]
    if stem == "target" and {"tau", "torque", "effort"} & set(found):
        return None
    if (
        stem == "target" and "data" in tokens
    ):  # an array of commands names no joints: it is in the order of the actuators
        stem = "ctrl"
    inside = [joint for joint in joints if _contains(tokens, _tokens(joint))]
    if inside:
        return f"{stem}_{max(inside, key=len)}"
    number = next(
        (re.sub(r"\D", "", token) for token in reversed(tokens) if re.fullmatch(r"(j|joint|motor|axis)?\d+", token)),
        None,
    )
    if number:
        return f"{stem}{number}"
    rest = [
        token
        for token in tokens
        if token not in WORDS and token not in ("joint", "state", "states", "joints", "measured", "actual")
    ]
    if not joints:
        return f"{stem}_{'_'.join(rest)}" if rest else stem
    near = nearest("_".join(rest), joints) if rest else None
    if near:
        return f"{stem}_{near}"
    return stem if len(joints) == 1 and not rest else None


def _word_and_number(token: str) -> tuple[str, ...]:
    """`position0`, as arrays are exported, is the word and its number; other tokens are whole."""
    found = re.fullmatch(r"([a-z]{3,})(\d+)", token)
    return found.groups() if found and found[1] in WORDS else (token,)


def _contains(tokens: list[str], part: list[str]) -> bool:
    return any(tokens[i : i + len(part)] == part for i in range(len(tokens) - len(part) + 1))


def _increases(values: np.ndarray) -> bool:
    return bool(np.all(np.diff(values) > 0))


def guess_units(
    columns: dict[str, np.ndarray], joints: Sequence[str] = (), lerobot: bool = False, model: ModelNames | None = None
) -> dict[str, tuple[str | Scale, str]]:
    """Units that the numbers betray, and by what; a quantity that looks SI is not listed."""
    out: dict[str, tuple[str | Scale, str]] = {}
    time = next((columns[name] for name in TIME if name in columns), None)
    scale = 1.0
    if time is not None and len(time) > 2:
        step = float(np.median(np.diff(time)))
        name, scale = next(((n, s) for n, s in TIME_STEPS if step * s <= SLOWEST), TIME_STEPS[-1])
        if name != "s":
            out["time"] = (name, f"a row every {step:.4g}")
    roles = {name: r for name in columns if (r := role(name, joints)) is not None}
    angles = {r.joint: columns[name] for name, r in roles.items() if r.stem == "q"}
    speeds = {r.joint: columns[name] for name, r in roles.items() if r.stem == "v"}
    scales = _scales(columns, roles, joints, lerobot, model)
    out |= {scale.line.partition(" ")[0]: (scale, scale.why) for scale in scales.values()}
    angles = {joint: x for joint, x in angles.items() if str(joint) not in scales}
    reach = max((float(np.nanmax(np.abs(q))) for q in angles.values() if np.isfinite(q).any()), default=0.0)
    gain = None if time is None else _gain(time * scale, angles, speeds)
    if gain is not None and abs(np.log(gain / (np.pi / 180))) < 0.1:
        out |= {"angle": ("deg", "speeds fit rad/s, angles are 57 times larger"), "velocity": ("rad/s", "see angle")}
    elif gain is not None and abs(np.log(gain / (180 / np.pi))) < 0.1:
        out |= {"velocity": ("deg/s", "speeds are 57 times the angles' slopes")}
    elif gain is not None and abs(np.log(gain * 2 * np.pi / 60)) < 0.1:
        out |= {"velocity": ("rpm", "speeds are 9.5 times the angles' slopes")}
    elif reach > LARGE:
        out["angle"] = (
            "deg",
            f"angles reach {reach:.4g}; rad, if the joint turns {reach / (2 * np.pi):.2g} times",
        )
    return out


def _scales(
    columns: dict[str, np.ndarray], roles: dict, joints: Sequence[str], lerobot: bool, model: ModelNames | None
) -> dict[str, Scale]:
    """Scales that are no units of angle, by joint as the columns name it."""
    by_joint: dict[str, list[np.ndarray]] = {}
    for name, found in roles.items():
        if found.stem in ("q", "target") and found.joint is not None:
            by_joint.setdefault(str(found.joint), []).append(columns[name])
    ranges = {j: limits for k, j in enumerate(joints) if model and (limits := model.limits_of(k))}
    return scales_of(by_joint, tuple(by_joint), lerobot, ranges)


def _gain(time: np.ndarray, angles: dict, speeds: dict) -> float | None:
    """Logged speed over the slope of the angle, where joints agree on it."""
    gains = []
    for joint, v in speeds.items():
        q = angles.get(joint)
        if q is not None and np.isfinite(q).all() and np.isfinite(v).all() and len(q) > 20:
            told = velocity_agreement(time, q, v)
            gains += [told.gain] if told.enough and told.r2 > 0.9 and told.gain > 0 else []
    if not gains or max(gains) > 1.2 * min(gains):
        return None
    return float(np.median(gains))


# ---------------------------------------------------------------- the text


def meta_text(
    found: Guess,
    *,
    model: str | None,
    data: str | None,
    model_names: ModelNames | None,
    topics: Sequence[str] = (),
    ros: dict[str, str] | None = None,
    kinds: Sequence[str] = (),
    commands: Mapping[str, str] | None = None,
) -> str:
    """A `meta.toml` with these guesses. `topics`: lines about a bag's topics; `kinds`: input kinds that the columns allow; commands:
    trial -> the file that seems to hold its commands."""
    line = lambda key, value: dumps({key: value}).strip()
    lines = [
        "# Written by 'adaptsim init' from the data. What is marked 'guess' was not declared by anyone: check it.",
        line("task", "mechanism"),
        line("model", model)
        if model
        else '# model = "robot.xml"   # MJCF or URDF, relative to this folder; or give --model',
    ]
    if model and model_names:
        lines.append(f"# joints of the model, in its order: {', '.join(model_names.joints)}")
    if data:
        lines.append(line("data", data))
    if len(kinds) > 1:
        lines.append(f"{line('input', kinds[0])}   # guess: the data also have columns of {', '.join(kinds[1:])}")
    if found.unknown_joints:
        lines.append(line("ignore", list(found.unknown_joints)) + "   # guess: joints that the model lacks")
    if found.columns:
        lines += ["", "[columns]   # guess: our name = the file's name"]
        lines += [line(ours, theirs) for ours, theirs in found.columns.items()]
    if found.ignored:
        lines += ["", f"# columns that are not used: {', '.join(found.ignored)}"]
    lines += ["", "[units]   # s, rad, rad/s, N m, m, N, V, A where nothing else is said"]
    for key, (unit, why) in found.units.items():
        if isinstance(unit, Scale):
            lines.append(
                f"{'' if unit.known else '# '}{unit.line}   # guess: {why}{'' if unit.known else '; fill LOW and HIGH (rad, m)'}"
            )
        else:
            lines.append(f"{line(key, unit)}   # guess: {why}")
    if "angle" not in found.units and not any(isinstance(unit, Scale) for unit, _ in found.units.values()):
        lines.append('# angle = "rad"   # guess: the numbers look like radians')
    lines += [
        "",
        "[angles]",
        'convention = "relative"   # guess: each angle counts from the link before it; "absolute": from the world',
        "# zero = {elbow = 1.5708}   # what the log shows (rad or m) where the model's joint is at 0; guess: 0 for all",
        '# reversed = ["elbow"]   # joints that the log counts the other way round; guess: none',
    ]
    if topics:
        lines += [
            "",
            "[ros]",
            *(line(key, value) + "   # guess" for key, value in (ros or {}).items()),
            *(f"# {t}" for t in topics),
        ]
    given = ", ".join(f'"{trial}" = "{file}"' for trial, file in (commands or {}).items())
    lines += ["", "[trials]", f"commands = {{{given}}}   # guess: files of commands, by their names"] if given else []
    lines += [
        "",
        "# [noise]   # standard deviations in SI units, where known",
        "# q = 1e-4",
        "# [trials]",
        '# exclude = ["trial_03"]   # trials that went wrong',
        "# payload = {trial_04 = 0.2}   # kg at the tip",
    ]
    return "\n".join(lines) + "\n"
