"""What was logged of a mechanism: trials and joints in SI units, and the names of its model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from adaptsim_jax.core.config import pick
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.log_meta import LogMeta

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.mjcf import Mechanism
    from adaptsim_jax.mechanisms.spec import Source

InputKind = Literal["torque", "command", "voltage", "current", "none"]


@dataclass(frozen=True)
class ActuatorName:
    """An actuator of the model and the joint that it drives.

    - `kind`: Motor, position, velocity, general, dcmotor, tendon (on several joints), other (on
      none: a site, a body) or off (the file disables it).
    - `moved_joints`: All joints that it drives, those coupled to them included.
    - `per_angle`, `at_zero`: What a servo must be commanded to go to an angle `q` (rad, m):
      `at_zero + per_angle q`, by its gear, gain and bias.
    """

    name: str
    joint: str
    kind: str = "motor"
    moved_joints: tuple[str, ...] = ()
    per_angle: float = 1.0
    at_zero: float = 0.0

    @property
    def joints(self) -> tuple[str, ...]:
        return self.moved_joints or ((self.joint,) if self.joint else ())


@dataclass(frozen=True)
class ModelNames:
    """What a reader of logs must know of a model.

    - `joints`: Hinge and slide joints in the model's order.
    - `slides`: Those that slide (logged in m, not rad).
    - `parents`: For each joint the index of the joint before it in the tree, -1 for none (empty: a
      serial chain).
    - `actuators`: In the model's order, None where nothing is known of them.
    - `coupled`: Joints that go with others, and with which.
    - `ranges`: Of each joint in rad or m, None where it has none (empty: not known).
    """

    joints: tuple[str, ...]
    slides: tuple[str, ...] = ()
    parents: tuple[int, ...] = ()
    actuators: tuple[ActuatorName, ...] | None = None
    coupled: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    ranges: tuple[tuple[float, float] | None, ...] = ()

    def is_angle_target(self, joint: int) -> bool:
        """Whether a target of a joint is an angle: not where it slides, nor where all that drives
        it takes speeds or torques.
        """
        kinds = [a.kind for a in self.actuators or () if a.joint == self.joints[joint]]
        return self.joints[joint] not in self.slides and (
            not kinds or any(k in ("position", "general") for k in kinds)
        )

    def limits_of(self, joint: int) -> tuple[float, float] | None:
        """The range of a joint, where the model declares one."""
        if joint < len(self.ranges):
            return self.ranges[joint]
        return None

    @property
    def parent_of(self) -> tuple[int, ...]:
        """`parents`, those of a serial chain where none are given."""
        return self.parents or tuple(range(-1, len(self.joints) - 1))

    def only(self, indices: Sequence[int]) -> ModelNames:
        """Return the names of the joints with these numbers alone."""
        new_index = {j: i for i, j in enumerate(indices)}

        def before(j: int) -> int:
            while (j := self.parent_of[j]) >= 0:
                if j in new_index:
                    return new_index[j]
            return -1

        joints = tuple(self.joints[j] for j in indices)
        slides = tuple(s for s in self.slides if s in joints)
        parents = tuple(before(j) for j in indices)
        ranges = tuple(self.ranges[j] for j in indices if self.ranges)
        return ModelNames(joints, slides, parents, self.actuators, self.coupled, ranges)


@dataclass(frozen=True)
class LogTrial:
    """One trial of `T` rows and `n` joints, in the model's order of joints.

    - `time [T]`: s, increasing, unevenly spaced.
    - `q [T, n]`: rad (hinge) or m (slide), NaN where a value is missing.
    - `v [T, n]`: rad/s or m/s, None where no speed was logged.
    - `u [T, m]`: The input, which holds from its row to the next: N m or N (torque), what the
      actuators were told (command), V, A.
    - `extra`: Other quantities of the file by their stem (`tau_commanded`, `target`, ...), each
      `[T, n]` and NaN for joints without.
    - `base [T, 7]`: m and a unit quaternion (w first) of a free base, None where not logged.
    - `channels`: By sensor of the model (`gyro[0]`) what `[channels]` compares with it `[T]`, in
      the sensor's unit.
    """

    name: str
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    u: np.ndarray
    path: str = ""
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    base: np.ndarray | None = None
    channels: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def span(self) -> float:
        """s."""
        return float(self.time[-1] - self.time[0])

    @property
    def dt(self) -> float:
        """Median sampling interval in s."""
        return float(np.median(np.diff(self.time)))

    def rows(self, start: int, stop: int) -> LogTrial:
        """The trial's rows `start` to `stop` (exclusive)."""
        rows = slice(start, stop)
        v = None if self.v is None else self.v[rows]
        extra = {name: values[rows] for name, values in self.extra.items()}
        base = None if self.base is None else self.base[rows]
        channels = {name: values[rows] for name, values in self.channels.items()}
        return replace(
            self,
            time=self.time[rows],
            q=self.q[rows],
            v=v,
            u=self.u[rows],
            extra=extra,
            base=base,
            channels=channels,
        )


