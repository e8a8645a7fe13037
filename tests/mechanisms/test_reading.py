"""Model files of any kind: what of them becomes a tree, against MuJoCo's own forces, and what is
told.
"""

import mujoco
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.mjcf import mechanism_of, read_mechanism
from adaptsim_jax.mechanisms.spec import read_source, read_spec, shapeless

BODY = '<inertial pos="0.02 0.01 -0.1" mass="{mass}" diaginertia="0.004 0.003 0.002"/>'
GRIPPER = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="trunk" pos="0 0 1">{{free}}<inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
<body name="arm" gravcomp="0.4"><joint name="arm" axis="0 1 0" damping="0.1"/>{BODY.format(mass=1)}
  <body name="left" pos="0 0.03 -0.3"><joint name="left" type="slide" axis="0 1 0" damping="3" armature="0.1" stiffness="5"
    springref="0.01"/>
    {BODY.format(mass=0.2)}</body>
  <body name="right" pos="0 -0.03 -0.3"><joint name="right" type="slide" axis="0 -1 0" damping="2"/>
    {BODY.format(mass=0.2)}<body name="tip" pos="0 0 -0.1"><joint name="tip" axis="1 0 0"/>{BODY.format(mass=0.1)}</body></body>
</body></body></worldbody>
<tendon><fixed name="both"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>
<equality><joint joint1="left" joint2="right" polycoef="0.004 0.8 0 0 0"/></equality>
<actuator><position name="swing" joint="arm" kp="20" kv="1"/><velocity name="brake" joint="arm" kv="2"/>
<position name="grip" tendon="both" kp="60" kv="2" forcerange="-9 9"/></actuator></mujoco>"""  # noqa: E501


def written(path, text):
    path.write_text(text)
    return path


def test_a_gripper_on_a_welded_base_is_folded_and_told(tmp_path):
    made = read_mechanism(
        written(tmp_path / "robot.xml", GRIPPER.format(free='<freejoint name="root"/>'))
    )
    tree = made.tree
    assert tree.joint_names == ("arm", "right", "tip") and tree.all_joints is not None
    np.testing.assert_allclose(tree.damping, [0.1, 2.0 + 0.8**2 * 3.0, 0.0])
    np.testing.assert_allclose(tree.armature[1], 0.8**2 * 0.1)
    np.testing.assert_allclose(
        tree.stiffness[1] * tree.springref[1], 0.8 * 5.0 * (0.01 - 0.004)
    )  # its force at zero
    grip = next(x for x in made.actuators if x.name == "grip")
    np.testing.assert_allclose([grip.gear, grip.offset], [0.5 + 0.5 * 0.8, -60.0 * 0.5 * 0.004])
    np.testing.assert_allclose(tree.all_joints.tree.gravcomp[0, 0], 0.4 * 1.0)


@pytest.mark.slow
def test_a_gripper_on_a_welded_base_has_the_forces_of_mujoco(tmp_path):
    """Mass, bias, springs, gravity compensation, and the moment arm of a tendon over a joint and
    its follower: projected.
    """
    import jax

    from adaptsim_jax.mechanisms import dynamics

    made = read_mechanism(
        written(tmp_path / "robot.xml", GRIPPER.format(free='<freejoint name="root"/>'))
    )
    tree = made.tree
    assert tree.joint_names == ("arm", "right", "tip") and tree.all_joints is not None
    assert any("welded" in note and "root" in note for note in made.notes)
    assert any("left = 0.004 + 0.8 right" in note for note in made.notes)
    model = mujoco.MjModel.from_xml_string(GRIPPER.format(free=""))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data = mujoco.MjData(model)
    way = np.zeros((4, 3))  # of all joints (arm, left, right, tip) by the coordinates
    way[0, 0], way[1, 1], way[2, 1], way[3, 2] = 1.0, 0.8, 1.0, 1.0
    q, v, a = np.random.default_rng(0).normal(size=(3, 3))
    data.qpos[:], data.qvel[:] = way @ q + [0.0, 0.004, 0.0, 0.0], way @ v
    data.ctrl[:] = 0.3, 0.2, 0.05
    mujoco.mj_forward(model, data)
    full = np.zeros((4, 4))
    mujoco.mj_fullM(model, data, full)

    @jax.jit
    def everything(q, v, a):
        mass = dynamics.mass_matrix(tree, tree.inertial, q) + np.diag(tree.armature)
        bias = dynamics.inverse_dynamics(tree, tree.inertial, q, v, None, tree.gravity)
        springs = -tree.damping * v - tree.stiffness * (q - tree.springref)
        passive = springs + dynamics.compensation(tree, q)
        force = (
            dynamics.inverse_dynamics(tree, tree.inertial, q, v, a, tree.gravity)
            + tree.armature * a
        )

        def moved(q):
            return dynamics.acceleration(
                tree, tree.inertial, q, v, force, tree.armature, tree.gravity
            )

        def inverse(q):
            return dynamics.inverse_mass(tree, tree.inertial, q, tree.armature)

        def both(q):
            return (moved(q), inverse(q))

        slopes = jax.vmap(lambda way: jax.jvp(both, (q,), (way,))[1])(np.eye(3))
        steps = jax.vmap(
            lambda h: jax.tree.map(lambda x, y: (x - y) / 2e-6, both(q + h), both(q - h))
        )(1e-6 * np.eye(3))
        return mass, bias, passive, moved(q), slopes, steps

    with jax.enable_x64(True):
        mass, bias, passive, again, slopes, steps = everything(q, v, a)
    for slope, step in zip(slopes, steps, strict=True):
        np.testing.assert_allclose(slope, step, rtol=1e-5, atol=1e-4)  # of differences
    np.testing.assert_allclose(mass, way.T @ full @ way, atol=1e-9)
    np.testing.assert_allclose(bias, way.T @ data.qfrc_bias, atol=1e-9)
    np.testing.assert_allclose(passive, way.T @ data.qfrc_passive, atol=1e-9)
    np.testing.assert_allclose(again, a, atol=1e-9)
    grip = next(x for x in made.actuators if x.name == "grip")
    pull = grip.gear * np.clip(
        grip.gain * 0.05 + grip.offset - grip.kp * grip.gear * q[1] - grip.kv * grip.gear * v[1],
        -9,
        9,
    )
    np.testing.assert_allclose(pull, (way.T @ data.qfrc_actuator)[1], atol=1e-9)


@pytest.mark.slow
def test_derivatives_with_a_follower_are_those_of_differences(tmp_path):
    import jax

    from adaptsim_jax.mechanisms import dynamics

    tree = read_mechanism(written(tmp_path / "robot.xml", GRIPPER.format(free=""))).tree
    q, v, force = np.random.default_rng(1).normal(size=(3, 3))

    @jax.jit
    def both_ways(q):
        def moved(q):
            return dynamics.acceleration(
                tree, tree.inertial, q, v, force, tree.armature, tree.gravity
            )

        def both(q):
            return (moved(q), dynamics.inverse_mass(tree, tree.inertial, q, tree.armature))

        slopes = jax.vmap(lambda way: jax.jvp(both, (q,), (way,))[1])(np.eye(3))
        return slopes, jax.vmap(
            lambda h: jax.tree.map(lambda x, y: (x - y) / 2e-6, both(q + h), both(q - h))
        )(1e-6 * np.eye(3))

    with jax.enable_x64(True):
        slopes, steps = both_ways(q)
    for slope, step in zip(slopes, steps, strict=True):
        np.testing.assert_allclose(slope, step, rtol=1e-5, atol=1e-4)  # of differences


def test_what_no_log_has_is_held_where_the_file_or_a_person_has_it(tmp_path):
    source = read_source(written(tmp_path / "robot.xml", GRIPPER.format(free="")))
    some = mechanism_of(source, {}, ("arm",))
    assert some.tree.joint_names == ("arm",) and set(some.roles.held) == {"left", "right", "tip"}
    assert all(
        any(words in note for note in some.notes)
        for words in ("do nothing: grip", "no log has them")
    )
    still = mechanism_of(source, {"right": 0.02}, ("arm", "right", "tip"), "meta.toml")
    np.testing.assert_allclose(still.roles.held["left"], [0.02])  # 0.004 + 0.8 * 0.02
    with pytest.raises(BadInput, match=r"\[hold\] names 'rihgt'.*did you mean 'right'"):
        mechanism_of(source, {"rihgt": 0.0}, ("arm",), "meta.toml")


def test_a_loop_that_closes_is_told_and_what_is_in_it_held(tmp_path):
    text = GRIPPER.format(free="").replace(
        "<equality>", '<equality><connect body1="tip" body2="arm" anchor="0 0 -0.2"/>'
    )
    made = read_mechanism(written(tmp_path / "robot.xml", text))
    assert made.tree.joint_names == ("arm",) and any("loop" in line for line in made.unsupported)


def test_a_ball_is_three_hinges_in_turn(tmp_path):
    text = (
        '<mujoco><worldbody><body><joint name="hip" '
        f'type="ball"/>{BODY.format(mass=1)}</body></worldbody></mujoco>'
    )
    made = read_mechanism(written(tmp_path / "robot.xml", text))
    assert (
        made.tree.joint_names == ("hip_x", "hip_y", "hip_z")
        and "ball joint 'hip'" in made.unsupported[0]
    )


def test_force_limits_of_joints_bound_what_their_actuators_do(tmp_path):
    text = GRIPPER.format(free="").replace(
        'name="arm" axis', 'name="arm" actuatorfrcrange="-2 3" axis'
    )
    made = read_mechanism(written(tmp_path / "robot.xml", text))
    np.testing.assert_allclose(made.force_limits[0], [-2.0, 3.0])
    assert np.isnan(made.force_limits[1:]).all()


LINK = """<link name="{0}"><inertial><origin xyz="0 0 -0.1"/><mass value="{1}"/>
<inertia ixx="{2}" ixy="0" ixz="0" iyy="{2}" iyz="0" izz="{3}"/></inertial></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="5" velocity="9"/>{4}</joint>"""


def urdf(*parts):
    return f"<robot name='r'><link name='base'/>{''.join(parts)}</robot>"


def test_a_mimic_of_a_urdf_follows(tmp_path):
    text = urdf(
        LINK.format("a", 1, 0.01, 0.01),
        LINK.format("b", 1, 0.01, 0.01),
        JOINT.format("left", "prismatic", "base", "a", ""),
        JOINT.format(
            "right", "prismatic", "base", "b", '<mimic joint="left" multiplier="-1" offset="0.02"/>'
        ),
    )
    made = read_mechanism(written(tmp_path / "robot.urdf", text))
    assert made.tree.joint_names == ("left",)
    assert (
        made.roles.followers["right"].factor == -1.0
        and made.roles.followers["right"].offset == 0.02
    )


def test_links_without_inertia_points_and_a_base_of_any_moments(tmp_path):
    text = urdf(
        LINK.format("stand", 3, 0.1, 5.0),
        JOINT.format("mount", "fixed", "base", "stand", ""),
        '<link name="cross"/>',
        JOINT.format("roll", "revolute", "stand", "cross", ""),
        LINK.format("bob", 0.7, 0, 0),
        JOINT.format("pitch", "revolute", "cross", "bob", ""),
    )
    tree = read_mechanism(written(tmp_path / "robot.urdf", text)).tree
    assert tree.massless == (True, False)
    np.testing.assert_allclose(tree.inertial[1, 0], 0.7)
    np.testing.assert_allclose(np.abs(tree.inertial[1, 4:]).max(), 0.7 * 0.1**2, rtol=1e-9)


@pytest.mark.parametrize(
    ("link", "says"),
    [
        (LINK.format("a", 1, -0.01, 0.01), "link 'a' has negative moments of inertia"),
        ('<link name="a"/>', "no mass for link a"),
        (LINK.format("a", -1, 0.01, 0.01), "link 'a' has a negative mass"),
    ],
)
def test_bad_inertias_are_named(tmp_path, link, says):
    text = urdf(link, JOINT.format("j", "revolute", "base", "a", ""))
    with pytest.raises(BadInput, match=says):
        read_mechanism(written(tmp_path / "robot.urdf", text))


@pytest.mark.parametrize(
    ("link", "more", "says"),
    [
        (LINK.format("a", 1, 0.01, 0.9), "", "balanced as MuJoCo does: a"),
        (
            LINK.format("a", 1, 0.01, 0.01).replace("<mass", '<origin xyz="0 0 -9"/><mass'),
            "",
            "<origin> stands twice in 'a'",
        ),
        (
            LINK.format("a", 1, 0.01, 0.01),
            '<dynamics friction="5"/>',
            "declares friction of 5, as much as its effort limit",
        ),
    ],
)
def test_what_is_odd_but_readable_is_told(tmp_path, link, more, says):
    made = read_mechanism(
        written(
            tmp_path / "robot.urdf", urdf(link, JOINT.format("j", "revolute", "base", "a", more))
        )
    )
    assert any(says in note for note in made.notes)
    assert abs(made.tree.inertial[0, 1:4]).max() == pytest.approx(0.1)  # of the first origin


@pytest.mark.parametrize("value", ["${m}", "$(arg m)", "${2 * m}"])
def test_what_xacro_left_is_named(tmp_path, value):
    link = f'<link name="bob"><inertial><mass value="{value}"/></inertial></link>'
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="bob"/></joint>'
    text = urdf('<link name="a"/>', link, joint)
    with pytest.raises(BadInput, match=r"<mass value='\$.* was left by xacro; expand the file"):
        read_source(written(tmp_path / "robot.urdf", text))


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:3f3f\nsize 67084\n"
DRAWN = """<mujoco><compiler meshdir="assets"/>
<asset><texture name="t" type="2d" file="t.png"/><mesh name="look" file="look.stl"/></asset>
<worldbody><body><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
<geom type="mesh" mesh="look" {light}/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    "light", ['mass="0"', 'density="0"', 'group="4"'], ids=["mass", "density", "group"]
)
@pytest.mark.parametrize("there", [True, False], ids=["pointer", "missing"])
def test_a_mesh_for_looks_alone_is_not_needed(tmp_path, light, there):
    if there:
        (tmp_path / "assets").mkdir()
        (tmp_path / "assets" / "look.stl").write_text(POINTER)
    text = DRAWN.format(light=light).replace("<compiler ", '<compiler inertiagrouprange="0 3" ')
    model = read_source(written(tmp_path / "robot.xml", text)).model
    assert model.body_mass[1] == pytest.approx(0.5)
    assert shapeless("robot.xml", read_spec(tmp_path / "robot.xml")[0]).nmesh == 0


