"""MuJoCo itself over recordings that it made: bases that move, contact, loops; and numbers of a
model fitted by it.
"""

import json
import shutil

import mujoco
import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.build import make_stepped_model
from adaptsim_jax.simulators.mujoco.fields import model_number, with_values
from adaptsim_jax.simulators.mujoco.fit import fit
from adaptsim_jax.simulators.mujoco.replay import replayed
from adaptsim_jax.simulators.mujoco.touching import touching
from tests.simulators.robots import quadruped, record, walk

LOOP = """<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="crank" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.2"/><body name="b" pos="0 0 -0.1"><joint name="rod" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.3"/></body></body>
<body name="c" pos="0.3 0 0"><joint name="rocker" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.2"/></body></worldbody>
<equality><connect body1="b" body2="c" anchor="0.3 0 0"/></equality>
<contact><exclude body1="a" body2="b"/><exclude body1="b" body2="c"/></contact>
<actuator><general name="drive" joint="crank" dyntype="filter" dynprm="0.05" gainprm="2"/></actuator></mujoco>"""  # noqa: E501


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    return record(tmp_path_factory.mktemp("walk") / "log", quadruped(), told=walk, base=True)


def test_a_quadruped_that_walks_is_replayed_as_it_was_made(walked):
    source, log = read_source_and_log(walked)
    found = replayed(source, log, 0.3)
    assert (
        found.stepped_model.base == 0
        and np.median(found.error) < 1e-6
        and np.median(found.base) < 1e-6
    )
    assert "touch in" in touching(found.stepped_model, log)


def test_a_trial_without_the_base_that_others_have_is_refused_and_the_mend_works(walked, tmp_path):
    data = tmp_path / "log"
    shutil.copytree(walked, data)
    names, rows = (
        (data / "run_1.csv").read_text().splitlines()[0],
        np.loadtxt(data / "run_1.csv", delimiter=",", skiprows=1),
    )
    header = ",".join(names.split(",")[:-7])
    np.savetxt(
        data / "run_1.csv", rows[:, :-7], delimiter=",", header=header, comments="", fmt="%.12g"
    )
    with pytest.raises(BadInput, match=r"trial run_1 has no base_x.*exclude = ..run_1") as error:
        make_stepped_model(*read_source_and_log(data))
    mend = str(error.value)[str(error.value).index("exclude") :]
    (data / "meta.toml").write_text(f'task = "mechanism"\nmodel = "model.xml"\n[trials]\n{mend}\n')
    assert make_stepped_model(*read_source_and_log(data)).base == 0


