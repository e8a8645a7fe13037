"""Worlds of machines: the same by seed, true to MuJoCo's own integration, effects beyond the
noise.
"""

import json

import mujoco
import numpy as np
import pytest

from tests.generators.mechanism_machines import MACHINES
from tests.generators.mechanism_worlds import World, make_world, write_world


def replay(w: World, trial: int, row: int, rows: int) -> np.ndarray:
    """The true MJCF under the logged commands from a true state, by Runge and Kutta at a quarter of
    a millisecond, `[rows + 1, n]`.
    """
    m = mujoco.MjModel.from_xml_string(w.true)
    m.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    d, t = mujoco.MjData(m), w.drive.times[trial]
    d.qpos[:], d.qvel[:] = w.clean_q[trial, row], w.clean_v[trial, row]
    out = [d.qpos.copy()]
    for r in range(row, row + rows):
        d.ctrl[:] = w.command[trial, r, list(w.machine.driven)]
        m.opt.timestep = (t[r + 1] - t[r]) / 16
        mujoco.mj_step(m, d, 16)
        out.append(d.qpos.copy())
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["torque", "position"])
@pytest.mark.parametrize("machine", MACHINES)
def test_the_true_parameters_of_a_null_world_move_as_recorded(machine, mode):
    w = make_world("null", 3, machine=machine, mode=mode)
    noise = w.drive.noise[:, :, 0].std((0, 1))
    for trial, row in ((0, 100), (1, 500), (2, 300)):
        error = replay(w, trial, row, 100) - w.clean_q[trial, row : row + 101]
        # half the noise: the two integrations differ by less than a tenth of a mrad
        assert np.all(np.sqrt(np.mean(error**2, 0)) < 0.5 * noise)


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["double_pendulum", "arm3"])
@pytest.mark.parametrize("effect", ["coulomb", "delay", "spring", "armature"])
def test_an_effect_changes_the_motion_beyond_the_noise(machine, effect):
    w = make_world("single", 5, machine=machine, mode="position", effect=effect)
    (e,) = w.truth["effects"]
    assert e["name"] == effect
    assert all(0.02 < share for share in e["share"].values())


def test_a_world_is_the_same_by_seed_and_another_by_another(tmp_path):
    a, b, c = (write_world(tmp_path / str(k), "single", seed) for k, seed in enumerate((7, 7, 8)))
    files = sorted(p.relative_to(a) for p in a.rglob("*.*") if p.is_file())
    assert {
        "true.xml",
        "truth.json",
        "recording/model.xml",
        "recording/meta.toml",
        "recording/trial_05.csv",
    } <= set(map(str, files))
    assert all((a / f).read_bytes() == (b / f).read_bytes() for f in files)
    assert (a / "recording/model.xml").read_text() != (c / "recording/model.xml").read_text()
    assert json.loads((a / "truth.json").read_text())["seed"] == 7