def test_a_mesh_that_weighs_and_is_a_pointer_of_git_lfs_is_named(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "look.stl").write_text(POINTER)
    with pytest.raises(BadInput, match=r"look\.stl is a pointer of Git LFS, no mesh; fetch it by"):
        read_source(written(tmp_path / "robot.xml", DRAWN.format(light="")))


def test_a_mended_file_keeps_what_is_behind_a_joint_that_is_held(tmp_path):
    from adaptsim_jax.mend.mjcf import Changes, mended_mjcf

    path = written(tmp_path / "robot.xml", GRIPPER.format(free='<freejoint name="root"/>'))
    made = mechanism_of(read_source(path), {}, ("arm",))
    heavier = np.array(made.tree.inertial) * 1.2
    model = mujoco.MjModel.from_xml_string(
        mended_mjcf(made, Changes(heavier, {"damping": {"arm": 0.3}}))
    )
    assert model.nv == 10 and model.body("left").mass[0] == 0.2
    again = mechanism_of(
        read_source(written(tmp_path / "model.xml", mended_mjcf(made, Changes(heavier)))),
        {},
        ("arm",),
    )
    np.testing.assert_allclose(
        again.tree.inertial, heavier, rtol=1e-4, atol=1e-6
    )  # the file has six digits


def test_what_a_follower_and_a_tendon_add_stays_with_them(tmp_path):
    from adaptsim_jax.mend.mjcf import Changes, mended_mjcf

    made = read_mechanism(written(tmp_path / "robot.xml", GRIPPER.format(free="")))
    damping = dict(zip(made.tree.joint_names, 2.0 * made.tree.damping, strict=True))
    again = read_mechanism(
        written(tmp_path / "model.xml", mended_mjcf(made, Changes(joints={"damping": damping})))
    )
    np.testing.assert_allclose(again.tree.damping, 2.0 * made.tree.damping, rtol=1e-5)