def test_the_command_takes_mujoco_where_the_base_moves(walked, capsys):
    assert (
        cli.main(["replay", str(walked / "model.xml"), str(walked), "--horizon", "0.3", "--json"])
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told["median"] < 1e-6 and any("its base moves" in note for note in told["notes"])


@pytest.mark.slow
def test_the_friction_of_all_feet_is_found(tmp_path):
    truth = quadruped().replace('friction="0.5 0.01 0.001"', 'friction="0.3 0.01 0.001"')
    data = record(tmp_path / "log", quadruped(), truth=truth, told=walk, base=True)
    found = fit(*read_source_and_log(data), ("geom:*_foot.friction[0]",), 0.2)
    assert found.fields[0].default == 0.5 and len(found.fields[0].elements) == 4
    assert found.value[0] == pytest.approx(0.3, rel=0.05) and found.after < found.before


ARM = """<mujoco><compiler angle="radian"/><option timestep="0.004"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/><body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"
damping="{damping}" frictionloss="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="{mass}"/></body></body>
</worldbody><contact><exclude body1="upper" body2="lower"/></contact>
<actuator><position name="lift" joint="shoulder" kp="{kp}" kv="2"/><position name="bend"
joint="elbow" kp="20" kv="0.5"/></actuator></mujoco>"""  # noqa: E501


def swing(t: float, trial: int) -> np.ndarray:
    return np.array([0.6 * np.sin(5 * t + trial), 0.8 * np.sin(7 * t + 2 * trial)])


def test_mass_damping_and_a_servos_gain_are_found(tmp_path):
    data = record(
        tmp_path / "log",
        ARM.format(damping=0.1, mass=0.5, kp=30),
        truth=ARM.format(damping=0.2, mass=0.6, kp=36),
        told=swing,
        every=2,
    )
    found = fit(
        *read_source_and_log(data),
        ("joint:elbow.damping", "body:lower.mass", "actuator:lift.kp"),
        0.3,
    )
    np.testing.assert_allclose(
        found.value, [0.2, 0.6, 36.0], rtol=1e-3
    )  # the log is MuJoCo's own, to 12 digits
    assert (
        found.code == "converged"
        and np.all(found.low <= found.value)
        and np.all(found.value <= found.high)
    )


def test_a_late_command_is_found_and_printed(tmp_path, capsys):
    text = ARM.format(damping=0.1, mass=0.5, kp=30)
    data = record(tmp_path / "log", text, told=swing, every=2)
    for path in data.glob("*.csv"):  # what was logged came 8 ms (one row) before it acted
        rows, head = np.loadtxt(path, delimiter=",", skiprows=1), path.read_text().split("\n")[0]
        rows[:-1, 3:] = rows[1:, 3:]
        np.savetxt(path, rows[:-1], delimiter=",", header=head, comments="", fmt="%.12g")
    out = ["--horizon", "0.3", "--fit", "command.delay", "--json", "--out", str(tmp_path / "out")]
    assert cli.main(["replay", str(data / "model.xml"), str(data), *out]) == 0
    told = json.loads(capsys.readouterr().out)["fitted"]["command.delay"]
    assert (
        told["value"] == pytest.approx(0.008, abs=2e-4)
        and (tmp_path / "out" / "fitted.json").exists()
    )


def test_a_loop_and_an_actuator_with_a_memory_of_which_one_joint_is_logged(tmp_path):
    def swing(t, trial):
        return np.array([0.1 * np.sin(6 * t + trial)])

    data = record(tmp_path / "log", LOOP, told=swing)
    for path in data.glob("*.csv"):
        rows, head = (
            np.loadtxt(path, delimiter=",", skiprows=1),
            path.read_text().split("\n")[0].split(","),
        )
        keep = [head.index(n) for n in ("time", "q_crank", "ctrl_drive")]
        np.savetxt(
            path,
            rows[:, keep],
            delimiter=",",
            header=",".join(head[k] for k in keep),
            comments="",
            fmt="%.12g",
        )
    found = replayed(*read_source_and_log(data), 0.3)
    assert np.median(found.error) < 1e-5


def test_a_mass_takes_its_moments_along_and_derived_numbers_are_made_anew(walked):
    made = make_stepped_model(*read_source_and_log(walked))
    mass = model_number(made.model, "body:trunk.mass")
    other = with_values(made.model, [mass], [8.0])
    k = made.model.body("trunk").id
    np.testing.assert_allclose(other.body_inertia[k], 2.0 * made.model.body_inertia[k])
    assert other.dof_invweight0[0] < made.model.dof_invweight0[0] and made.model.body_mass[k] == 4.0


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("joint:fl_hipp.damping", "no joint 'fl_hipp'; did you mean 'fl_hip'"),
        ("joint:fl_hip.dampign", "a joint has no 'dampign'; did you mean 'damping'"),
        ("limb:fl.mass", "quantity 'limb:fl.mass'"),
        ("geom:fl_foot.friction[7]", "friction has 3 numbers"),
        ("mass of the trunk", "write KIND:ELEMENT.FIELD"),
    ],
)
def test_names_that_are_none_are_refused(walked, name, says):
    made = make_stepped_model(*read_source_and_log(walked))
    with pytest.raises(BadInput) as error:
        model_number(made.model, name)
    assert says in str(error.value)


@pytest.mark.parametrize("name", ["ground.tilt_x", "ground.tilt_y", "ground.height"])
def test_ground_that_is_moved_is_where_it_was_moved_to(name):
    """A geom that lies in its body's frame is taken to lie there still, unless the model is told
    anew.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    moved = with_values(model, [model_number(model, name)], [0.1])
    data = mujoco.MjData(moved)
    mujoco.mj_forward(moved, data)
    up, height = data.geom_xmat[0].reshape(3, 3)[:, 2], data.geom_xpos[0, 2]
    want = {
        "ground.tilt_x": [0, -np.sin(0.1), np.cos(0.1)],
        "ground.tilt_y": [np.sin(0.1), 0, np.cos(0.1)],
    }
    assert up == pytest.approx(want.get(name, [0, 0, 1]), abs=1e-9)
    assert height == pytest.approx(0.1 if name == "ground.height" else 0.0)


@pytest.mark.parametrize("flag", ["equality", "constraint"])
def test_joints_are_held_where_the_file_disables_its_equalities(tmp_path, flag):
    """The file's own equalities stay off, and what holds a joint that no log has acts."""
    off = f'<option><flag {flag}="disable"/></option><worldbody>'
    (tmp_path / "robot.xml").write_text(LOOP.replace("<worldbody>", off, 1))
    (tmp_path / "meta.toml").write_text(
        'task = "mechanism"\nmodel = "robot.xml"\ninput = "none"\n[hold]\nrod = 0.0\n'
    )
    time = np.arange(40) * 0.01
    rows = zip(time, np.cos(5 * time), np.sin(5 * time), strict=True)
    lines = ["time,q_crank,q_rocker", *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    model = make_stepped_model(*read_source_and_log(tmp_path)).model
    data = mujoco.MjData(model)
    data.qpos[model.joint("crank").qposadr[0]] = 1.0
    mujoco.mj_step(model, data, 100)
    assert abs(data.qpos[model.joint("rod").qposadr[0]]) < 1e-3
    held = [model.equality(int(k)).name for k in data.efc_id[: data.ne]]
    assert held == ["hold_rod"]