@dataclass(frozen=True)
class Log:
    """Trials of one mechanism and what its `meta.toml` declares.

    - `input_names [m]`: Joints (torque, voltage, current), or actuators (command; joints where the
      model's actuators are not known).
    - `driven`: Joints that have an input column, torque is 0 at the others.
    - `notes`: What a person should know of how the files were read, a line each.
    - `held`: Joints that stand still in all trials, or that `[hold]` names, and where they were
      (None: nothing was logged). They are not among `joint_names`.
    - `input_columns [m]`: The column that each actuator's command was read from.
    - `unlike`: Joints whose followers do not follow as the model says.
    - `labels`: Of the logs that were pooled, by which their trials' names begin; none of one log.
    """

    path: str
    meta: LogMeta
    joint_names: tuple[str, ...]
    trials: tuple[LogTrial, ...]
    input_kind: InputKind
    input_names: tuple[str, ...]
    driven: tuple[str, ...]
    notes: tuple[str, ...] = ()
    held: dict[str, float | None] = field(default_factory=dict)
    input_columns: tuple[str, ...] = ()
    unlike: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Rows over all trials."""
        return sum(len(trial.time) for trial in self.trials)

    def label_of(self, trial: str) -> str:
        """The label of the log that a trial is of; its own name where there is one log."""
        mine = [label for label in self.labels if trial.startswith(f"{label}/")]
        return max(mine, key=len, default=trial)

    def pick(self, names: Sequence[str]) -> Log:
        """The log with these trials only, in this order; BadInput names one that is not there."""
        by_name = {trial.name: trial for trial in self.trials}
        return replace(
            self, trials=tuple(by_name[pick(f"trial of {self.path}:", n, by_name)] for n in names)
        )

    def without(self, names: Sequence[str]) -> Log:
        """The log without these trials. BadInput where one is not there, or none would be left."""
        check_excluded(self.path, [trial.name for trial in self.trials], names)
        return replace(self, trials=tuple(t for t in self.trials if t.name not in names))

    def column(self, stem: str, joint: str) -> str:
        """What a joint's column is called in messages: `q_elbow`, of a double pendulum `q1`."""
        if self.meta.rig is not None:
            return f"{stem}{self.joint_names.index(joint) + 1}"
        return f"{stem}_{joint}"


def check_excluded(path: str, existing: Sequence[str], names: Sequence[str]) -> None:
    """Raise BadInput where a trial to leave out is not there, or none would be left."""
    if unknown := [name for name in names if name not in existing]:
        raise BadInput(
            f"{path}: no trial is named {unknown[0]!r}; --without takes of {', '.join(existing)}"
        )
    if not set(existing) - set(names):
        raise BadInput(f"{path}: --without names every trial; leave some")


