"""A motion to record next: within limits to its last row, better than most, and its table foretells
what a search along it names.
"""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.draws import basis, drawn
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.models import search_balances
from adaptsim_jax.attribution.excitation import Search, excited, read_after
from adaptsim_jax.attribution.machine import machine
from adaptsim_jax.attribution.posed import declared_vector, posed
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.cli import main
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.mechanisms.allowed import allowed
from tests.generators.mechanism_machines import draw_machine
from tests.generators.mechanism_mjcf import to_xml

ROBOTS = Path(__file__).parents[2].parent / "shared/data/robots"
ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 0.1">
<joint name="shoulder" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0.1 0 0 0.3" size="0.04" mass="2"/>
<body name="fore" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-3 3"/>
<geom type="capsule" fromto="0 0 0.1 0 0 0.25" size="0.03" mass="1"/><body name="hand" pos="0 0 0.3">
<joint name="wrist" axis="0 1 0"/><geom type="sphere" size="0.05" pos="0 0 0.1" mass="0.4"/></body></body></body></worldbody>
<actuator><motor joint="shoulder" ctrlrange="-30 30"/><motor joint="elbow" gear="2" ctrlrange="-6 6"/>
<motor joint="wrist" forcerange="-2 2"/></actuator></mujoco>"""  # noqa: E501


def written(folder: Path, kind: str) -> Path:
    """A model file of a generator's machine, or of the arm above."""
    path, text = folder / f"{kind}.xml", ARM
    if kind != "arm":
        text = to_xml(draw_machine(np.random.default_rng(3), kind), "torque", np.zeros((9, 2)))
    path.write_text(text)
    return path


def check(path: Path, seconds: float = 12.0) -> None:
    """Every row of some draws at the rate that is written: MuJoCo by itself says that it holds."""
    may = allowed(path)
    coarse, fine = basis(seconds, 25.0), basis(seconds, 100.0)
    rng = np.random.default_rng(1)
    genes = [g for g in (drawn(rng, coarse, may) for _ in range(4)) if g is not None]
    assert genes
    names = may.mechanism.tree.joint_names
    model = mujoco.MjModel.from_xml_path(str(path)) if path.parent != ROBOTS else may.bodies.model
    for g in genes:
        q, v, a = fine.motion(may.home, g)
        assert np.all(q >= may.low - 1e-9) and np.all(q <= may.high + 1e-9)
        assert np.all(np.abs(v) <= may.speed)
        assert q[0] == pytest.approx(may.home) and q[-1] == pytest.approx(may.home)
        assert v[[0, -1]] == pytest.approx(0.0) and a[[0, -1]] == pytest.approx(0.0)
        assert np.gradient(q, fine.time, axis=0)[1:-1] == pytest.approx(v[1:-1], abs=0.02)
        data = mujoco.MjData(model)
        where = [model.joint(n) for n in names]
        for k in range(len(q)):
            data.qpos[:] = may.bodies.pose
            for j, joint in enumerate(where):
                data.qpos[joint.qposadr], data.qvel[joint.dofadr] = q[k, j], v[k, j]
                data.qacc[joint.dofadr] = a[k, j]
            mujoco.mj_inverse(model, data)
            own = np.array([data.qfrc_inverse[joint.dofadr[0]] for joint in where])
            if len(may.bodies.coordinates) == len(names):
                assert np.all(np.abs(own) <= may.torque)
        assert may.bodies.touching(q) is None


@pytest.mark.parametrize("kind", ["arm", "arm6"])
def test_limits_hold_to_the_last_row(tmp_path, kind):
    check(written(tmp_path, kind))


@pytest.mark.parametrize("name", ["ufactory_lite6__lite6", "universal_robots_ur5e__ur5e"])
def test_limits_hold_for_robots_that_people_have(name):
    if not (path := ROBOTS / f"{name}.xml").exists():
        pytest.skip("no robots' files here")
    check(path)


def test_limits_are_those_of_the_file(tmp_path):
    may = allowed(written(tmp_path, "arm"))
    assert may.torque == pytest.approx(0.7 * np.array([30.0, 12.0, 2.0]))
    assert may.low[:2] == pytest.approx([-1.8, -2.7]) and may.high[2] == pytest.approx(1.5)
    notes = " ".join(may.notes)
    assert "range of wrist" in notes and "speed limit of shoulder" in notes and "floor" in notes


URDF = """<robot name="a"><link name="base"/><link name="swing"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hinge" type="revolute">
<parent link="base"/><child link="swing"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="12" velocity="3"/></joint></robot>"""  # noqa: E501


