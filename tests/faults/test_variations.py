"""Variations of what users report, two of each kind: inputs made before the code that meets them
was looked at.
"""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.policies import check_fields, everywhere, shaken
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.logs.read import names_of, read_log
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from tests.environments.test_own import changed
from tests.environments.test_task import SMALL
from tests.faults.servo_files import log, noisy, sines, swung
from tests.faults.test_clocks_told import recorded
from tests.logs.arm_files import arm
from tests.logs.log_files import HEAD, folder, motion, named
from tests.logs.test_bags import ARM, Bag, ns
from tests.logs.test_lerobot import data_set

M = motion(2, rows=200)


# 1: a number reaches what its name says


def test_targets_in_degrees_of_a_general_servo_with_a_gear(tmp_path):
    servos = "".join(
        f'<general name="p_{j}" joint="{j}" gear="{g}" gainprm="7" biastype="affine" '
        f'biasprm="0 -7 -0.4"/>'
        for j, g in zip(ARM, (12, -3), strict=True)
    )
    bodies = "".join(f'<body><joint name="{j}"/><geom size="0.1" mass="1"/></body>' for j in ARM)
    model = tmp_path / "robot.xml"
    model.write_text(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>"
    )
    columns = named(M | {"target": np.degrees(M["q"][::-1])}, ARM, "q", "target")
    data = folder(tmp_path / "a", '[units]\ntarget = "deg"\n', t=columns)
    read = read_log(data, names_of(str(model))[1])
    np.testing.assert_allclose(read.trials[0].u, M["q"][::-1] * [12, -3], rtol=1e-9)


FOOT = """<mujoco><worldbody><geom name="floor" type="plane" size="3 3 1" {floor}/>
<body name="cart" pos="0 0 0.1"><joint name="slide" type="slide" axis="1 0 0"/>
<geom name="foot" type="sphere" size="0.1" mass="1" friction="0.6 0.005 0.0001"/></body></worldbody>
<actuator><motor name="motor" joint="slide" ctrlrange="-1 1"/></actuator>
</mujoco>"""


def test_friction_of_a_foot_on_a_floor_that_has_priority_is_told():
    from adaptsim_jax.environments.own import ModelEnvironment

    env = ModelEnvironment(
        FOOT.format(floor='priority="1" friction="0.8 0.005 0.0001"'),
        lambda data: data.qpos,
        lambda data, action: data.qpos[0],
        control_dt=0.04,
        fields={"geom:foot.friction": (0.3, 1.2)},
    )
    setting = setting_of(env, EnvironmentConfig())
    with pytest.raises(BadInput, match=r"nothing that is seen follows from 'geom:foot\.friction'"):
        check_fields(setting.space, shaken(setting))


# 2: what a model file switches off


def test_a_group_from_a_default_and_an_option_of_an_included_file(tmp_path):
    (tmp_path / "option.xml").write_text(
        '<mujoco><option actuatorgroupdisable="3"/><default><default class="brake">'
        '<velocity group="3" kv="4"/></default></default></mujoco>'
    )
    (tmp_path / "robot.xml").write_text(
        '<mujoco><include file="option.xml"/><worldbody><body><joint name="a" axis="0 1 0"/>'
        '<geom size="0.1" mass="1"/></body></worldbody><actuator><position name="p" joint="a" '
        'kp="9"/><velocity name="v" joint="a" class="brake"/></actuator></mujoco>'
    )
    made = read_mechanism(tmp_path / "robot.xml")
    assert [a.name for a in made.actuators] == ["p"]
    assert any("do nothing: v" in note for note in made.notes)


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_a_loop_that_is_open_because_its_equality_is_inactive(tmp_path, kind):
    anchor = 'anchor="0 0 -0.3"' if kind == "connect" else ""
    text = "".join(
        f'<body name="{n}" pos="{x} 0 0"><joint name="{n}" axis="0 1 0"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="{m}"/></body>'
        for n, x, m in (("l", 0, 0.5), ("r", 0.2, 0.8))
    )
    (tmp_path / "robot.xml").write_text(
        f"<mujoco><worldbody>{text}</worldbody><equality><{kind} active='false' body1='l' "
        f"body2='r' {anchor}/></equality></mujoco>"
    )
    made = read_mechanism(tmp_path / "robot.xml")
    assert made.tree.n == 2


# 3: words of registers


