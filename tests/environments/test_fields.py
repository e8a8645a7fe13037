"""Numbers of a model by name: read, edited in an `mjx.Model` and in MuJoCo's, refused with the
nearest name.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.fields import (
    ATTRIBUTES,
    domain_randomize,
    edit_native,
    edited,
    field_of,
    known_fields,
    space_of,
)
from adaptsim_jax.environments.simulated import simulated
from adaptsim_jax.mechanisms.model_numbers import array_at, parse
from tests.environments.small import make

SERVO = """
<mujoco><worldbody><body name="arm"><joint name="hinge" damping="0.1"/><geom name="link" type="capsule" size=".02"
  fromto="0 0 0 .3 0 0" mass=".5"/></body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="7" ctrlrange="-1 1"/></actuator></mujoco>
"""  # noqa: E501
NAMES = {  # of SERVO: what each name reads there
    "body:arm.mass": 0.5,
    "joint:hinge.damping": 0.1,
    "joint:hinge.frictionloss": 0.0,
    "geom:link.friction[0]": 1.0,
    "geom:link.friction": 1.0,
    "actuator:servo.gain": 7.0,
    "actuator:servo.gear": 1.0,
    "option.gravity[2]": -9.81,
    "option.viscosity": 0.0,
    "delay": 0.0,
    "action_scale": 1.0,
}


@pytest.fixture(scope="module")
def servo():
    return mujoco.MjModel.from_xml_string(SERVO)


@pytest.mark.parametrize("name", NAMES)
def test_a_field_reads_what_the_file_says(servo, name):
    field = field_of(servo, name)
    assert field.nominal == pytest.approx(NAMES[name]) and field.unit
    assert name.partition("[")[0] in known_fields(servo)


def test_an_edit_is_the_same_in_mjx_and_in_mujoco(servo):
    env = make()
    fields = tuple(
        field_of(env.mj_model, n)
        for n in (
            "body:cart.mass",
            "joint:slide.damping",
            "option.gravity[2]",
            "actuator:motor.gear",
        )
    )
    values = [3.0, 0.7, -1.5, 2.0]
    x = jax.jit(lambda m, v: edited(m, fields, v))(env.mjx_model, jnp.asarray(values))
    c = edit_native(mujoco.MjModel.from_xml_string(mujoco_xml()), fields, values)
    assert c.body("cart").mass == 3.0 and x.opt.gravity[2] == c.opt.gravity[2] == -1.5
    for array in ("body_mass", "body_inertia", "dof_damping", "actuator_gear"):
        np.testing.assert_allclose(np.asarray(getattr(x, array)), getattr(c, array), rtol=1e-6)
    # a heavier body of the same shape turns heavier too
    np.testing.assert_allclose(c.body("cart").inertia, 3.0 * env.mj_model.body("cart").inertia)


def mujoco_xml() -> str:
    from tests.environments.small import MJCF

    return MJCF.format(constraint="enable")


def test_a_servo_stays_one_when_its_gain_changes(servo):
    field = field_of(servo, "actuator:servo.gain")
    model = edit_native(mujoco.MjModel.from_xml_string(SERVO), [field], [3.0])
    assert model.actuator_gainprm[0, 0] == 3.0 and model.actuator_biasprm[0, 1] == -3.0


@pytest.mark.parametrize(
    ("name", "tells"),
    [
        ("body:amr.mass", "did you mean 'body:arm'?"),
        ("joint:hinge.dampign", "a joint has damping"),
        ("body:arm.ipos", "write 'body:arm.ipos[0]'"),
        ("body:arm.ipos[3]", "give [0] to [2]"),
        ("joint:hinge.damping[0]", "leave '[0]' out"),
        ("dleay", "did you mean 'delay'?"),
        ("body.mass", "is no field"),
    ],
)
def test_a_field_that_is_not_there_is_one_line_with_the_mend(servo, name, tells):
    with pytest.raises(BadInput) as error:
        field_of(servo, name)
    assert tells in str(error.value) and "\n" not in str(error.value) and name in str(error.value)


@pytest.mark.parametrize(
    ("given", "tells"),
    [
        ([1.0], r"give \[low"),
        ([0.1, "x"], r"give \[low"),
        ([-1.0, 1.0], "its least is"),
        ([2.0, 1.0], "swap"),
    ],
)
def test_a_range_that_makes_no_sense_is_refused(servo, given, tells):
    with pytest.raises(BadInput, match=tells):
        space_of(servo, {"body:arm.mass": given})
    with pytest.raises(BadInput, match="there is no field"):
        space_of(servo, {})


def test_one_compiled_step_serves_all_values():
    env, traced = make(), []
    space, fields = space_of(env.mj_model, env.fields)
    sim = simulated(env, fields)

    @jax.jit
    def step(values):
        traced.append(1)
        model = sim.edit(sim.model, fields, values)
        return sim.observed(sim.step(model, sim.reset(model, jax.random.key(0)), jnp.ones(1)))[0]

    light, heavy = (step(jnp.asarray(v, jnp.float32)) for v in ([0.5, 0.1], [2.0, 0.1]))
    assert len(traced) == 1 and light[1] > 3.5 * heavy[1] > 0
    assert space.names == ("body:cart.mass", "joint:slide.damping")


def test_domain_randomisation_is_in_the_form_that_playground_and_brax_take():
    env = make()
    randomize = domain_randomize(
        env.mj_model, {"body:cart.mass": [0.5, 2.0, "log"], "option.gravity[2]": [-11.0, -9.0]}
    )
    models, in_axes = randomize(env.mjx_model, jax.random.split(jax.random.key(0), 5))
    mass = np.asarray(jax.vmap(lambda m: m.body_mass[1], in_axes=(in_axes,))(models))
    assert (
        mass.shape == (5,) and len(set(mass)) == 5 and (mass >= 0.5).all() and (mass <= 2.0).all()
    )
    assert (
        models.opt.gravity.shape == (5, 3)
        and models.dof_damping.shape == env.mjx_model.dof_damping.shape
    )
    with pytest.raises(BadInput, match="of the interface"):
        domain_randomize(env.mj_model, {"delay": [0.0, 0.1]})


def test_a_star_is_all_of_a_kind_in_proportion():
    two = SERVO.replace(
        "</actuator>", '<position name="other" joint="hinge" kp="14" ctrlrange="-1 1"/></actuator>'
    )
    model = mujoco.MjModel.from_xml_string(two)
    field = field_of(model, "actuator:*.gain")
    assert field.nominal == 7.0 and field.name == "actuator:*.gain"
    edit_native(model, (field,), [10.0])
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], [10.0, 20.0])
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], [-10.0, -20.0])
    with pytest.raises(BadInput, match="has no tendon with a name"):
        field_of(model, "tendon:*.stiffness")


MACHINE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 {gravity}" wind="{wind} 0 0" density="{density}"
    viscosity="{viscosity}"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 1" pos="0 0 -1" friction="{floor} 0.005 0.0001"/>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="{slide}" springref="{springref}"
        stiffness="{stiffness}" armature="{armature}" frictionloss="{frictionloss}"/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="1"/>
      <body name="arm" pos="0 0 0.1">
        <joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom name="link" type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="{mass}"/>
        <body name="bob" pos="{pos} 0 0">
          <inertial pos="{ipos} 0 -0.1" mass="0.2" diaginertia="0.01 0.012 {inertia}"/>
          <joint name="ball" type="ball" damping="{ball}" armature="{rotor}"/>
          <site name="tip"/>
        </body>
      </body>
    </body>
    <body name="stone" pos="1 0.5 -0.9">
      <joint name="free" type="free" damping="{free}"/>
      <geom name="skin" type="sphere" size="0.1" mass="0.5" friction="0.01 0.005 0.0001"
        solref="{solref} 1"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cord" springlength="0.1" damping="{tendon}" stiffness="{cord}"
      frictionloss="{rub}">
      <joint joint="slide" coef="1"/><joint joint="hinge" coef="-1"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="motor" joint="slide" gear="{gear}"/>
    <position name="servo" joint="hinge" kp="{kp}" kv="3"/>
    <velocity name="wheel" joint="hinge" kv="{kv}"/>
    <intvelocity name="integrated" joint="hinge" kp="{ki}" actrange="-1 1"/>
    <damper name="brake" joint="slide" kv="{brake}" ctrlrange="0 1"/>
    <general name="any" joint="slide" gainprm="{any}" biasprm="{bias}" biastype="affine"/>
    <cylinder name="piston" joint="slide" area="{area}" timeconst="0.1"/>
  </actuator>
</mujoco>
"""
WRITTEN = {  # by the field's name: what it is called in MACHINE, before and after
    "option.gravity[2]": ("gravity", -9.81, -3.0),
    "option.wind[0]": ("wind", 1.0, 4.0),
    "option.density": ("density", 1.0, 20.0),
    "option.viscosity": ("viscosity", 0.01, 0.5),
    "geom:floor.friction": ("floor", 0.8, 0.1),
    "geom:skin.solref[0]": ("solref", 0.02, 0.06),
    "joint:slide.damping": ("slide", 0.4, 2.0),
    "joint:slide.springref": ("springref", 0.1, -0.4),
    "joint:slide.stiffness": ("stiffness", 3.0, 20.0),
    "joint:slide.armature": ("armature", 0.1, 1.0),
    "joint:slide.frictionloss": ("frictionloss", 0.1, 1.0),
    "joint:ball.damping": ("ball", 0.02, 0.2),
    "joint:ball.armature": ("rotor", 0.001, 0.02),
    "joint:free.damping": ("free", 0.1, 0.7),
    "body:arm.mass": ("mass", 0.5, 1.0),
    "body:bob.pos[0]": ("pos", 0.3, 0.5),
    "body:bob.ipos[0]": ("ipos", 0.0, 0.1),
    "body:bob.inertia[2]": ("inertia", 0.013, 0.02),
    "tendon:cord.damping": ("tendon", 0.1, 1.0),
    "tendon:cord.stiffness": ("cord", 1.0, 9.0),
    "tendon:cord.frictionloss": ("rub", 0.1, 0.8),
    "actuator:motor.gear": ("gear", 2.0, 5.0),
    "actuator:servo.gain": ("kp", 3.0, 30.0),
    "actuator:wheel.gain": ("kv", 0.5, 2.0),
    "actuator:integrated.gain": ("ki", 2.0, 9.0),
    "actuator:brake.gain": ("brake", 0.3, 3.0),
    "actuator:any.gain": ("any", 1.0, 3.0),
    "actuator:any.bias[0]": ("bias", 0.1, 1.5),
    "actuator:piston.gain": ("area", 1.0, 4.0),
}


