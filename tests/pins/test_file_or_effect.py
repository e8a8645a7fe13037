"""A number in the model file, the same number as an effect, and the same in `model.toml` leave the
same residuals.
"""

from dataclasses import replace
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.equation.rubbing import giving
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.mend import changes
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.paths import ready, run, starts_of
from adaptsim_jax.attribution.simulate import simulate
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mend.mjcf import mended_mjcf

OPTION = '<compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>'
BODIES = """<worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.3" frictionloss="0.1"
armature="0.02"/><inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.01"/>
<body pos="0 0 -0.4"><joint name="b" axis="0 1 0" damping="0.1" frictionloss="0.05" {ends}/>
<inertial pos="0.01 0 -0.15" mass="0.5" diaginertia="0.005 0.005 0.001"/>{last}</body></body></worldbody>"""  # noqa: E501
FOLLOWER = """<body pos="0 0 -0.3"><joint name="c" axis="0 1 0" damping="0.02" armature="0.002"/>
<inertial pos="0 0 -0.05" mass="0.2" diaginertia="1e-3 1e-3 1e-4"/></body>"""
TIE = '<equality><joint joint1="c" joint2="b" polycoef="0 1 0 0 0"/></equality>'
MOTORS = '<motor name="ma" joint="a"/><motor name="mb" joint="b"/>'
SERVOS = """<position name="ma" joint="a" kp="30" kv="2"/>
<position name="mb" joint="b" kp="12" kv="0.6"/>"""
ENDS = 'limited="true" range="-0.5 0.4"'
KINDS = {
    "free": ("", "", "", MOTORS),
    "end": (ENDS, "", "", MOTORS),
    "follower": (ENDS, FOLLOWER, TIE, MOTORS),
    "servo": (ENDS, "", "", SERVOS),
}
NAMES = ("viscous", "coulomb", "armature", "spring", "torque_gain", "position_gain", "saturation")
EFFECTS = tuple(e for e in MACHINE if e.name in NAMES)
NUMBERS = {
    "damping": {("viscous", "damping", 1): 0.25},
    "friction": {("coulomb", "level", 0): 0.4, ("coulomb", "level", 1): 0.15},
    "rotor": {("armature", "inertia", 0): 0.3, ("armature", "inertia", 1): 0.05},
    "spring": {("spring", "stiffness", 1): 0.8, ("spring", "preload", 1): 0.1},
    "gain": {("torque_gain", "gain", 0): 0.2},
    "limit": {("saturation", "cut", 0): 0.3, ("saturation", "peak", 0): 4.0},
    "body": {("inertia", "size", 1): 0.15, ("inertia", "shift_x", 0): 0.2},
}


def text(kind, step=0.001):
    ends, last, tie, motors = KINDS[kind]
    bodies = BODIES.format(ends=ends, last=last)
    return f"<mujoco>{OPTION.format(step=step)}{bodies}{tie}<actuator>{motors}</actuator></mujoco>"


def logged(folder, kind, rows=120, step=0.001):
    """A folder with the model and two trials at 200 Hz, simulated by MuJoCo at a small step."""
    folder.mkdir(exist_ok=True)
    (folder / "model.xml").write_text(text(kind))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model = mujoco.MjModel.from_xml_string(text(kind, step))
    size = np.array([0.5, 0.7]) if kind == "servo" else np.array([3.0, 1.0])
    for trial in range(2):
        data, out = mujoco.MjData(model), []
        for k in range(rows):
            u = size * np.sin((4.0 + trial) * k / 200.0 + np.array([0.0, 1.0 + trial]))
            out.append([k / 200.0, *data.qpos[:2], *data.qvel[:2], *u])
            data.ctrl[:] = u
            for _ in range(round(0.005 / step)):
                mujoco.mj_step(model, data)
        names = "time,q_a,q_b,v_a,v_b,ctrl_a,ctrl_b"
        np.savetxt(folder / f"t{trial}.csv", out, delimiter=",", header=names, comments="")
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    base = tmp_path_factory.mktemp("file_or_effect")
    return {kind: logged(base / kind, kind) for kind in KINDS}


def problem_of(machine, gives, horizon=0.25):
    made = machine.problem(EFFECTS, horizon, 100)
    return giving(made, machine.tree) if gives else made


def vector_of(numbers):
    entries = [
        Entry(owner, name, (j,), value, 0.0, -10.0, 10.0, "1")
        for (owner, name, j), value in numbers.items()
    ]
    return Vector(tuple(entries), np.array([e.start for e in entries]))


NONE = Vector((), np.zeros(0))


def simulated(problem, vector=NONE):
    return run(problem, vector, starts_of(problem))[0].x


@pytest.mark.parametrize(
    "kind, gives", [("free", False), ("end", True), ("follower", True), ("servo", False)]
)
def test_a_number_does_the_same_wherever_it_stands(folders, tmp_path, kind, gives):
    machine = load(folders[kind], None)
    problem = problem_of(machine, gives)
    declared = simulated(problem)
    for name, numbers in NUMBERS.items():
        if kind == "servo" and name == "gain":
            numbers = {("position_gain", "gain", 0): 0.2}
        vector = vector_of(numbers)
        one = simulated(problem, vector)
        assert np.abs(one - declared).max() > 1e-3, name  # the number matters
        model = SimpleNamespace(fit=SimpleNamespace(vector=vector), added=())
        path = tmp_path / f"{name}.xml"
        path.write_text(mended_mjcf(machine.mechanism, changes(machine, problem, model, model)))
        other = simulated(problem_of(load(folders[kind], path), gives))
        digits = 1e-5 if name == "body" else 1e-9  # MuJoCo writes a pose with few of them
        np.testing.assert_allclose(other, one, 0, digits, err_msg=f"{name} in model.xml")
        declared_file = tmp_path / model_toml.DECLARED
        declared_file.write_text((folders[kind] / "model.xml").read_text())
        toml = tmp_path / f"{name}.toml"
        toml.write_text(model_toml.text_of(problem, model, {}))
        third = simulated(problem_of(load(folders[kind], toml), gives))
        np.testing.assert_allclose(third, one, 0, 1e-9, err_msg=f"{name} in model.toml")


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_tree_does_what_mujoco_does(folders, kind):
    """To 1 mrad of a quarter of a second: what steps of 0.1 ms leave of blows against an end, which are of
    first order there.
    """  # noqa: E501
    machine = load(folders[kind], None)
    (group, _, values, how), *_ = ready(problem_of(machine, True), NONE)
    s = group.stretches
    with jax.enable_x64(True):
        fine = replace(how, substeps=8 * how.substeps)
        path = simulate(group.model, values, s.time, s.stamp, s.command, s.start, fine).x
    model = mujoco.MjModel.from_xml_string(text(kind, 1e-4))
    for w in range(2):
        data = mujoco.MjData(model)
        places = [0, 1, 1][: model.nq]
        data.qpos[:], data.qvel[:] = s.start[places, w], s.start[2:][places, w]
        for k in range(s.rows):
            np.testing.assert_allclose(path[k, :2, w], data.qpos[:2], atol=1e-3)
            data.ctrl[:] = s.command[s.past + k, :, w]
            mujoco.mj_step(model, data, 50)