def test_speeds_with_a_sign_bit_beside_angles_in_radians(tmp_path):
    speeds = np.round(M["v"] * 1000).astype(int)
    spoiled = np.where(speeds < 0, 32768 - speeds, speeds)
    columns = named(M | {"v": 1.0 * spoiled}, ARM, "q", "v", "tau")
    trial = read_log(folder(tmp_path, "[units]\nv = 0.001\n", a=columns), ARM).trials[0]
    assert trial.v is not None
    np.testing.assert_allclose(trial.v, M["v"], atol=6e-4)


@pytest.mark.parametrize("word", [65535, -1])
def test_a_register_that_was_not_read_now_and_then(tmp_path, word):
    """What a bus that timed out hands on: all bits set."""
    counts = 1.0 * np.round(M["q"] / (2 * np.pi) * 4096) + 2048
    failed = np.array([20, 61, 62, 63, 130])
    counts[failed, 1] = word
    ticks = "".join(f"q_{j} = {{ticks = 4096, zero = 2048}}\n" for j in ARM)
    data = folder(tmp_path, f"[units]\n{ticks}", a=named(M | {"q": counts}, ARM, "q", "tau"))
    try:
        read = read_log(data, ARM)
    except BadInput as error:
        assert "q_elbow" in str(error) and str(word) in str(error)
        return
    q = read.trials[0].q
    assert np.isnan(q[failed, 1]).all()
    np.testing.assert_allclose(np.delete(q, failed, 0), np.delete(M["q"], failed, 0), atol=1e-3)


# 4: another side, another sign


def follow(make, pattern, most=3):
    """What is left to say once each line of advice was written; make(lines) -> folder."""
    lines: list[str] = []
    for _ in range(most):
        try:
            found = check_conventions(load(make(lines)))
        except BadInput as error:
            new = re.findall(pattern, str(error))
            assert new, str(error)
            lines += new
        else:
            return lines, found
    raise AssertionError(lines)


def test_targets_that_count_against_the_angle(tmp_path):
    names = ("hip", "knee")
    trials = []
    for k in range(4):
        u = sines(k, 250, 100.0, 2)
        trials.append((np.arange(250) / 100, noisy(swung(u, 100.0), k), u * [1, -1]))

    def make(lines):
        meta = "[units]\n" + "\n".join(lines) + "\n" if lines else ""
        return log(tmp_path / str(len(lines)), meta, names, trials)

    lines, found = follow(make, r"target_\w+ = -?[\d.]+")
    assert lines == ["target_knee = -1"] and found == ()


def test_torques_of_two_rotors_with_gears_of_their_own(tmp_path):
    spoiled = [c | {"tau1": c["tau1"] / 6.0, "tau2": c["tau2"] / -50.0} for c in arm(4)]

    def make(lines):
        meta = "[units]\n" + "\n".join(lines) + "\n" if lines else ""
        return recorded(tmp_path / str(len(lines)), spoiled, meta)

    lines, found = follow(make, r"tau_joint\d = -?[\d.]+")
    told = {line.split(" = ")[0]: float(line.split(" = ")[1]) for line in lines}
    assert told == pytest.approx({"tau_joint1": 6.0, "tau_joint2": -50.0}, rel=0.05)
    assert found == ()


# 5: order and meaning


THREE = (
    '<mujoco><option timestep="0.001"><flag contact="disable"/></option><worldbody>'
    + "".join(
        f'<body pos="0 0 -0.25"><joint name="{n}" axis="0 1 0" damping="0.05"/><geom '
        f'type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="{m}"/>'
        for n, m in (("waist", 1.0), ("arm", 0.6), ("hand", 0.3))
    )
    + "</body>" * 3
    + "</worldbody><actuator>"
    + "".join(f'<motor name="m_{n}" joint="{n}"/>' for n in ("waist", "arm", "hand"))
    + "</actuator></mujoco>"
)


