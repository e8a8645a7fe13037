"""Scales of angles that are no unit of angle: per cent of a joint's range, 0 to 100 of a gripper's
travel, an encoder's steps.

LeRobot writes arms in degrees or in -100 to 100 of each joint's calibrated range, and grippers in 0
to 100 of their travel (https://github.com/huggingface/lerobot, motors/motors_bus.py,
`MotorNormMode`). What is cut at the ends of such a range ends at exactly 100. Steps are whole
numbers. Nothing is converted here: it is told, and refused where the numbers can be nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.columns import SPELLINGS
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.joint_columns import JointColumns
from adaptsim_jax.logs.log import ModelNames

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
        if not all(c.scaled.get(j, False) for c in trials)
    }
    ranges = {
        joint: limits for j, joint in enumerate(names.joints) if (limits := names.limits_of(j))
    }
    found = scales_of(written, [j for j in names.joints if j in written], lerobot, ranges)
    for j, joint in enumerate(names.joints):
        own = [
            c.written["q", j]
            for c in trials
            if ("q", j) in c.written and not c.scaled.get(j, False)
        ]
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
