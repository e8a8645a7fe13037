"""What a model file switches off is off in the tree as in MuJoCo: flags, groups, equalities."""

import mujoco
import numpy as np
import pytest

from adaptsim_jax.logs.log import model_names
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mechanisms.spec import read_source

ARM = """<mujoco><compiler angle="radian"/><option {option}>{flag}</option><worldbody>
<body gravcomp="0.3"><joint name="a" axis="0 1 0" damping="0.3" stiffness="2" springref="0.2"
    frictionloss="0.1" limited="true" range="-0.3 0.3"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/>
<body pos="0 0 -0.3"><joint name="b" axis="0 1 0" damping="0.2" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
<body pos="0 0 -0.3"><joint name="c" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/></body></body></body>
</worldbody>
<tendon><fixed name="t" stiffness="1.5" damping="0.4" frictionloss="0.05">
<joint joint="b" coef="1"/></fixed></tendon>
<equality><joint joint1="c" joint2="b" polycoef="0 0.8 0 0 0" active="{active}"/></equality>
<actuator><position name="p" joint="a" kp="9" ctrllimited="true" ctrlrange="-0.1 0.1"/>
<velocity name="v" joint="a" kv="4" group="1" damping="0.15" armature="0.02"/>
<motor name="m" joint="b" group="2"/></actuator></mujoco>"""


def flags(kind, last):
    return [name[7:].lower() for name in kind.__members__ if name != last]


CASES = [
    *(f'<flag {name}="disable"/>' for name in flags(mujoco.mjtDisableBit, "mjNDISABLE")),
    *(f'<flag {name}="enable"/>' for name in flags(mujoco.mjtEnableBit, "mjNENABLE")),
    "",
    '<flag spring="disable" damper="disable"/>',
]
TYPES = mujoco.mjtConstraint


def passive_force(tree, q, v):
    """Of the declared springs and dampers [n], MuJoCo's `qfrc_passive`."""
    x, fast = q - tree.springref, np.abs(v)
    drag = tree.damping + tree.damping_poly[:, 0] * fast + tree.damping_poly[:, 1] * fast**2
    pull = tree.stiffness + tree.stiffness_poly[:, 0] * np.abs(x)
    return -drag * v - (pull + tree.stiffness_poly[:, 1] * x**2) * x


def agrees(path, text, ctrl=(0.4, 0.5, 0.6)):
    """The tree against MuJoCo's forces and constraints, beyond the first joint's range."""
    import jax

    from adaptsim_jax.mechanisms import dynamics

    path.write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    made = read_mechanism(path)
    tree, data = made.tree, mujoco.MjData(model)
    way = np.eye(3) if tree.n == 3 else np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.8]])
    rng = np.random.default_rng(1)
    q, v = np.concatenate([[0.5], rng.normal(size=tree.n - 1)]), rng.normal(size=tree.n)
    data.qpos[:], data.qvel[:], data.ctrl[:] = way @ q, way @ v, ctrl
    mujoco.mj_forward(model, data)
    with jax.enable_x64(True):
        bias = dynamics.inverse_dynamics(tree, tree.inertial, q, v, None, tree.gravity)
        passive = passive_force(tree, q, v)
        if (lifted := dynamics.compensation(tree, q)) is not None:
            passive = passive + lifted
    np.testing.assert_allclose(bias, way.T @ data.qfrc_bias, atol=1e-9)
    np.testing.assert_allclose(passive, way.T @ data.qfrc_passive, atol=1e-9)
    pull = np.zeros(tree.n)
    for x in made.actuators:
        u = np.clip(data.ctrl[model.actuator(x.name).id], *np.nan_to_num(x.ctrlrange, nan=np.inf))
        if np.isnan(x.ctrlrange[0]):
            u = data.ctrl[model.actuator(x.name).id]
        speed = x.gear * v[x.joint]
        force = x.gain * u + x.offset - x.kp * x.gear * q[x.joint] - x.kv * speed
        pull[x.joint] += x.gear * force
    np.testing.assert_allclose(pull, way.T @ data.qfrc_actuator, atol=1e-9)
    acts = set(data.efc_type[: data.nefc].tolist())
    assert any(tree.limited) == (int(TYPES.mjCNSTR_LIMIT_JOINT) in acts)
    rubs = {int(TYPES.mjCNSTR_FRICTION_DOF), int(TYPES.mjCNSTR_FRICTION_TENDON)}
    assert np.any(np.asarray(tree.frictionloss) > 0) == bool(rubs & acts)
    assert (tree.n == 2) == (int(TYPES.mjCNSTR_EQUALITY) in acts)
    return made


@pytest.mark.parametrize("flag", CASES)
def test_every_flag_is_off_in_the_tree_as_in_mujoco(tmp_path, flag):
    try:
        mujoco.MjModel.from_xml_string(ARM.format(flag=flag, option="", active="true"))
    except ValueError:
        pytest.skip("MuJoCo's MJCF does not know this flag")
    agrees(tmp_path / "robot.xml", ARM.format(flag=flag, option="", active="true"))


@pytest.mark.parametrize("active", ["true", "false"])
def test_an_equality_that_is_not_active_ties_nothing(tmp_path, active):
    made = agrees(tmp_path / "robot.xml", ARM.format(flag="", option="", active=active))
    assert made.tree.n == (2 if active == "true" else 3)


@pytest.mark.parametrize("groups", ["1", "2", "0 1", "1 2", "0 1 2", "7"])
def test_actuators_of_a_disabled_group_do_nothing(tmp_path, groups):
    option = f'actuatorgroupdisable="{groups}"'
    made = agrees(tmp_path / "robot.xml", ARM.format(flag="", option=option, active="true"))
    off = {"pvm"[int(g)] for g in groups.split() if g != "7"}
    assert {x.name for x in made.actuators} == {"p", "v", "m"} - off
    assert any(
        "do nothing: " + ", ".join(x for x in "pvm" if x in off) in n for n in made.notes
    ) == (bool(off))
    names = model_names(read_source(tmp_path / "robot.xml"))
    assert names.actuators is not None
    assert {a.name: a.kind for a in names.actuators if a.kind == "off"} == dict.fromkeys(off, "off")