def test_three_joints_of_motors_in_a_turned_order(tmp_path):
    order = [2, 0, 1]
    model = mujoco.MjModel.from_xml_string(THREE)
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        tau = sines(k, 250, 100.0, 3) * [1.5, 0.6, 0.15]
        for u in tau:
            rows.append([data.qpos.copy(), data.qvel.copy()])
            data.ctrl[:] = u
            mujoco.mj_step(model, data, 10)
        q, v = np.array(rows).transpose(1, 0, 2)
        columns = {"q": noisy(q, k), "v": v, "tau": tau}
        np.savez(
            tmp_path / f"run_{k}.npz",
            time=np.arange(250) / 100,
            **{s: x[:, order] for s, x in columns.items()},
        )
    (tmp_path / "robot.xml").write_text(THREE)
    meta = tmp_path / "meta.toml"
    meta.write_text(f'{HEAD}model = "robot.xml"\n')
    with pytest.raises(BadInput, match="order") as error:
        check_conventions(load(tmp_path))
    lines = re.findall(r"(?:q|v|tau) = \[.*?\](?=[ ,;]|$)", str(error.value))
    text = f'{HEAD}model = "robot.xml"\n[columns]\n' + "\n".join(lines) + "\n"
    meta.write_text(text)
    assert check_conventions(load(tmp_path)) == ()


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_targets_of_a_table_that_are_its_own_angles(tmp_path, rows):
    q = np.round(M["q"], 6)
    target = np.concatenate([q[rows:], np.repeat(q[-1:], rows, axis=0)])
    columns = named(M | {"q": q, "target": target}, ARM, "q", "target")
    with pytest.raises(BadInput, match=r"target_\w+'? is .*targets = \"absolute\""):
        read_log(folder(tmp_path, "", a=columns), ARM)


# 6: repeated and missing rows


def test_joints_of_a_bus_that_are_read_in_turn(tmp_path):
    u = sines(3, 800, 200.0, 2)
    true = swung(u, 200.0)
    q = noisy(true, 3)
    for j in range(2):
        stale = np.arange(len(q)) % 2 != j
        stale[0] = False
        q[stale, j] = q[np.flatnonzero(stale) - 1, j]
    trial = np.arange(800) / 200, q, u
    read = read_log(log(tmp_path, "", ("hip", "knee"), [trial] * 2), ("hip", "knee"))
    told = [n for n in read.notes if "each reading stands in" in n or "in turn" in n]
    t = read.trials[0]
    at = np.round(t.time * 200).astype(int)
    off = np.abs(t.q - true[at])
    assert told and np.nanquantile(off, 0.9) < 1e-3


def test_a_counter_of_frames_that_shows_the_holes(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    vector = {"dtype": "float32", "shape": [2], "names": list(ARM)}
    one = {"dtype": "int64", "shape": [1]}
    features = {"observation.state": vector, "action": vector, "timestamp": one}
    features |= {"frame_index": one, "episode_index": one}
    path = data_set(tmp_path / "set", features=features)
    file = path / "data" / "chunk-000" / "file-000.parquet"
    table = parquet.read_table(file).to_pydict()
    kept = np.ones(80, bool)
    kept[[7, 8, 9, 30, 55, 56]] = False
    table = {k: [x for x, keep in zip(v, kept, strict=True) if keep] for k, v in table.items()}
    counts = [kept[:40].sum(), kept[40:].sum()]
    table["timestamp"] = [k / 30 for n in counts for k in range(n)]  # the counter keeps the holes
    parquet.write_table(pa.table(table), file)
    read = read_log(path, ARM)
    for e, trial in enumerate(read.trials):
        true = np.flatnonzero(kept[40 * e : 40 * e + 40])
        there = np.isfinite(trial.q).all(1)
        np.testing.assert_allclose(
            (trial.time[there] - trial.time[there][0]) * 30, true - true[0], atol=1e-6
        )
    assert any("frame_index leaves out 4 rows" in n for n in read.notes)


def test_a_counter_beside_even_stamps_of_a_table(tmp_path):
    kept = np.ones(200, bool)
    kept[[50, 51, 120]] = False
    columns = {n: x[kept] for n, x in named(M, ARM, "q", "tau").items()}
    columns |= {"seq": 1000.0 + np.flatnonzero(kept), "time": M["time"][: kept.sum()]}
    trial = read_log(folder(tmp_path, "", a=columns), ARM).trials[0]
    np.testing.assert_allclose(trial.time, M["time"][kept], atol=1e-9)


# 7: two on one bus


def test_two_senders_of_commands_on_one_topic(tmp_path):
    bag = Bag("mcap")
    for k, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][k])
        bag.array("/arm/commands", ns(t), M["q"][k] + 0.1)
        if k % 10 == 5:
            bag.array("/arm/commands", ns(t + 0.0033), [0.0, 0.0])
    try:
        read = read_log(bag.write(tmp_path), ARM)
    except BadInput as error:
        assert "/arm/commands" in str(error) and "sender" in str(error)
        return
    np.testing.assert_allclose(read.trials[0].u[:190], M["q"][:190] + 0.1, atol=1e-9)
    assert any("/arm/commands" in n and "sender" in n for n in read.notes)


