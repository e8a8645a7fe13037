"""Units and scales that a whole log betrays, refused where it is sure, reported where not.

Milliseconds may stand for seconds and degrees for radians. Some scales are no unit of angle: per
cent of a joint's range, 0 to 100 of a gripper's travel, an encoder's steps. LeRobot writes arms in
degrees or in -100 to 100 of each joint's calibrated range, and grippers in 0 to 100 of their travel
(https://github.com/huggingface/lerobot, motors/motors_bus.py, `MotorNormMode`). What is cut at the
ends of such a range ends at exactly 100. Steps are whole numbers. Nothing is converted here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import SPELLINGS
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.joint_columns import JointColumns
from adaptsim_jax.logs.log import LogTrial, ModelNames
from adaptsim_jax.logs.log_units import LENGTH_UNITS
from adaptsim_jax.logs.speeds import Written, check_speeds

SIGNED, UNSIGNED, STEPS, SHARE = "signed", "unsigned", "steps", "share"


@dataclass(frozen=True)
class Scale:
    """Of a joint's angle and target: its `kind`, `why`, and the `line` for [units], with what is
    not known in capitals.
    """

    kind: str
    why: str
    line: str
    known: bool


def scale_of(
    key: str,
    values: Sequence[np.ndarray],
    gripper: bool = False,
    limits: tuple[float, float] | None = None,
) -> Scale | None:
    """The scale that all values of a joint (its angles, its targets) betray; None where they may
    well be angles.

    Args:
        key: What [units] calls them.
        gripper: Whether it is one of a LeRobot data set.
        limits: Its range in the model.
    """
    if len(values):
        x = np.concatenate([np.asarray(v, float)[np.isfinite(v)] for v in values])
    else:
        x = np.zeros(0)
    if len(x) < UNIT.min_samples or np.ptp(x) == 0:
        return None
    low, high = float(x.min()), float(x.max())
    whole = bool(np.all(x == np.round(x)))
    if whole:
        # a setpoint of 100 is a round number; steps of an encoder go far beyond degrees
        if low >= 0 and UNIT.degrees < high < 2**16 and len(np.unique(x)) > UNIT.min_samples:
            steps = next(2**k for k in (12, 14, 16) if high < 2**k)
            line = f"{key} = {{ticks = {steps}, zero = {steps // 2}}}"
            return Scale(
                STEPS, f"whole numbers up to {high:.0f} look like an encoder's steps", line, True
            )
        return None
    ends = abs(high - 100.0) < UNIT.end or abs(low + 100.0) < UNIT.end
    inside = high <= 100.0 + UNIT.end and low >= -100.0 - UNIT.end
    if gripper and inside and low >= -1.0 and high > UNIT.large:
        if limits:
            line = f'{key} = "percent"'
        else:
            line = f"{key} = {{percent = [LOW, HIGH]}}"
        return Scale(
            UNSIGNED,
            "LeRobot writes grippers as 0 to 100 of their travel",
            line,
            limits is not None,
        )
    if not (ends and inside):
        return None
    end = "100" if abs(high - 100.0) < UNIT.end else "-100"
    why = f"values end at exactly {end}: per cent of the joint's range, as LeRobot writes it"
    if low < -UNIT.end:
        return Scale(SIGNED, why, f"{key} = {{from = [-100, 100], to = [LOW, HIGH]}}", False)
    return Scale(UNSIGNED, why, f"{key} = {{percent = [LOW, HIGH]}}", False)


def share_of(key: str, angles: Sequence[np.ndarray]) -> Scale | None:
    """The scale of measured angles that never leave -1 to 1 and are cut there: a share of the
    joint's range.
    """
    if len(angles):
        x = np.concatenate([np.asarray(q, float)[np.isfinite(q)] for q in angles])
    else:
        x = np.zeros(0)
    if (
        len(x) < UNIT.min_samples
        or np.max(np.abs(x)) > 1.0
        or np.sum(np.abs(x) == 1.0) < UNIT.cut
        or np.ptp(x) == 0
        or np.all(x == np.round(x))
    ):
        return None
    why = "angles end at exactly 1: a share of the joint's range"
    return Scale(SHARE, why, f"{key} = {{from = [-1, 1], to = [LOW, HIGH]}}", False)


def is_gripper(joint: str) -> bool:
    """Whether a joint's name is that of a gripper."""
    return any(word in joint.lower() for word in SPELLINGS["words"]["grippers"])


def scales_of(
    columns: Mapping[str, Sequence[np.ndarray]],
    joints: Sequence[str],
    lerobot: bool,
    ranges: Mapping[str, tuple[float, float]],
) -> dict[str, Scale]:
    """By joint, of `columns`: joint -> its angles and targets as written. In a data set of LeRobot
    all joints of an arm are in one scale.
    """
    found = {
        joint: scale
        for joint in joints
        if (
            scale := scale_of(
                f"q_{joint}",
                columns.get(joint, ()),
                lerobot and is_gripper(joint),
                ranges.get(joint),
            )
        )
    }
    signed = next((scale for scale in found.values() if scale.kind == SIGNED), None)
    if signed and lerobot:
        for joint in joints:
            if joint not in found and columns.get(joint) and not is_gripper(joint):
                line = f"q_{joint} = {{from = [-100, 100], to = [LOW, HIGH]}}"
                found[joint] = Scale(SIGNED, "as the arm's other joints", line, False)
    return found


