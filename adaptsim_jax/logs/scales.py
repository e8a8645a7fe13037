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
    is_complete: bool


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
    is_integer = bool(np.all(x == np.round(x)))
    if is_integer:
        # a setpoint of 100 is a round number; steps of an encoder go far beyond degrees
        if low >= 0 and UNIT.max_degrees < high < 2**16 and len(np.unique(x)) > UNIT.min_samples:
            steps = next(2**k for k in (12, 14, 16) if high < 2**k)
            line = f"{key} = {{ticks = {steps}, zero = {steps // 2}}}"
            return Scale(
                STEPS, f"whole numbers up to {high:.0f} look like an encoder's steps", line, True
            )
        return None
    ends_at_100 = abs(high - 100.0) < UNIT.end_tolerance or abs(low + 100.0) < UNIT.end_tolerance
    is_inside = high <= 100.0 + UNIT.end_tolerance and low >= -100.0 - UNIT.end_tolerance
    if gripper and is_inside and low >= -1.0 and high > UNIT.max_angle:
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
    if not (ends_at_100 and is_inside):
        return None
    end = "100" if abs(high - 100.0) < UNIT.end_tolerance else "-100"
    why = f"values end at exactly {end}: per cent of the joint's range, as LeRobot writes it"
    if low < -UNIT.end_tolerance:
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
        or np.sum(np.abs(x) == 1.0) < UNIT.min_cut_rows
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
    """Find the scale of each joint, of `columns`: joint -> its angles and targets as written. In a
    data set of LeRobot all joints of an arm are in one scale.
    """
    scales = {
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
    signed = next((scale for scale in scales.values() if scale.kind == SIGNED), None)
    if signed and lerobot:
        for joint in joints:
            if joint not in scales and columns.get(joint) and not is_gripper(joint):
                line = f"q_{joint} = {{from = [-100, 100], to = [LOW, HIGH]}}"
                scales[joint] = Scale(SIGNED, "as the arm's other joints", line, False)
    return scales


def check_scales(trials: Sequence[JointColumns], names: ModelNames) -> tuple[str, ...]:
    """Notes on joints whose angles are declared as angles and look like another scale. BadInput
    where nothing is declared and they can be no angles.
    """
    lerobot = all(c.raw.path.endswith(".parquet") for c in trials)
    raw_values = {
        joint: [
            x
            for c in trials
            for stem in ("q", "target")
            if (x := c.written.get((stem, j))) is not None
        ]
        for j, joint in enumerate(names.joints)
        if not all(c.has_scale(j) for c in trials)
    }
    ranges = {
        joint: limits for j, joint in enumerate(names.joints) if (limits := names.limits_of(j))
    }
    scales = scales_of(raw_values, [j for j in names.joints if j in raw_values], lerobot, ranges)
    for j, joint in enumerate(names.joints):
        joint_angles = [
            c.written["q", j] for c in trials if ("q", j) in c.written and not c.has_scale(j)
        ]
        if (
            joint not in scales
            and joint not in names.slides
            and (share := share_of(f"q_{joint}", joint_angles))
        ):
            scales[joint] = share
    if not scales:
        return ()
    where = {joint: names.joints.index(joint) for joint in scales}

    def reach(joint: str) -> float:
        angles = [
            c.by_joint["q"][where[joint]] for c in trials if where[joint] in c.by_joint.get("q", {})
        ]
        return max((float(np.nanmax(np.abs(q))) for q in angles), default=0.0)

    lines = "; ".join(scale.line for scale in scales.values())
    first = next(iter(scales.values()))
    if any(not s.is_complete for s in scales.values()):
        placeholder = ", LOW and HIGH its calibrated ends in rad (m)"
    else:
        placeholder = ""
    text = (
        f"{', '.join(scales)}: {first.why}; write {lines} under [units]{placeholder}, or record "
        "angles"
    )
    if any(joint not in names.slides and reach(joint) > UNIT.max_angle for joint in scales):
        raise BadInput(f"{trials[0].raw.path}: {text}")
    return (f"{text}; taken as declared",)


WORDS = {"mm": "millimetres", "cm": "centimetres"}


def check_log_units(
    trials: Sequence[LogTrial],
    names: ModelNames,
    units: Mapping[str, object] | None = None,
    declared_joints: Collection[str] = (),
    written: Mapping[str, Written] | None = None,
) -> tuple[str, ...]:
    """Notes about suspicious units.

    Raises `BadInput` naming the trial and the line for meta.toml where the data are sure.

    Args:
        units: As declared; angles that are degrees already are not asked about.
        declared_joints: Joints for whose angles or ways a unit is declared.
        written: Of joints that have speeds, their columns.
    """
    hinges = [j for j, joint in enumerate(names.joints) if joint not in names.slides]
    speed_notes = check_speeds(trials, names, written or {})
    slides = [j for j, joint in enumerate(names.joints) if joint in names.slides]
    range_notes = tuple(
        note
        for j in slides
        if (note := _distance_note(trials, j, names, names.joints[j] in declared_joints))
    )
    degrees = any(unit in ("deg", "degrees") for unit in (units or {}).values())
    if degrees:
        return (*speed_notes, *range_notes)
    degree_notes = [
        _degrees_note(trials, j, names, names.joints[j] in declared_joints) for j in hinges
    ]
    return (*speed_notes, *range_notes, *filter(None, degree_notes))


def lengths_within(times: float) -> tuple[str, ...]:
    """Units of length that bring a sliding joint, which moves `times` as far as its range, into it.
    Metres are not asked about.
    """
    return tuple(
        unit
        for unit in ("mm", "cm")
        if times >= UNIT.hint_ranges and times * LENGTH_UNITS[unit] <= UNIT.max_ranges_in_unit
    )


def times_range(reach: float, limits: tuple[float, float] | None) -> float:
    """How many times as far from 0 as its declared range a joint moves; 0 where it has none."""
    span = max(map(abs, limits)) if limits else 0.0
    if span > 0.0:
        return reach / span
    return 0.0


def _distance_note(trials: Sequence[LogTrial], j: int, names: ModelNames, is_declared: bool) -> str:
    """A note on ways too long for metres; BadInput where the declared range is surely passed, and
    no unit is declared.
    """
    reach = float(np.median([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials]))
    limits, joint = names.limits_of(j), names.joints[j]
    times = times_range(reach, limits)
    units = lengths_within(times)
    if is_declared or (limits and not units) or (not limits and reach < UNIT.max_slide_length):
        return ""
    choices = " or ".join(f'length = "{unit}"' for unit in units or ("mm",))
    if limits is None:
        return (
            f"{joint} slides as far as {reach:.3g} m: if that is no metres, write {choices} under "
            "[units]"
        )
    declared = f"{limits[0]:g} to {limits[1]:g} m"
    text = (
        f"{joint} slides as far as {reach:.3g} m, {times:.2g} times its declared range of "
        f"{declared}"
    )
    if times < UNIT.max_ranges:
        return f"{text}: if that is no metres, write {choices} under [units]"
    raise BadInput(
        f"{trials[0].path}: {text}, as {' or '.join(WORDS[unit] for unit in units)} would; "
        f"write {choices} under [units] in meta.toml, "
        'or length = "m" if they are metres and the range is not the machine\'s'
    )


def _degrees_note(trials: Sequence[LogTrial], j: int, names: ModelNames, is_declared: bool) -> str:
    """A note on angles that may be degrees. Where a unit is declared, on a trial that is unlike the
    others alone.
    """
    reaches = np.array([np.nanmax(np.abs(t.q[:, j]), initial=0.0) for t in trials])
    reach = float(np.median(reaches))
    outlier = int(reaches.argmax())
    if reaches[outlier] > max(UNIT.max_angle, UNIT.min_outlier_ratio * reach):
        return (
            f"angles of {names.joints[j]} reach {reaches[outlier]:.3g} rad in "
            f"{trials[outlier].name}, {reach:.2g} rad in the others: if they are degrees there, "
            "convert that file"
        )
    speeds = [np.nanquantile(np.abs(t.v[:, j]), 0.99) for t in trials if t.v is not None]
    if is_declared or reach < UNIT.max_angle or (speeds and np.median(speeds) < UNIT.max_speed):
        return ""
    if trials[0].path.endswith(".parquet"):
        hint = "; LeRobot may write per cent of a range, too"
    else:
        hint = ""
    return (
        f"angles of {names.joints[j]} reach {reach:.3g} rad: if they are degrees, write angle = "
        f'"deg" under [units]{hint}'
    )
