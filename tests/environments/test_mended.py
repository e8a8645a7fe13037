"""An environment that carries what a diagnosis found: by name, absolute, and refused by name where
it cannot.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from tests.environments import small

ROBOT = """
<mujoco><option timestep="0.02"/><worldbody><body name="cart">
  <joint name="{joint}" type="slide" axis="1 0 0" damping="{damping}" frictionloss="{dry}" armature="{armature}"/>
  <geom type="box" size="0.1 0.1 0.1" mass="{mass}"/></body></worldbody>
<actuator><motor name="motor" joint="{joint}" gear="4" ctrlrange="-1 1"/></actuator></mujoco>
"""  # noqa: E501
AS_DECLARED = {"damping": 0.4, "dry": 0, "armature": 0, "mass": 1}
FOUND = {"damping": 0.7, "dry": 0.3, "armature": 0.05, "mass": 1.2}
HEAVIER = "[inertial]\nslide = [1.2, 0, 0, 0, 0.008, 0, 0, 0.008, 0, 0.008]\n"


def written(folder, effects="", joint="slide", own=HEAVIER):
    (folder / "declared.xml").write_text(ROBOT.format(joint=joint, **AS_DECLARED))
    (folder / "found.xml").write_text(ROBOT.format(joint=joint, **FOUND))
    path = folder / "model.toml"
    head = 'schema = 2\ntask = "mechanism"\nmodel = "declared.xml"\nfriction = "gives"\n'
    path.write_text(head + own.replace("slide", joint) + effects)
    return path


def effect(name, value, parameter, joint="slide"):
    return (
        f'[[effects]]\nname = "{name}"\nwhere = '
        f'"{joint}"\n[effects.parameters.{parameter}]\nvalue = {value}\n'
    )


PUSHES = np.where(np.arange(10) < 4, 1.0, -0.7)
NUMBERS = (
    effect("viscous", 0.7, "damping")
    + effect("coulomb", 0.3, "level")
    + effect("armature", 0.05, "inertia")
)


def test_the_model_has_what_was_found_and_the_rest_as_it_was(tmp_path):
    env = small.make()
    path = written(tmp_path, NUMBERS + effect("delay", 0.03, "delay"))
    one = mended(env, path)
    own = one.mj_model
    found = [
        own.dof_damping[0],
        own.dof_frictionloss[0],
        own.dof_armature[0],
        own.body("cart").mass[0],
    ]
    np.testing.assert_allclose(found, [0.7, 0.3, 0.05, 1.2])
    assert (
        env.mj_model.dof_damping[0] == 0.4
        and own.ngeom == env.mj_model.ngeom
        and not own.opt.gravity.any()
    )
    setting = setting_of(one, EnvironmentConfig(targets={"as_found": {}, "later": {"delay": 0.05}}))
    assert setting.targets["as_found"].values[-1] == 0.03 and setting.space.names == tuple(
        small.FIELDS
    )
    values = jnp.asarray([1.2, 0.7], jnp.float32)

    @jax.jit
    def places(values):
        world = setting.play.world(values)

        def step(live, action):
            return (setting.play.step(world, live, action),) * 2

        first = setting.play.reset(world, jax.random.key(0))
        return jax.lax.scan(step, first, jnp.asarray(PUSHES)[:, None])[1].obs[:, 0]

    # late by one and a half steps of 20 ms, by hand in MuJoCo C
    model, data = mujoco.MjModel.from_xml_path(str(path.parent / "found.xml")), None
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[0] = 0.5
    expected = []
    sent = np.repeat(PUSHES, 2)
    before = np.concatenate([[PUSHES[0]] * 2, sent])
    for i in range(20):
        data.ctrl[0] = 0.5 * (before[i] + before[i + 1])
        mujoco.mj_step(model, data)
        expected.append(data.qpos[0])
    expected = expected[1::2]
    np.testing.assert_allclose(places(values), expected, atol=2e-4)


@pytest.mark.parametrize(
    ("effects", "joint", "tells"),
    [
        (effect("stribek", 0.2, "level"), "slide", "no effect of a mechanism; did you mean 'stri"),
        (effect("delay", -0.1, "delay"), "slide", "give 0 or more"),
        (effect("delay", 0.1, "delay", "hinge"), "slide", "'hinge' is no joint of its model"),
        (effect("bias", 0.1, "torque", "slidr"), "slidr", "has no joint 'slidr'; did you mean"),
    ],
)
def test_what_it_cannot_say_is_refused_by_name(effects, joint, tells, tmp_path):
    with pytest.raises(BadInput, match=tells):
        mended(small.make(), written(tmp_path, effects, joint=joint))


def test_a_file_of_something_else_is_refused(tmp_path):
    path = written(tmp_path)
    path.write_text('task = "pushing"')
    with pytest.raises(BadInput, match="of a robot"):
        mended(small.make(), path)
    path.write_text('schema = 2\ntask = "mechanism"\nmodel = "declared.xml"\n')
    (tmp_path / "declared.xml").unlink()
    with pytest.raises(BadInput, match=r"declared.xml: no such file; keep it beside"):
        mended(small.make(), path)
    with pytest.raises(BadInput, match="holds no mj_model"):
        mended(object.__new__(type("Nothing", (), {})), path)
