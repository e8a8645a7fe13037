"""A log brought to the coordinates of a mechanism: without joints that follow others, whose torques
go to their leaders.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from adaptsim_jax.logs.log import Log, LogTrial

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.mjcf import Mechanism

APART = 0.05
"""Share of its motion by which a follower's readings may differ from where its leader has it,
before that is told.
"""


def followed(log: Log, mechanism: Mechanism) -> Log:
    """The log with the mechanism's joints alone, in its order."""
    joints = mechanism.tree.joint_names
    if joints == log.joint_names:
        return log
    where = {name: j for j, name in enumerate(log.joint_names)}
    at = [where[name] for name in joints]
    if mechanism.roles:
        followers = [f for f in mechanism.roles.followers.values() if f.joint in where]
    else:
        followers = []
    commanded = log.input_kind == "command"

    def trial(t: LogTrial) -> LogTrial:
        u = t.u
        if not commanded and log.input_kind != "none":
            u = t.u[:, at].copy()
            for f in followers:
                u[:, joints.index(f.leader)] += f.factor * t.u[:, where[f.joint]]
        extra = {stem: values[:, at] for stem, values in t.extra.items()}
        return replace(t, q=t.q[:, at], v=None if t.v is None else t.v[:, at], u=u, extra=extra)

    told, unlike = [], []
    for f in followers:
        own = np.concatenate([t.q[:, where[f.joint]] for t in log.trials])
        led = f.offset + f.factor * np.concatenate([t.q[:, where[f.leader]] for t in log.trials])
        apart, span = np.nanmax(np.abs(own - led)), np.nanmax(own) - np.nanmin(own)
        if apart > APART * span:
            told.append(
                f"{f.joint} does not follow {f.leader} as the model says: by up to {apart:.2g} of "
                f"{span:.2g}; "
                f"nothing is named at {f.leader}"
            )
            unlike.append(f.leader)
    left = [
        name
        for name in log.joint_names
        if name not in joints and name not in {f.joint for f in followers}
    ]
    if left:
        told.append(f"angles of joints that are held are not used: {', '.join(left)}")
    if commanded or log.input_kind == "none":
        names = log.input_names
    else:
        names = joints
    driven = tuple(name for name in joints if name in log.driven)
    return replace(
        log,
        joint_names=joints,
        trials=tuple(map(trial, log.trials)),
        input_names=names,
        driven=driven,
        notes=(*log.notes, *told),
        unlike=tuple(unlike),
    )
