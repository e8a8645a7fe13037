"""What drives the model in a log: torques, commands through its actuators, volts, amperes, or
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.config import nearest, suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.angles import flipped_joints, follow_turns, model_angles
from adaptsim_jax.logs.criteria import COMMAND
from adaptsim_jax.logs.joint_columns import JointColumns, also_there
from adaptsim_jax.logs.log import ActuatorName, InputKind, ModelNames
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.quality.commands import limit_distance, limit_rate

STEM = {"torque": "tau", "command": "target", "voltage": "u", "current": "i", "none": ""}
PREFERRED: tuple[InputKind, ...] = ("torque", "command", "current", "voltage")
"""Which columns count where a file has several, unless `input` in meta.toml says."""


@dataclass(frozen=True)
class Inputs:
    """`kind`, the `stem` of its columns, the `names` of the columns of `u`, the `driven` joints,
    `notes`.
    """

    kind: InputKind
    stem: str
    names: tuple[str, ...]
    driven: tuple[str, ...]
    actuators: tuple[ActuatorName, ...] = ()
    notes: tuple[str, ...] = ()

    def of(
        self, columns: JointColumns, names: ModelNames, meta: LogMeta, moving: np.ndarray
    ) -> np.ndarray:
        """`u [T, m]` of one trial in SI units.

        Args:
            moving: Numbers of the joints that move.
        """
        if self.kind == "none":
            return np.zeros((len(columns.time), 0))
        if self.kind != "command":
            u = columns.joint_array(self.stem, len(names.joints))
            u[:, [joint not in self.driven for joint in names.joints]] = 0.0
            _check_complete(columns, self.kind, names.joints, u)
            return np.where(flipped_joints(names, meta), -u, u)[:, moving]
        angles = model_angles(columns.joint_array("target", len(names.joints)), names, meta)
        commands = []
        for index, actuator in enumerate(self.actuators):
            command = columns.ctrl.get(
                actuator.name, columns.ctrl.get(index, columns.ctrl.get(actuator.joint))
            )
            if command is None and _has_command(columns, actuator, index, names):
                angle = angles[:, names.joints.index(actuator.joint)]
                command = actuator.at_zero + actuator.per_angle * angle
            commands.append(np.zeros(len(columns.time)) if command is None else command)
        u = np.stack(
            [
                _as_sent(columns, names, meta, *pair)
                for pair in zip(self.actuators, commands, strict=True)
            ],
            axis=1,
        )
        _check_complete(columns, self.kind, self.names, u)
        return u


def _as_sent(
    columns: JointColumns,
    names: ModelNames,
    meta: LogMeta,
    actuator: ActuatorName,
    command: np.ndarray,
) -> np.ndarray:
    """A command `[T]` that is an angle: with the whole turns of the angle of its joint, and cut as
    `[commands]` says.
    """
    if (j := _servo_joint(actuator, names)) is None:
        return command
    q = model_angles(columns.joint_array("q", len(names.joints)), names, meta)[:, j]
    if not np.isfinite(q).any():  # of a joint that is held
        return command
    angle = (command - actuator.at_zero) / actuator.per_angle
    if actuator.kind == "position" and actuator.joint not in names.slides:
        angle = follow_turns(q, angle)
    if actuator.joint in meta.rate:
        angle = limit_rate(columns.time, angle, q, meta.rate[actuator.joint])
    if actuator.joint in meta.within:
        angle = limit_distance(angle, q, meta.within[actuator.joint])
    return actuator.at_zero + actuator.per_angle * angle


def _check_complete(
    columns: JointColumns, kind: str, names: tuple[str, ...], u: np.ndarray
) -> None:
    missing = np.argwhere(np.isnan(u))
    for k in np.flatnonzero(np.isnan(u).all(0))[:1]:
        name, row = names[k], columns.raw.row_word
        raise BadInput(
            f"{columns.raw.path}: no {kind} of {name} in any {row}; record it, or write "
            f'ignore = ["{STEM[kind]}_{name}"] in meta.toml where it has none'
        )
    if missing.size:
        row, k = missing[0]
        where = f"{columns.raw.row_word} {columns.raw.lines[row]}"
        raise BadInput(
            f"{columns.raw.path}: {where}: no {kind} of {names[k]} (and {len(missing) - 1} more); "
            "remove such rows"
        )


def choose_inputs(
    trials: list[JointColumns], names: ModelNames, meta: LogMeta, moving: Sequence[str]
) -> Inputs:
    """Which columns drive the model in all trials.

    Raises `BadInput` where trials differ or a motor has no column.

    Args:
        moving: Its joints that move, of which alone something is needed.
    """
    kinds = [_kinds(columns) for columns in trials]
    kind: InputKind = meta.input or next(
        (k for k in PREFERRED if all(k in columns_kinds for columns_kinds in kinds)), "none"
    )  # type: ignore[assignment]
    for columns, columns_kinds in zip(trials, kinds, strict=True):
        if kind == "none" and columns_kinds and not meta.input:
            has = " and ".join(sorted(columns_kinds))
            other_trial = next(
                t.raw.name for t, h in zip(trials, kinds, strict=True) if not columns_kinds & h
            )
            raise BadInput(
                f"{columns.raw.path}: has {has} columns, trial {other_trial} has none of them; log "
                f"the same in all trials, "
                'leave trials out by [trials] exclude, or write input = "none" in meta.toml'
            )
        if kind != "none" and kind not in columns_kinds:
            raise BadInput(
                f'{columns.raw.path}: has no column for input = "{kind}"; add {STEM[kind]}1, or '
                f"name it by [columns]"
            )
    first = trials[0]
    if kind == "none":
        notes_off = _motors_off(first, names, meta, moving)
        return Inputs(kind, "", (), (), notes=notes_off)
    notes = _notes(kind, kinds, meta)
    if kind == "command":
        if meta.targets is None:
            _check_next_rows(trials, names)
        return _commands(trials, names, notes, moving)
    stem = STEM[kind]
    if kind == "torque" and not all("tau" in t.by_joint for t in trials):
        stem, notes = "tau_commanded", (*notes, "torques are commands, not measured")
    driven = tuple(joint for joint in _driven_joints(trials, stem, names) if joint in moving)
    undriven = [
        joint for joint in moving if not {joint, *names.coupled.get(joint, ())} & set(driven)
    ]
    for actuator in names.actuators or ():
        if actuator.joint in undriven and not set(actuator.joints) & set(driven):
            raise BadInput(
                f"{first.raw.path}: no {kind} of joint '{actuator.joint}', which has a motor in "
                f"the model; add column {stem}_{actuator.joint}, or take actuator "
                f"'{actuator.name}' out of the model"
            )
    if undriven:
        notes = (*notes, f"no {kind} column, taken as free to move: {', '.join(undriven)}")
    return Inputs(kind, stem, tuple(moving), driven, notes=notes)


def _kinds(columns: JointColumns) -> set[str]:
    kinds = {kind for kind, stem in STEM.items() if stem in columns.by_joint}
    kinds |= {"torque"} if "tau_commanded" in columns.by_joint else set()
    return kinds | ({"command"} if columns.ctrl else set())


def _notes(kind: str, kinds: list[set[str]], meta: LogMeta) -> tuple[str, ...]:
    others = sorted(set.intersection(*kinds) - {kind})
    if meta.input or not others:
        return ()
    return (
        f'input taken from the {kind} columns; write input = "{others[0]}" in meta.toml for the '
        f"{others[0]} columns",
    )


def _driven_joints(trials: list[JointColumns], stem: str, names: ModelNames) -> tuple[str, ...]:
    """Joints with a column of `stem`, the same in all trials."""
    driven = set(trials[0].by_joint[stem])
    for columns in trials[1:]:
        if differing := driven ^ set(columns.by_joint.get(stem, {})):
            joint = names.joints[min(differing)]
            raise BadInput(
                f"{columns.raw.path}: joint '{joint}' has a {stem} column in some trials only; add "
                f"{stem}_{joint} to all (0 where nothing was applied)"
            )
    return tuple(joint for j, joint in enumerate(names.joints) if j in driven)


def _commands(
    trials: list[JointColumns], names: ModelNames, notes: tuple[str, ...], moving: Sequence[str]
) -> Inputs:
    """A command for each actuator of the model; where the model's are not known, for each joint
    with a column.
    """
    if names.actuators is None:
        if "target" in trials[0].by_joint:
            joints = _driven_joints(trials, "target", names)
        else:
            joints = ()
        if any(columns.ctrl for columns in trials):
            joints = joints or _ctrl_joints(trials[0], names)
        actuators = tuple(ActuatorName(joint, joint, "position") for joint in joints)
    else:
        actuators = names.actuators
    if not actuators:
        raise BadInput(
            f"{trials[0].raw.path}: has commands, but the model has no actuator; add <actuator> to "
            f"it, "
            '<position joint="..." kp="..." kv="..."/> for position targets, or log torques'
        )
    without_command: dict[str, None] = {}
    for columns in trials:
        _check_ctrl(columns, actuators)
        for index, actuator in enumerate(actuators):
            if _has_command(columns, actuator, index, names) or not (
                actuator.kind == "other" or set(actuator.joints) & set(moving)
            ):
                continue
            same_joint = [
                a for a in actuators if a is not actuator and set(a.joints) & set(actuator.joints)
            ]
            if actuator.kind == "other" or any(
                _has_command(columns, a, actuators.index(a), names) for a in same_joint
            ):
                without_command[actuator.name] = None
                continue
            _raise_no_command(columns, actuator, names)
        _check_targets(columns, actuators, names, moving)
    if without_command:
        notes = (*notes, f"no command logged, taken as 0: {', '.join(without_command)}")
    driven = tuple(j for j in moving if any(j in a.joints for a in actuators))
    return Inputs("command", "target", tuple(a.name for a in actuators), driven, actuators, notes)


def _check_targets(
    columns: JointColumns,
    actuators: tuple[ActuatorName, ...],
    names: ModelNames,
    moving: Sequence[str],
) -> None:
    """BadInput where a joint that moves has a target, and no actuator."""
    driven = {joint for actuator in actuators for joint in actuator.joints}
    for j in columns.by_joint.get("target", {}):
        joint = names.joints[j]
        if joint in moving and joint not in driven:
            raise BadInput(
                f"{columns.raw.path}: joint '{joint}' has a target, but no actuator in the model; "
                f'add <position joint="{joint}" .../> to it, or write ignore = '
                f'["{columns.named["target", j]}"] in meta.toml'
            )


def _check_next_rows(trials: list[JointColumns], names: ModelNames) -> None:
    """BadInput where a column of targets holds the angles of the next rows, or the steps to them,
    to the bit, as converted data sets have them: what was commanded is not there.
    """
    for (stem, j), column in trials[0].named.items():
        if stem != "target" or any(("q", j) not in t.written for t in trials):
            continue
        pairs = [(t.written["q", j], t.written[stem, j]) for t in trials if (stem, j) in t.written]
        q, next_q, after_next, u = (
            np.concatenate(parts)
            for parts in zip(*((q[:-2], q[1:-1], q[2:], u[:-2]) for q, u in pairs), strict=True)
        )
        is_moving = next_q != q
        for description, value in (
            ("the angle of the next row", next_q),
            ("the step to it", next_q - q),
            ("the angle itself", q),
            ("the angle two rows later", after_next),
        ):
            is_equal = np.abs(u - value) <= COMMAND.rounding * np.max(np.abs(q), initial=0.0)
            if (
                is_moving.sum() >= COMMAND.min_blocks
                and np.mean(is_equal[is_moving]) > COMMAND.min_next_row_share
            ):
                raise BadInput(
                    f"{trials[0].raw.path}: column {column!r} is {description} in nearly every "
                    "row: what "
                    f"joint '{names.joints[j]}' was commanded is not in the log; record it, or "
                    'write targets = "absolute" (as logged) or "relative" (added to the angle) '
                    "under [commands] in meta.toml, to take it all the same"
                )


def _servo_joint(actuator: ActuatorName, names: ModelNames) -> int | None:
    """The number of the joint that a servo drives to an angle; None where that is not what it
    does.
    """
    is_servo = actuator.kind in ("position", "general") and actuator.joint in names.joints
    if is_servo:
        return names.joints.index(actuator.joint)
    return None


def _has_command(
    columns: JointColumns, actuator: ActuatorName, index: int, names: ModelNames
) -> bool:
    """Whether a trial has what an actuator was told: its own column, or a servo the target of its
    joint.
    """
    keys = {actuator.name, actuator.joint, index} & set(columns.ctrl)
    return bool(keys) or _servo_joint(actuator, names) in columns.by_joint.get("target", {})


def _raise_no_command(columns: JointColumns, actuator: ActuatorName, names: ModelNames) -> None:
    path, joint = columns.raw.path, actuator.joint
    if (
        actuator.kind == "motor"
        and joint in names.joints
        and names.joints.index(joint) in columns.by_joint.get("target", {})
    ):
        raise BadInput(
            f"{path}: joint '{joint}' has a target, but its actuator '{actuator.name}' in the "
            f"model is a motor; make it "
            f'<position kp="..." kv="..."/>, or rename the column ctrl_{actuator.name} where it is '
            f"what the motor was told"
        )
    if actuator.kind in ("position", "general"):
        column = f"target_{joint} or ctrl_{actuator.name}"
    else:
        column = f"ctrl_{actuator.name}"
    raise BadInput(
        f"{path}: no command for actuator '{actuator.name}' of joint '{joint}'; add column "
        f"{column}, or hold the joint: [hold] and {joint} = 0.0 in "
        f"meta.toml{also_there(columns.raw, 'target', joint)}"
    )


def _ctrl_joints(columns: JointColumns, names: ModelNames) -> tuple[str, ...]:
    joints = []
    for key in columns.ctrl:
        if isinstance(key, int) and 0 <= key < len(names.joints):
            joint = names.joints[key]
        else:
            joint = key
        if joint not in names.joints:
            raise BadInput(
                f"{columns.raw.path}: column ctrl_{key} names no joint; "
                f"{suggest(str(key), names.joints)}"
            )
        joints.append(joint)
    return tuple(joint for joint in names.joints if joint in joints)


def _check_ctrl(columns: JointColumns, actuators: tuple[ActuatorName, ...]) -> None:
    valid = [name for a in actuators for name in (a.name, a.joint) if name]
    for key in columns.ctrl:
        if isinstance(key, int) and not 0 <= key < len(actuators):
            raise BadInput(
                f"{columns.raw.path}: column ctrl{key + 1}: the model has {len(actuators)} "
                f"actuator(s); "
                f'write ignore = ["ctrl{key + 1}"] in meta.toml, or add the actuator'
            )
        if isinstance(key, str) and key not in valid:
            near = nearest(key, valid)
            if near:
                hint = f"did you mean '{near}'?"
            else:
                hint = f"it has {', '.join(valid)};"
            mend = f'rename it by [columns] in meta.toml, or write ignore = ["ctrl_{key}"]'
            raise BadInput(
                f"{columns.raw.path}: column ctrl_{key}: the model has no actuator '{key}'; {hint} "
                f"{mend}"
            )


def _motors_off(
    columns: JointColumns, names: ModelNames, meta: LogMeta, moving: Sequence[str]
) -> tuple[str, ...]:
    """A note on motors of which nothing is logged and meta.toml says that they were off. BadInput
    where it does not.
    """
    needed = [a for a in names.actuators or () if set(a.joints) & set(moving)]
    if not needed:
        return ()
    first, caveat = needed[0], "nothing can be said of the drives"
    if meta.input == "none":
        joints = ", ".join(dict.fromkeys(a.joint for a in needed))
        return (f"input is none: motors of {joints} are taken as off; if they worked, {caveat}",)
    column = f"target_{first.joint}"
    if first.kind == "motor":
        column = f"ctrl_{first.name}"
    also = also_there(columns.raw, "target", first.joint)
    raise BadInput(
        f"{columns.raw.path}: no command for actuator '{first.name}' of joint '{first.joint}'; add "
        f'column {column} (or tau_{first.joint}), or write input = "none" in meta.toml where its '
        f"motor was off (if it worked, and neither command nor torque is logged, {caveat}){also}"
    )