def check_scales(trials: Sequence[JointColumns], names: ModelNames) -> tuple[str, ...]:
    """Notes on joints whose angles are declared as angles and look like another scale. BadInput
    where nothing is declared and they can be no angles.
    """
    lerobot = all(c.raw.path.endswith(".parquet") for c in trials)
    written = {
        joint: [
            x
            for c in trials
            for stem in ("q", "target")
            if (x := c.written.get((stem, j))) is not None
        ]
        for j, joint in enumerate(names.joints)
        if not all(c.scaled(j) for c in trials)
    }
    ranges = {
        joint: limits for j, joint in enumerate(names.joints) if (limits := names.limits_of(j))
    }
    found = scales_of(written, [j for j in names.joints if j in written], lerobot, ranges)
    for j, joint in enumerate(names.joints):
        own = [c.written["q", j] for c in trials if ("q", j) in c.written and not c.scaled(j)]
        if (
            joint not in found
            and joint not in names.slides
            and (share := share_of(f"q_{joint}", own))
        ):
            found[joint] = share
    if not found:
        return ()
    where = {joint: names.joints.index(joint) for joint in found}

    def reach(joint: str) -> float:
        angles = [
            c.by_joint["q"][where[joint]] for c in trials if where[joint] in c.by_joint.get("q", {})
        ]
        return max((float(np.nanmax(np.abs(q))) for q in angles), default=0.0)

    lines = "; ".join(scale.line for scale in found.values())
    first = next(iter(found.values()))
    if any(not s.known for s in found.values()):
        fill = ", LOW and HIGH its calibrated ends in rad (m)"
    else:
        fill = ""
    statement = (
        f"{', '.join(found)}: {first.why}; write {lines} under [units]{fill}, or record angles"
    )
    if any(joint not in names.slides and reach(joint) > UNIT.large for joint in found):
        raise BadInput(f"{trials[0].raw.path}: {statement}")
    return (f"{statement}; taken as declared",)


WORDS = {"mm": "millimetres", "cm": "centimetres"}


def check_log_units(
    trials: Sequence[LogTrial],
    names: ModelNames,
    units: Mapping[str, object] | None = None,
    known: Collection[str] = (),
    written: Mapping[str, Written] | None = None,
) -> tuple[str, ...]:
    """Notes about suspicious units.

    Raises `BadInput` naming the trial and the line for meta.toml where the data are sure.

    Args:
        units: As declared; angles that are degrees already are not asked about.
        known: Joints for whose angles or ways a unit is declared.
        written: Of joints that have speeds, their columns.
    """
    hinges = [j for j, joint in enumerate(names.joints) if joint not in names.slides]
    off = check_speeds(trials, names, written or {})
    slides = [j for j, joint in enumerate(names.joints) if joint in names.slides]
    distant = tuple(
        note for j in slides if (note := _distance_note(trials, j, names, names.joints[j] in known))
    )
    degrees = any(unit in ("deg", "degrees") for unit in (units or {}).values())
    if degrees:
        return (*off, *distant)
    large = [_large(trials, j, names, names.joints[j] in known) for j in hinges]
    return (*off, *distant, *filter(None, large))


def lengths_within(times: float) -> tuple[str, ...]:
    """Units of length that bring a sliding joint, which moves `times` as far as its range, into it.
    Metres are not asked about.
    """
    return tuple(
        unit
        for unit in ("mm", "cm")
        if times >= UNIT.hint and times * LENGTH_UNITS[unit] <= UNIT.inside
    )


def times_range(reach: float, limits: tuple[float, float] | None) -> float:
    """How many times as far from 0 as its declared range a joint moves; 0 where it has none."""
    span = max(map(abs, limits)) if limits else 0.0
    if span > 0.0:
        return reach / span
    return 0.0


def _distance_note(trials: Sequence[LogTrial], j: int, names: ModelNames, known: bool) -> str:
    """A note on ways too long for metres; BadInput where the declared range is surely passed, and
    no unit is declared.
    """
    reach = float(np.median([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials]))
    limits, joint = names.limits_of(j), names.joints[j]
    times = times_range(reach, limits)
    units = lengths_within(times)
    if known or (limits and not units) or (not limits and reach < UNIT.long):
        return ""
    ask = " or ".join(f'length = "{unit}"' for unit in units or ("mm",))
    if limits is None:
        return (
            f"{joint} slides as far as {reach:.3g} m: if that is no metres, write {ask} under "
            "[units]"
        )
    declared = f"{limits[0]:g} to {limits[1]:g} m"
    statement = (
        f"{joint} slides as far as {reach:.3g} m, {times:.2g} times its declared range of "
        f"{declared}"
    )
    if times < UNIT.distant:
        return f"{statement}: if that is no metres, write {ask} under [units]"
    raise BadInput(
        f"{trials[0].path}: {statement}, as {' or '.join(WORDS[unit] for unit in units)} would; "
        f"write {ask} under [units] in meta.toml, "
        'or length = "m" if they are metres and the range is not the machine\'s'
    )


def _large(trials: Sequence[LogTrial], j: int, names: ModelNames, known: bool) -> str:
    """A note on angles that may be degrees. Where a unit is declared, on a trial that is unlike the
    others alone.
    """
    reaches = np.array([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials])
    reach = float(np.median(reaches))
    outlier = int(reaches.argmax())
    if reaches[outlier] > max(UNIT.large, UNIT.outlier * reach):
        return (
            f"angles of {names.joints[j]} reach {reaches[outlier]:.3g} rad in "
            f"{trials[outlier].name}, {reach:.2g} rad in the others: if they are degrees there, "
            "convert that file"
        )
    speeds = [np.nanquantile(np.abs(t.v[:, j]), 0.99) for t in trials if t.v is not None]
    if known or reach < UNIT.large or (speeds and np.median(speeds) < UNIT.fast):
        return ""
    if trials[0].path.endswith(".parquet"):
        more = "; LeRobot may write per cent of a range, too"
    else:
        more = ""
    return (
        f"angles of {names.joints[j]} reach {reach:.3g} rad: if they are degrees, write angle = "
        f'"deg" under [units]{more}'
    )