def model_names(source: Source) -> ModelNames:
    """The names of a model file: all joints that a log may have, which of them slide, the tree, the
    actuators.
    """
    import mujoco

    from adaptsim_jax.mechanisms.roles import (
        BALL,
        BALL_AXES,
        FREE,
        JOINT_TRANSMISSIONS,
        coupled_joints,
        joint_names,
        tendon_joints,
    )
    from adaptsim_jax.mechanisms.switches import is_off

    model = source.model
    joints = joint_names(model)
    coupled = coupled_joints(source)
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    slides = [model.joint(k).name for k in range(model.njnt) if model.jnt_type[k] == slide]
    parents, ranges, last = [], [], {0: -1}
    for b in range(1, model.nbody):
        parent = last[int(model.body_parentid[b])]
        for k in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
            for _ in range({BALL: len(BALL_AXES), FREE: 0}.get(int(model.jnt_type[k]), 1)):
                parents.append(parent)
                has_range = model.jnt_limited[k] and model.jnt_type[k] != BALL
                ranges.append(tuple(map(float, model.jnt_range[k])) if has_range else None)
                parent = len(parents) - 1
        last[b] = parent
    actuators = []
    for k in range(model.nu):
        trn, target = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
        is_disabled = is_off(model, k)
        targets = (
            [model.joint(target).name] if trn in JOINT_TRANSMISSIONS and not is_disabled else []
        )
        if trn == int(mujoco.mjtTrn.mjTRN_TENDON) and not is_disabled:
            targets = [model.joint(k).name for k in tendon_joints(model, target)]
        moved_joints = tuple(
            dict.fromkeys(
                other
                for name in targets
                for other in (name, *coupled.get(name, ()))
                if other in joints
            )
        )
        if is_disabled:
            kind = "off"
        elif trn in JOINT_TRANSMISSIONS:
            kind = _kind(model, k)
        elif moved_joints:
            kind = "tendon"
        else:
            kind = "other"
        joint = moved_joints[0] if moved_joints else ""
        command_scale = _command_at(model, k) if kind in ("position", "general") else (1.0, 0.0)
        actuators.append(
            ActuatorName(model.actuator(k).name, joint, kind, moved_joints, *command_scale)
        )
    return ModelNames(
        joints, tuple(slides), tuple(parents), tuple(actuators), coupled, tuple(ranges)
    )


def _kind(model, k: int) -> str:
    """motor, position, velocity, general or dcmotor, by an actuator's gain and bias."""
    import mujoco

    gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
    if model.actuator_gaintype[k] == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
        return "dcmotor"
    if not any(bias[:3]):
        return "motor"
    if bias[0] or gain[0] not in (-bias[1], -bias[2]):
        return "general"
    if bias[1]:
        return "position"
    return "velocity"


def _command_at(model, k: int) -> tuple[float, float]:
    """`per_angle` and `at_zero` of an actuator of a joint; 1 and 0 where no angle balances it."""
    gain, bias, gear = (
        float(x)
        for x in (
            model.actuator_gainprm[k, 0],
            -model.actuator_biasprm[k, 1],
            model.actuator_gear[k, 0],
        )
    )
    if not gain or not bias:
        return 1.0, 0.0
    return bias * gear / gain, float(-model.actuator_biasprm[k, 0] / gain)


def restrict_log(log: Log, mechanism: Mechanism) -> Log:
    """Restrict a log to the mechanism's joints, in its order."""
    joints = mechanism.tree.joint_names
    if joints == log.joint_names:
        return log
    index_of = {name: j for j, name in enumerate(log.joint_names)}
    indices = [index_of[name] for name in joints]
    if mechanism.roles:
        followers = [f for f in mechanism.roles.followers.values() if f.joint in index_of]
    else:
        followers = []
    is_commanded = log.input_kind == "command"

    def restrict(t: LogTrial) -> LogTrial:
        u = t.u
        if not is_commanded and log.input_kind != "none":
            u = t.u[:, indices].copy()
            for f in followers:
                u[:, joints.index(f.leader)] += f.factor * t.u[:, index_of[f.joint]]
        extra = {stem: values[:, indices] for stem, values in t.extra.items()}
        return replace(
            t, q=t.q[:, indices], v=None if t.v is None else t.v[:, indices], u=u, extra=extra
        )

    notes, mismatched_leaders = [], []
    for f in followers:
        angle = np.concatenate([t.q[:, index_of[f.joint]] for t in log.trials])
        expected = f.offset + f.factor * np.concatenate(
            [t.q[:, index_of[f.leader]] for t in log.trials]
        )
        deviation, span = np.nanmax(np.abs(angle - expected)), np.nanmax(angle) - np.nanmin(angle)
        if deviation > UNIT.follower_tolerance * span:
            notes.append(
                f"{f.joint} does not follow {f.leader} as the model says: by up to {deviation:.2g} "
                f"of {span:.2g}; nothing is named at {f.leader}"
            )
            mismatched_leaders.append(f.leader)
    used = {*joints, *(f.joint for f in followers)}
    unused = [name for name in log.joint_names if name not in used]
    if unused:
        notes.append(f"angles of joints that are held are not used: {', '.join(unused)}")
    if is_commanded or log.input_kind == "none":
        names = log.input_names
    else:
        names = joints
    driven = tuple(name for name in joints if name in log.driven)
    return replace(
        log,
        joint_names=joints,
        trials=tuple(map(restrict, log.trials)),
        input_names=names,
        driven=driven,
        notes=(*log.notes, *notes),
        unlike=tuple(mismatched_leaders),
    )