def test_each_arms_topic_calls_its_joints_by_the_same_names(tmp_path):
    """The model says left_shoulder, right_shoulder; each arm says shoulder, elbow."""
    bag = Bag("ros2")
    joints = tuple(f"{side}_{n}" for side in ("left", "right") for n in ARM)
    m = motion(4, rows=200)
    for k, t in enumerate(m["time"]):
        for s, side in enumerate(("left", "right")):
            part = slice(2 * s, 2 * s + 2)
            bag.joints(f"/{side}/joint_states", ns(t), ARM, m["q"][k, part], (), m["tau"][k, part])
    try:
        read = read_log(bag.write(tmp_path), joints)
    except BadInput as error:
        said = str(error)
        assert "/left/joint_states" in said and "/right/joint_states" in said, said
        return
    np.testing.assert_allclose(read.trials[0].q, m["q"])


# 8: files


def test_a_bag_that_was_being_recorded(tmp_path):
    bag = Bag("bag")
    for k, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][k], (), M["tau"][k])
    whole = bag.write(tmp_path).read_bytes()
    (tmp_path / "run.bag").unlink()
    (tmp_path / "run.bag.active").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(BadInput, match=r"run\.bag\.active.*rosbag reindex") as error:
        read_log(tmp_path, ARM)
    assert "\n" not in str(error.value)


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 123456\n".format(
    "0" * 64
)


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.mcap", "run.bag", "set", "run.db3"])
def test_pointers_of_git_lfs_in_the_place_of_data(tmp_path, name):
    path = tmp_path / name
    if name == "set":
        data_set(path)
        path = next(path.rglob("*.parquet"))
    path.write_text(POINTER)
    with pytest.raises(BadInput, match="git lfs pull") as error:
        read_log(tmp_path / name, ARM)
    assert path.name in str(error.value) and "\n" not in str(error.value)


# 14: a user's own functions


@pytest.mark.parametrize(
    "functions",
    [
        {"reward": lambda data, action: jnp.ones((1, 1)) * data.qpos[0]},
        {"observe": lambda data: jnp.floor(10 * data.qpos).astype(jnp.int32)},
        {"done": lambda data: (data.qpos > 0.6).astype(jnp.int32)},
        {"start": lambda key, q: ([0.5], [0])},
        {"start": lambda key, q: (jnp.ones(1, int), jnp.zeros(1, int))},
        {"observe": lambda data: [data.qpos[0], data.qvel[0]]},
        {"observe": lambda data: (data.qpos, data.qvel)},
    ],
    ids=["a table of one", "whole", "row of 0 or 1", "lists", "whole starts", "list", "tuple"],
)
def test_other_dresses_of_what_functions_return(functions):
    try:
        setting = setting_of(changed(**functions), EnvironmentConfig())
    except BadInput as error:
        assert next(iter(functions)) in str(error) and "wanted" in str(error)
        return
    state = setting.trainer.begin(jax.random.key(0), setting.trainer.init(jax.random.key(0)))
    assert state.live.reward.shape == state.live.done.shape == (256,)
    assert state.live.obs.dtype == state.live.reward.dtype == jnp.float32


def test_a_start_that_is_no_number_now_and_then_is_counted():
    def start(key, q):
        x = jax.random.uniform(key, (1,), minval=-1.0, maxval=1.0)
        return jnp.sqrt(x), jnp.zeros(1)

    setting = setting_of(changed(start=start), replace(SMALL, targets={}))
    trainer = setting.trainer
    state = trainer.begin(jax.random.key(1), trainer.init(jax.random.key(0)))
    _, info = trainer.train(jax.random.key(2), state, everywhere(setting), 2)
    assert (np.asarray(info.lost)[:, 1] > 0.1).all()  # course.py tells it


@pytest.mark.parametrize("how", ["steps", "bursts", "lost"])
def test_commands_of_one_sender_are_all_taken(tmp_path, how):
    """Commands that step to and fro, come in bursts, or lack a number are no second sender's."""
    rng, bag = np.random.default_rng(3), Bag("ros2")
    told = {"steps": np.where(np.arange(200) % 2, 0.5, -0.5), "bursts": M["q"][:, 0] + 0.1}
    u = np.stack([told.get(how, told["bursts"])] * 2, 1)
    for k, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][k])
        late = rng.uniform(0.0, 0.015) if how == "bursts" else 0.0
        bag.array(
            "/arm/commands",
            ns(t + late),
            [np.nan, u[k, 1]] if how == "lost" and k % 10 == 5 else u[k],
        )
    log_of = read_log(bag.write(tmp_path), ARM)
    assert not any("another sender" in note for note in log_of.notes)