def test_a_urdf_has_limits_of_speed_and_torque(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(URDF)
    may = allowed(path)
    assert may.speed == pytest.approx(0.7 * 3.0) and may.torque == pytest.approx(0.7 * 12.0)
    assert may.high == pytest.approx(0.9) and "limit" not in " ".join(may.notes)


def test_bodies_that_would_touch_are_seen(tmp_path):
    may = allowed(written(tmp_path, "arm"))
    folded = np.linspace([0.0, 0.0, 0.0], [0.0, 3.0, 1.2], 50)
    row, one, other = may.bodies.touching(folded)
    assert {one, other} == {"upper", "hand"} and 30 < row < 50
    assert may.bodies.touching(folded[:20]) is None


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    may = allowed(written(tmp_path_factory.mktemp("arm"), "arm"))
    return may, excited(may, Search(seconds=12.0, draws=7, seed=23))


def test_the_best_draw_is_better_than_the_median(found):
    _, motion = found
    assert motion.loss < np.median(motion.losses)
    assert np.isfinite(motion.losses).all()


def named(may, motion, torque, seed) -> set[tuple[str, str]]:
    """What a search along the motion names, of a recording with these torques and noise."""
    rng = np.random.default_rng(seed)
    names = may.mechanism.tree.joint_names
    q = motion.q + 1e-4 * rng.normal(size=motion.q.shape)
    u = torque + 5e-3 * np.abs(motion.torque).max(0) * rng.normal(size=motion.q.shape)
    trial = LogTrial("one", motion.time, q, None, u)
    path = may.mechanism.path
    made = machine(may.mechanism, Log(path, LogMeta(), names, (trial,), "torque", names, names))
    problem = posed(made, MACHINE, 0.5)
    null = declared_vector(made, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    search = search_balances(
        problem, balances(problem, made.tracks), null, reach, Criteria(), False
    )
    return {(n.candidate.effect, names[n.candidate.joints[0]]) for n in search.named}


@pytest.mark.parametrize(
    ("effect", "joint"), [("coulomb", "elbow"), ("armature", "shoulder"), ("torque_gain", "wrist")]
)
def test_the_table_foretells_what_is_named(found, effect, joint):
    may, motion = found
    j = may.mechanism.tree.joint_names.index(joint)
    row = next(r for r in motion.rows if (r["name"], r["where"]) == (effect, joint))
    way = {
        "coulomb": np.tanh(motion.v[:, j] / 1e-3),
        "armature": motion.a[:, j],
        "torque_gain": -motion.torque[:, j],  # a weak drive is told more
    }[effect]
    for times, there in ((2.0, True), (0.3, False)):
        torque = motion.torque.copy()
        torque[:, j] += times * row["alone"] * way
        assert ((effect, joint) in named(may, motion, torque, 8)) is there


def test_the_command_writes_a_motion(tmp_path, capsys):
    model, out = written(tmp_path, "arm"), tmp_path / "next"
    words = ["excite", str(model), "--out", str(out), "--draws", "2", "--seconds", "6"]
    assert main([*words, "--rate", "50", "--speed", "0.5"]) == 0
    shown = capsys.readouterr().out
    assert "named from" in shown and "floor at z = 0" in shown
    rows = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    trajectory = json.loads((out / "trajectory.json").read_text())
    points = trajectory["points"]
    assert len(rows) == len(points) == 301 and trajectory["joint_names"][0] == "shoulder"
    assert points[75]["time_from_start"] == {"sec": 1, "nanosec": 500000000}
    assert points[75]["positions"][1] == pytest.approx(rows["q_elbow"][75], abs=1e-6)
    assert np.abs(rows["v_elbow"]).max() <= 1.0
    assert {"name", "where", "unit", "size", "alone", "rival", "power"} == set(
        json.loads((out / "shown.json").read_text())["shown"][0]
    )
    assert (out / "motion.png").stat().st_size > 10_000


def test_after_a_diagnosis_its_model_and_noise_count(tmp_path, capsys):
    model, out = written(tmp_path, "arm"), tmp_path / "out"
    out.mkdir()
    head = 'schema = 2\ntask = "mechanism"\nmodel = "declared.xml"\n[[effects]]\nname = "coulomb"\n'
    level = 'where = "elbow"\nparameters.level = {value = 0.3, unit = "N m"}\n'
    (out / "model.toml").write_text(head + level)
    channels = {"elbow": {"unit": "N m", "before": 0.9, "after": 0.5}}
    power = [{"name": "spring", "where": "elbow", "size": 0.25}]
    (out / "report.json").write_text(
        json.dumps({"error": {"per_channel": channels}, "power": power})
    )
    words = ["excite", str(model), "--after", str(out), "--out", str(tmp_path / "next")]
    assert main([*words, "--draws", "1", "--seconds", "6"]) == 0
    assert "so far" in capsys.readouterr().out
    rows = json.loads((tmp_path / "next" / "shown.json").read_text())["shown"]
    spring = next(r for r in rows if (r["name"], r["where"]) == ("spring", "elbow"))
    assert spring["so_far"] == 0.25
    after = read_after(out)
    assert after.left == {"elbow": 0.5} and after.table["effects"][0]["name"] == "coulomb"


FREE = ARM.replace(
    '<body name="upper" pos="0 0 0.1">', '<body name="upper"><freejoint name="root"/>'
)


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        (FREE.replace('<joint name="shoulder" axis="0 1 0" range="-2 2"/>', ""), [], "hang it up"),
        (ARM, ["--speed", "2"], "--speed"),
        (ARM, ["--seconds", "1"], "--seconds"),
        (ARM, ["--rate", "5"], "--rate"),
        (ARM, ["--after", "nowhere"], "model.toml"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(tmp_path, capsys, text, words, said):
    model = tmp_path / "model.xml"
    text = (
        text.replace('<motor joint="shoulder" ctrlrange="-30 30"/>', "") if "root" in text else text
    )
    model.write_text(text)
    assert main(["excite", str(model), "--out", str(tmp_path / "out"), *words]) == 2
    line = capsys.readouterr().err.strip()
    assert said in line and "\n" not in line
