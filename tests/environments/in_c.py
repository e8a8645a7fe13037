"""The worlds of the catalogue as `model.xml` in MuJoCo C, beside `replay` of their `model.toml`.

python -m tests.environments.in_c
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from adaptsim_jax.attribution.in_mjcf import changes_of
from adaptsim_jax.attribution.model_toml import OWN
from adaptsim_jax.core import config
from adaptsim_jax.environments.mended import declared_machine
from adaptsim_jax.mend.mjcf import mended_mjcf
from adaptsim_jax.mend.model_toml import read_form
from tests.environments import catalogue

SENT = np.array([6.0, 2.0])  # of an action of one


def mjcf_of(path: Path) -> str:
    """The model.xml of a model.toml with declared.xml beside it, of what MJCF holds of it."""
    was = declared_machine(path.parent / "declared.xml")
    form = read_form(config.read(path), str(path), OWN)
    return mended_mjcf(was.mechanism, changes_of(was, form))


def in_c(mjcf: str) -> np.ndarray:
    """Readings [T + 1, 2] under the actions of the catalogue; commands before the first are it."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    data.qpos[:] = catalogue.START + model.qpos0
    first, rows = catalogue.ACTIONS[0] * SENT, [data.qpos.copy()]
    for k in range(model.nu):
        count = int(model.actuator_history[k, 0])
        if count:
            times = -model.opt.timestep * np.arange(count, 0, -1.0)
            mujoco.mj_initCtrlHistory(model, data, k, times, np.full((count, 1), first[k]))
        if model.actuator_actadr[k] >= 0:
            data.act[model.actuator_actadr[k]] = first[k]
    for action in catalogue.ACTIONS:
        data.ctrl[:] = action * SENT
        mujoco.mj_step(model, data, round(catalogue.CONTROL / catalogue.STEP))
        rows.append(data.qpos.copy())
    return np.array(rows)


def error(folder: Path, world: str) -> np.ndarray:
    """rms over time [2], rad, by which model.xml in MuJoCo C and replay of model.toml differ."""
    path = catalogue.written(folder, world)
    off = in_c(mjcf_of(path)) - catalogue.replayed(path)
    return np.sqrt(np.mean(np.square(off[1:-1]), 0))


def main() -> None:
    """A line for each world."""
    with TemporaryDirectory() as folder:
        for world in sys.argv[1:] or catalogue.WORLDS:
            print(
                f"| {world} | {' | '.join(f'{1e3 * z:.2f}' for z in error(Path(folder), world))} |"
            )


if __name__ == "__main__":
    main()
