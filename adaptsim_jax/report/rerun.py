"""A diagnosis as a recording for the viewer Rerun: angles measured and simulated, residuals, and
the robot as it moved beside what each model made of it.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput

if TYPE_CHECKING:
    from adaptsim_jax.attribution.replay import Replay

NAME = "report.rrd"
COLOURS = {"measured": 0xAAAAAAFF, "declared": 0xD62728FF, "mended": 0x1F77B4FF}


def rerun_module() -> Any:
    """Rerun. Raises BadInput where it is not installed."""
    try:
        return importlib.import_module("rerun")
    except ImportError:
        raise BadInput(
            "--rerun: Rerun is not installed; pip install 'adaptsim_jax[rerun]', or leave --rerun "
            "out"
        ) from None


def save_rerun(path: Path, replays: Mapping[str, Replay], model: mujoco.MjModel) -> None:
    """Write a recording with a branch for each trial: `angle/JOINT/NAME` and `residual/JOINT/NAME`
    (rad or m), and `robot/NAME`, where a name is `measured` or that of a replay.

    Args:
        replays: Of the same stretches, by a name of `COLOURS`.
        model: Has the joints, for where its bodies stand.
    """
    rerun = rerun_module()
    recording = rerun.RecordingStream("adaptsim diagnose")
    recording.save(path)
    first = next(iter(replays.values()))
    motions = {"measured": first.measured} | {name: r.simulated for name, r in replays.items()}
    for k, trial in enumerate(first.trial_names):
        here = first.trial == k
        times = [rerun.TimeColumn("time", duration=first.time[here].ravel())]
        for name, motion in motions.items():
            rows = motion[here].reshape(-1, len(first.joint_names))
            series = {"angle": rows}
            if name != "measured":
                series["residual"] = first.measured[here].reshape(rows.shape) - rows
            for kind, values in series.items():
                for j, joint in enumerate(first.joint_names):
                    entity = rerun.new_entity_path([trial, kind, joint, name])
                    scalars = rerun.Scalars.columns(scalars=values[:, j])
                    recording.send_columns(entity, times, scalars)
            for body, pose in enumerate(_poses(model, first.joint_names, rows), 1):
                label = model.body(body).name or str(body)
                entity = rerun.new_entity_path([trial, "robot", name, label])
                moved = rerun.Transform3D.columns(translation=pose[:, :3], quaternion=pose[:, 3:])
                recording.send_columns(entity, times, moved)
                lines = rerun.LineStrips3D(_lines(model, body), colors=COLOURS[name])
                recording.log(entity, lines, static=True)
    recording.flush()


def _poses(model: mujoco.MjModel, joints: tuple[str, ...], rows: np.ndarray) -> np.ndarray:
    """Position in m and quaternion, scalar last, of each body but the world, `[B, R, 7]`, at the
    angles `rows [R, n]`; joints without a name there stay where the file has them.
    """
    data = mujoco.MjData(model)
    at = {j: model.joint(name).qposadr[0] for j, name in enumerate(joints) if _has(model, name)}
    poses = []
    for row in rows:
        for j, place in at.items():
            data.qpos[place] = row[j]
        mujoco.mj_kinematics(model, data)
        poses.append(np.hstack([data.xpos, np.roll(data.xquat, -1, axis=1)])[1:])
    return np.array(poses).swapaxes(0, 1)


def _has(model: mujoco.MjModel, joint: str) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0


def _lines(model: mujoco.MjModel, body: int) -> list[np.ndarray]:
    """From a body's origin to its centre of mass and to its children's origins, m."""
    ends = [model.body_ipos[body], *model.body_pos[model.body_parentid == body]]
    return [np.stack([np.zeros(3), end]) for end in ends]
