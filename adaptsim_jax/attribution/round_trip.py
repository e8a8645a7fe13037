"""What an export costs: the exported model over recordings, beside model.toml."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.mjx_replay import mjx_errors

HORIZON = 0.5  # s
DECLARED = "declared.xml, MuJoCo"


def round_trip(
    folder: Path, model: Path | None, data: str, mjx: bool
) -> dict[str, Mapping[str, float]]:
    """Median error [rad or m] over stretches of `HORIZON` by joint, of the declared model, of
    model.toml, and of the MJCF that was exported, in MuJoCo C and, where asked for, in MJX.

    Args:
        folder: Of the diagnosis. model: The exported MJCF, None: there is none to run.
        data: The recordings.
    """
    out = {}
    for name, file in (("declared.xml", None), ("model.toml", None), ("exported", model)):
        path = file or folder / name
        if not path.exists() or (name == "exported" and file is None):
            continue
        simulator = "tree" if path.suffix == ".toml" else "mujoco"
        title = f"{name}, MuJoCo" if simulator == "mujoco" else name
        found = replay_files(path, data, HORIZON, ("stretches",), simulator)
        out[title] = _medians(found.joint_names, found.error)
    if mjx and model is not None:
        source, log = read_source_and_log(data, model)
        out["exported, MJX"] = _medians(log.joint_names, mjx_errors(source, log, HORIZON))
    return out


def _medians(joints, error: np.ndarray) -> dict[str, float]:
    return dict(zip(joints, map(float, np.median(error, 0)), strict=True))
