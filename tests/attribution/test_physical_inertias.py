"""What a report tells of inertias, beside MuJoCo's and the dynamics' own numbers."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.physical_inertias import OF_BODY, _body, _carried, otherwise
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1" euler="0.3 0 0">
<joint name="shoulder" axis="0 1 0"/><inertial pos="0.02 0.01 -0.2" mass="1.5" fullinertia="0.02 0.025 0.008 0.001 0.002 -0.001"/>
<body name="lower" pos="0.03 0 -0.4" euler="0 0.4 0.2"><joint name="elbow" axis="1 0 0"/>
<inertial pos="0 0.01 -0.15" mass="0.7" diaginertia="0.006 0.006 0.001"/>
<body name="tip" pos="0 0 -0.3"><joint name="rail" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body></body></body></worldbody></mujoco>"""  # noqa: E501


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(XML)
    mechanism = read_mechanism(path)
    return SimpleNamespace(mechanism=mechanism, tree=mechanism.tree)


@pytest.fixture(scope="module")
def found(machine):
    """Declared inertias as the one fit, with themselves as the coordinates."""
    n = machine.tree.n
    eye = np.eye(10 * n).reshape(n, 10, 10 * n)
    return {j: (np.asarray(machine.tree.inertial)[j][None], eye[j]) for j in range(n)}


def test_what_a_joint_carries_is_the_mass_matrix_of_mujoco(machine, found):
    model = mujoco.MjModel.from_xml_string(XML)
    data, full = mujoco.MjData(model), np.zeros((3, 3))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    carried = [_carried(machine, found, j)[0] for j in range(3)]
    assert [q.name for q in carried] == [
        "inertia about shoulder",
        "inertia about elbow",
        "mass on rail",
    ]
    np.testing.assert_allclose([q.values[0] for q in carried], np.diagonal(full), rtol=1e-9)


def test_first_moments_are_linear_in_the_parameters(machine, found):
    x, z = _carried(machine, found, 0)[1:]
    assert [x.name, z.name] == ["first moment x at shoulder", "first moment z at shoulder"]
    together = np.concatenate([found[j][0][0] for j in range(3)])
    for q in (x, z):
        assert q.unit == "kg m" and q.slope @ together == pytest.approx(q.values[0])


def test_bodies_are_told_in_the_axes_of_their_file(machine, found):
    rows = {q.name.removesuffix(" of upper"): q for q in _body(machine, *found[0], 0)}
    assert tuple(rows) == OF_BODY
    want = (1.5, 0.02, 0.01, -0.2, 0.02, 0.025, 0.008, 0.001, 0.002, -0.001)
    np.testing.assert_allclose([rows[name].values[0] for name in OF_BODY], want, rtol=1e-6)
    slope = rows["centre of mass x"].slope[:4]  # by m, m cx, m cy, m cz in the joint's axes
    assert slope[0] == pytest.approx(-0.02 / 1.5, rel=1e-4)
    assert np.linalg.norm(slope[1:]) == pytest.approx(1 / 1.5, rel=1e-4)


def test_what_is_said_to_be_unlike_the_model_file():
    def row(value, width, fixed=True):
        rest = {"unit": "kg m^2", "identifiable": fixed, "combination": True, "file": 0.1}
        return {"value": value, "low": value - width, "high": value + width} | rest

    rows = {
        "heavier": row(0.2, 0.01),
        "alike": row(0.102, 0.001),
        "wide": row(0.2, 0.2),
        "loose": row(0.9, 0.1, False),
    }
    assert otherwise(rows) == [
        "Unlike the model file, by these data: heavier 0.2 kg m^2 (file 0.1)."
    ]
    assert otherwise({"alike": rows["alike"]}) == []
    nothing = row(2e-4, 1e-5) | {
        "file": 0.0
    }  # beside a moment of 0.1, whether the data fix that or not
    assert otherwise({"nothing": nothing, "loose": rows["loose"]}) == []


def test_a_damping_that_the_file_gives_is_said_to_be_another():
    row = {"value": 0.25, "low": 0.24, "high": 0.26, "unit": "N m s/rad", "identifiable": True}
    rows = {"damping of hip": row | {"file": 0.75}, "damping of knee": row | {"file": 0.0}}
    assert otherwise(rows) == [
        "Unlike the model file, by these data: damping of hip 0.25 N m s/rad (file 0.75)."
    ]