def rolled(model):
    """Places after half a second from a bent, moving start under constant commands."""
    data = mujoco.MjData(model)
    data.qpos[1], data.qvel[:] = 0.5, np.linspace(1.0, 2.0, model.nv)
    data.ctrl[:] = 0.7
    mujoco.mj_step(model, data, 250)
    return data.qpos.copy()


def machine(**changed):
    numbers = {word: old for word, old, _ in WRITTEN.values()} | changed
    return mujoco.MjModel.from_xml_string(MACHINE.format(**numbers))


@pytest.mark.parametrize("name", WRITTEN)
def test_a_number_edited_by_name_is_the_same_number_in_the_file(name):
    word, old, new = WRITTEN[name]
    before, by_file = machine(), machine(**{word: new})
    field = field_of(before, name)
    assert field.nominal == pytest.approx(old)
    truth = rolled(by_file)
    assert np.abs(truth - rolled(before)).max() > 1e-3  # it does something
    by_name = edit_native(machine(), [field], [new])
    np.testing.assert_allclose(rolled(by_name), truth, atol=1e-6)
    for array in {edit.array for edit in field.edits}:
        np.testing.assert_allclose(array_at(by_name, array), array_at(by_file, array), atol=1e-9)


def test_each_attribute_of_each_kind_is_walked():
    there = {(form.kind, form.attribute) for form in map(parse, WRITTEN) if form}
    every = {(kind, name) for kind, rows in ATTRIBUTES.items() for name in rows}
    assert every == there
