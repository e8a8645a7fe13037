"""The `model.toml` of a double pendulum: a mechanism's, which a recording of the rig may name as
its declared model, and which goes into an environment as any machine's does.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.pendulum import check_rig
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.mechanisms.double_pendulum.plant import double_pendulum_mjcf

THETA = np.array([0.12, 0.03, 0.3, 0.11, 0.06, 0.03])
FILE = """schema = 2
task = "mechanism"
model = "declared.xml"
angle_zero = "hanging"

[geometry]
g = 9.81
l1 = 0.3

[[effects]]
name = "viscous"
where = "joint1"
[effects.parameters.damping]
value = 0.2

[[effects]]
name = "stribeck"
where = "joint2"
[effects.parameters.excess]
value = 0.02
[effects.parameters.speed]
value = 0.5
"""
META = 'task = "pendulum"\nmodel = "../model.toml"\n'


def recorded(folder, meta: str, file: str = FILE):
    """A short recording beside its mended model."""
    (folder / "declared.xml").write_text(double_pendulum_mjcf(THETA, {"l1": 0.3}, "hanging"))
    (folder / "model.toml").write_text(file)
    (folder / "rig").mkdir()
    (folder / "rig" / "meta.toml").write_text(META + meta)
    t = np.arange(200) / 200
    rows = np.stack([t, 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t), 0 * t, 0.1 * np.sin(t)], 1)
    header = "time,q1,q2,tau1,tau2"
    np.savetxt(folder / "rig" / "a.csv", rows, delimiter=",", header=header, comments="")
    return folder / "rig"


@pytest.mark.parametrize(
    ("file", "kind"), [(FILE, "rigid_body"), ("linear = true\n" + FILE, "linearized")]
)
def test_a_recording_takes_the_geometry_of_its_mended_model(tmp_path, file, kind):
    data = recorded(tmp_path, 'angle_zero = "hanging"\n', file)
    rig = read_pendulum(data).meta.rig
    check_rig(rig)
    assert rig.model == kind and rig.geometry["l1"] == 0.3
    machine = load(data, tmp_path / "model.toml")
    assert machine.tree.linear == (kind == "linearized")
    np.testing.assert_allclose(machine.declared["viscous", "damping"], [0.2, 0.03])
    np.testing.assert_allclose(machine.declared["stribeck", "excess"], [0.0, 0.02])


@pytest.mark.parametrize(
    ("meta", "named"),
    [
        ('angle_zero = "upright"\n', "angle_zero"),
        ('angle_zero = "hanging"\n[geometry]\nl1 = 0.5\n', "l1"),
    ],
)
def test_a_mended_model_of_another_rig_is_refused(tmp_path, meta, named):
    rig = read_pendulum(recorded(tmp_path, meta)).meta.rig
    with pytest.raises(BadInput, match=named):
        check_rig(rig)


def test_a_mended_pendulum_goes_into_an_environment(tmp_path):
    recorded(tmp_path, 'angle_zero = "hanging"\n')
    text = (tmp_path / "declared.xml").read_text()
    env = ModelEnvironment(
        text.replace("<motor ", '<motor ctrlrange="-1 1" '),
        lambda data: jnp.concatenate([data.qpos, data.qvel]),
        lambda data, action: -jnp.sum(jnp.square(action)),
    )
    one = mended(env, tmp_path / "model.toml")
    np.testing.assert_allclose(one.mj_model.dof_damping, [0.2, 0.03])
    (tmp_path / "model.toml").write_text("linear = true\n" + FILE)
    with pytest.raises(BadInput, match="linear"):
        mended(env, tmp_path / "model.toml")
