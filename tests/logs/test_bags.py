"""Bags and MCAP files, written here by the library that reads them."""

import sys

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs import ros
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from adaptsim_jax.logs.readers import Wanted
from tests.logs.log_files import motion

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="extra 'ros' is not installed")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

ARM = ("shoulder", "elbow")
M = motion(2)
START = 1_700_000_000_000_000_000
"""ns; clock time, as bags have it."""
LATE = 3_000_000


class Bag:
    """Messages by topic, written as ROS 1 bag, ROS 2 folder (sqlite3) or MCAP."""

    def __init__(self, kind: str):
        self.kind = kind
        store = typesys.Stores.ROS1_NOETIC if kind == "bag" else typesys.Stores.ROS2_HUMBLE
        self.types = typesys.get_typestore(store)
        self.rows: list[tuple[int, str, str, object]] = []
        self.packed = lambda message: message

    def make(self, kind: str, /, **values):
        return self.types.types[kind](**values)

    def header(self, ns: int):
        extra = {"seq": 0} if self.kind == "bag" else {}
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="", **extra)

    def joints(self, topic, ns, names, q, v=(), tau=(), *, stamp=True):
        def a(x):
            return np.asarray(x, dtype=np.float64)

        m = self.make(
            "sensor_msgs/msg/JointState",
            header=self.header(ns if stamp else 0),
            name=list(names),
            position=a(q),
            velocity=a(v),
            effort=a(tau),
        )
        self.rows.append((ns + LATE, topic, "sensor_msgs/msg/JointState", m))

    def array(self, topic, ns, values):
        layout = self.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        m = self.make(
            "std_msgs/msg/Float64MultiArray",
            layout=layout,
            data=np.asarray(values, dtype=np.float64),
        )
        self.rows.append((ns + LATE, topic, "std_msgs/msg/Float64MultiArray", m))

    def trajectory(self, topic, ns, names, q):
        after = self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        empty = np.zeros(0)
        point = self.make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.asarray(q, dtype=np.float64),
            velocities=empty,
            accelerations=empty,
            effort=empty,
            time_from_start=after,
        )
        m = self.make(
            "trajectory_msgs/msg/JointTrajectory",
            header=self.header(ns),
            joint_names=list(names),
            points=[point],
        )
        self.rows.append((ns + LATE, topic, "trajectory_msgs/msg/JointTrajectory", m))

    def controller(self, topic, ns, names, q, *, old):
        kind, point = (
            "control_msgs/msg/JointTrajectoryControllerState",
            "trajectory_msgs/msg/JointTrajectoryPoint",
        )
        text = "std_msgs/Header header\nstring[] joint_names\n"
        text += "".join(
            f"trajectory_msgs/JointTrajectoryPoint {f}\n"
            for f in (() if old else ("reference",)) + ("desired",)
        )
        if kind not in self.types.types:
            self.types.register(typesys.get_types_from_msg(text, kind))
        after = self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        e = np.zeros(0)

        def filled(a):
            return self.make(
                point,
                positions=np.asarray(a, dtype=np.float64),
                velocities=e,
                accelerations=e,
                effort=e,
                time_from_start=after,
            )

        points = {"desired": filled(q)} if old else {"reference": filled(q), "desired": filled(())}
        m = self.make(kind, header=self.header(ns), joint_names=list(names), **points)
        self.rows.append((ns + LATE, topic, kind, m))

    def write(self, folder):
        if self.kind == "bag":
            path = folder / "run.bag"
            writer, dump = rosbag1.Writer(path), self.types.serialize_ros1
        else:
            plugin = (
                rosbag2.StoragePlugin.MCAP if self.kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
            )
            path = folder / "run"
            writer, dump = (
                rosbag2.Writer(path, version=9, storage_plugin=plugin),
                self.types.serialize_cdr,
            )
        with writer:
            kinds = {topic: kind for _, topic, kind, _ in self.rows}
            open_ = {
                topic: writer.add_connection(topic, kind, typestore=self.types)
                for topic, kind in kinds.items()
            }
            for when, topic, kind, message in sorted(self.rows, key=lambda row: row[0]):
                writer.write(open_[topic], when, self.packed(dump(message, kind)))
        return next(path.glob("*.mcap")) if self.kind == "mcap" else path


def ns(seconds) -> int:
    return START + round(seconds * 1e9)


def states(bag: Bag, topic="/joint_states", m=M, names=ARM, **more):
    for i, t in enumerate(m["time"]):
        bag.joints(topic, ns(t), names, m["q"][i], m["v"][i], m["tau"][i], **more)


@pytest.mark.parametrize("kind", ["bag", "ros2", "mcap"])
def test_joint_states_of_each_kind_of_bag(tmp_path, kind):
    bag = Bag(kind)
    states(bag)
    path = bag.write(tmp_path)
    log = read_log(path, ARM)
    (trial,) = log.trials
    assert (log.input_kind, trial.name) == ("torque", "run")
    np.testing.assert_allclose(trial.time, M["time"], atol=1e-9)
    np.testing.assert_array_equal(trial.q, M["q"])
    np.testing.assert_array_equal(trial.v, M["v"])
    np.testing.assert_array_equal(trial.u, M["tau"])


def test_a_folder_of_bags_is_a_trial_each(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        bag = Bag("mcap")
        states(bag)
        bag.write(tmp_path / name).rename(tmp_path / f"{name}.mcap")
    (tmp_path / "meta.toml").write_text('task = "mechanism"\n[units]\nangle = "deg"\n')
    log = read_log(tmp_path, ARM)
    assert [t.name for t in log.trials] == ["a", "b"]
    np.testing.assert_allclose(log.trials[0].q, np.radians(M["q"]))


def test_bags_without_metadata_are_a_trial_each(tmp_path):
    """A power cut comes before `metadata.yaml` is written."""
    for name in ("a", "b"):
        bag = Bag("ros2")
        states(bag)
        (tmp_path / name).mkdir()
        path = bag.write(tmp_path / name)
        (path / "metadata.yaml").unlink()
        next(path.glob("*.db3")).rename(tmp_path / name / "run_0.db3")
        path.rmdir()
    (tmp_path / "notes").mkdir()
    log = read_log(tmp_path, ARM)
    assert [t.name for t in log.trials] == ["a", "b"]
    for trial in log.trials:
        np.testing.assert_array_equal(trial.q, M["q"])


@pytest.mark.parametrize("kind", ["ros2", "mcap"])
@pytest.mark.parametrize("alone", [True, False])
def test_messages_packed_one_by_one(tmp_path, kind, alone):
    pack = pytest.importorskip("zstandard").ZstdCompressor(level=1).compress
    bag = Bag(kind)
    bag.packed = lambda message: pack(bytes(message))
    states(bag)
    path = bag.write(tmp_path)
    if not alone and kind == "mcap":
        path = path.parent
    log = read_log(path, ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])


@pytest.mark.parametrize("shuffled", [True, False])
@pytest.mark.parametrize("every", [10, 2])
def test_another_sender_that_contradicts_is_left_out(tmp_path, shuffled, every):
    """A left-over publisher of zeros, without speeds or with its names in another order."""
    bag = Bag("ros2")
    states(bag)
    for t in M["time"][every // 2 :: every]:
        names = ARM[::-1] if shuffled else ARM
        bag.joints("/joint_states", ns(t + 0.0033), names, [0.0, 0.0], [0.0, 0.0] * shuffled)
    log = read_log(bag.write(tmp_path), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert any("messages of another sender contradict the 60" in note for note in log.notes)


def test_two_senders_that_cannot_be_told_apart_are_refused(tmp_path):
    bag = Bag("ros2")
    for k, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][k])
        if k % 5 == 2:
            bag.joints("/joint_states", ns(t + 0.0033), ARM, [0.5, -0.9])
    with pytest.raises(BadInput, match="/joint_states: two senders seem to speak of the same"):
        read_log(bag.write(tmp_path), ARM)


def two_arms(tmp_path, names=("left", "right")):
    bag = Bag("ros2")
    for k, t in enumerate(M["time"]):
        for j, arm in enumerate(names):
            if not j or k % 25 != 24:
                bag.joints(f"/{arm}/joint_states", ns(t), [ARM[j]], [M["q"][k, j]])
            bag.trajectory(f"/{arm}/joint_trajectory", ns(t), [ARM[j]], [M["tau"][k, j]])
    return bag


def test_a_topic_of_states_and_of_commands_for_each_arm(tmp_path):
    path = two_arms(tmp_path).write(tmp_path)
    both = read_log(path, ARM)
    meta = tmp_path / "meta.toml"
    meta.write_text(
        'task = "mechanism"\n[ros]\nstate_topic = ["/left/joint_states", "/right/joint_states"]\n'
        'command_topic = ["/left/joint_trajectory", "/right/joint_trajectory"]\n'
    )
    for log in (both, read_log(path, ARM, meta)):
        (trial,) = log.trials
        rows = len(trial.time)
        np.testing.assert_allclose(trial.q, M["q"][:rows], atol=2e-3)  # every 25th between rows
        np.testing.assert_allclose(trial.u, M["tau"][:rows])
    assert any("/left/joint_states, /right/joint_states" in note for note in both.notes)
    topics = ros.bag_topics(path, {}, ARM)[1]
    assert topics["state_topic"] == ["/left/joint_states", "/right/joint_states"]
    meta.write_text('task = "mechanism"\n[ros]\nstate_topic = ["/left/joint_states", "/rigt"]\n')
    with pytest.raises(BadInput, match=r"has no topic '/rigt' \(state_topic\)"):
        read_log(path, ARM, meta)


def test_joints_that_two_topics_name_are_named(tmp_path):
    bag = Bag("ros2")
    states(bag, "/left/joint_states")
    states(bag, "/right/joint_states")
    path = bag.write(tmp_path)
    notes = " ".join(read_log(path, ARM).notes)
    assert "left out: /right/joint_states; state_topic names others" in notes
    both = Wanted({"state_topic": ["/left/joint_states", "/right/joint_states"]}, joints=ARM)
    with pytest.raises(BadInput, match="both speak of"):
        ros.read_bag(path, both)


def test_names_that_change_their_order(tmp_path):
    bag = Bag("mcap")
    for i, t in enumerate(M["time"]):
        order = (0, 1) if i % 3 else (1, 0)
        bag.joints(
            "/joint_states",
            ns(t),
            [ARM[j] for j in order],
            M["q"][i, order],
            M["v"][i, order],
            M["tau"][i, order],
        )
    log = read_log(bag.write(tmp_path), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert any("order of joint names changes" in note for note in log.notes)


def test_joints_from_two_publishers_come_onto_one_clock(tmp_path):
    """The elbow at half the rate and between the shoulder's stamps: its angle is interpolated."""
    bag = Bag("mcap")
    time = np.arange(400) * 0.005
    for i, t in enumerate(time):
        bag.joints("/joint_states", ns(t), ["shoulder"], [np.sin(t)])
        if i % 2 == 0:
            bag.joints("/joint_states", ns(t + 0.0025), ["elbow"], [np.cos(t + 0.0025)])
    log = read_log(bag.write(tmp_path), ARM)
    (trial,) = log.trials
    logged = trial.time + 0.005  # the first row before the elbow's first message is cut off
    np.testing.assert_allclose(trial.q[:, 0], np.sin(logged), atol=1e-9)
    np.testing.assert_allclose(
        trial.q[:, 1], np.cos(logged), atol=2e-5
    )  # h^2 / 8 of a line between rows 0.01 s apart
    assert any("2 publishers" in note for note in log.notes) and any(
        "cut off" in note for note in log.notes
    )


def test_a_gap_of_one_joint_is_missing_not_made_up(tmp_path):
    bag = Bag("mcap")
    for i, t in enumerate(np.arange(400) * 0.005):
        bag.joints("/joint_states", ns(t), ["shoulder"], [np.sin(t)])
        if not 100 < i < 200 and i % 2 == 0:
            bag.joints("/joint_states", ns(t), ["elbow"], [np.cos(t)])
    log = read_log(bag.write(tmp_path), ARM)
    missing = np.isnan(log.trials[0].q[:, 1])
    assert missing[101:199].all() and missing.sum() == 99
    assert any("angles missing: 99 in run" in note for note in log.notes)


def test_repeated_and_late_messages(tmp_path):
    bag = Bag("mcap")
    order = [0, 1, 3, 2, 2, *range(4, 60)]
    for k, i in enumerate(order):
        bag.joints("/joint_states", ns(M["time"][i]), ARM, M["q"][i], M["v"][i], M["tau"][i])
        bag.rows[-1] = (START + k * 10_000_000, *bag.rows[-1][1:])
    log = read_log(bag.write(tmp_path), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert any("out of order" in note for note in log.notes) and any(
        "repeat a stamp" in note for note in log.notes
    )


@pytest.mark.parametrize("how", ["states", "trajectory", "array", "controller", "old controller"])
def test_commands_of_another_topic_hold_from_their_time(tmp_path, how):
    bag = Bag("mcap")
    for i, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][i])
        if i % 2 == 0:
            told = [i, -i]
            if how == "states":
                bag.joints("/joint_commands", ns(t), ARM, told)
            elif how == "trajectory":
                bag.trajectory("/arm/command", ns(t), ARM, told)
            elif how == "array":
                bag.array("/arm/commands", ns(t), told)
            else:
                bag.controller("/arm/controller_state", ns(t), ARM, told, old=how.startswith("old"))
    names = ModelNames(ARM, actuators=tuple(ActuatorName(j, j, "position") for j in ARM))
    log = read_log(bag.write(tmp_path), names)
    held = np.arange(60) // 2 * 2
    assert log.input_kind == "command"
    np.testing.assert_array_equal(log.trials[0].u, np.stack([held, -held], axis=1))
    assert any("commands taken from topic" in note for note in log.notes)


def test_topics_are_chosen_by_name(tmp_path):
    bag = Bag("mcap")
    states(bag, "/left/joint_states")
    for i, t in enumerate(M["time"]):
        bag.joints("/right/joint_states", ns(t), ARM, -M["q"][i])
        bag.joints("/right/joint_states", ns(t) + 5_000_000, ARM, -M["q"][i])
        bag.joints("/odd", ns(t), ARM, M["q"][i] + 1)
    path = bag.write(tmp_path)
    largest = read_log(path, ARM)
    assert any("state taken from topic /right/joint_states" in note for note in largest.notes)
    meta = tmp_path / "meta.toml"
    meta.write_text(
        'task = "mechanism"\ninput = "command"\n[ros]\nstate_topic = '
        '"/left/joint_states"\ncommand_topic = "/odd"\n'
    )
    log = read_log(path, ARM, meta)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    np.testing.assert_array_equal(log.trials[0].u, M["q"] + 1)
    meta.write_text('task = "mechanism"\n[ros]\nstate_topic = "/lefd/joint_states"\n')
    with pytest.raises(
        BadInput,
        match=r"has no topic '/lefd/joint_states' \(state_topic\); did you mean "
        r"'/left/joint_states'",
    ):
        read_log(path, ARM, meta)


def test_states_without_stamps_take_the_time_of_arrival(tmp_path):
    bag = Bag("mcap")
    states(bag, stamp=False)
    log = read_log(bag.write(tmp_path), ARM)
    np.testing.assert_allclose(log.trials[0].time, M["time"], atol=1e-9)
    assert any("time of arrival" in note for note in log.notes)


def test_efforts_that_are_zero_are_no_torques(tmp_path):
    bag = Bag("mcap")
    states(bag, m=M | {"tau": 0 * M["tau"]})
    log = read_log(bag.write(tmp_path), ARM)
    assert log.input_kind == "none"
    assert any("efforts are zero throughout" in note for note in log.notes)


def test_a_joint_that_the_model_lacks_and_one_that_the_data_lack(tmp_path):
    bag = Bag("mcap")
    states(bag, names=("shoulder_joint", "elbow"))
    path = bag.write(tmp_path)
    with pytest.raises(
        BadInput, match="the model has no joint 'shoulder_joint'; did you mean 'shoulder'"
    ) as caught:
        read_log(path, ARM)
    assert "\n" not in str(caught.value)
    log = read_log(path, ("shoulder_joint", "elbow", "wrist"))
    assert log.joint_names == ("shoulder_joint", "elbow") and log.held == {"wrist": None}
    meta = tmp_path / "meta.toml"
    meta.write_text('task = "mechanism"\nignore = ["shoulder_joint"]\n')
    np.testing.assert_array_equal(read_log(path, ("elbow",), meta).trials[0].q, M["q"][:, 1:])


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run.db3"])
def test_damaged_bags(tmp_path, name):
    (tmp_path / name).write_bytes(b"\x89MCAP0\r\n" + bytes(range(200)))
    with pytest.raises(BadInput, match="is no readable bag"):
        read_log(tmp_path / name, ARM)


def test_a_bag_cut_short(tmp_path):
    bag = Bag("mcap")
    states(bag)
    path = bag.write(tmp_path)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(BadInput, match="is no readable bag"):
        read_log(path, ARM)


def test_a_bag_without_joint_states(tmp_path):
    bag = Bag("mcap")
    bag.array("/arm/commands", START, [1.0])
    with pytest.raises(BadInput, match="has no topic of sensor_msgs/JointState"):
        read_log(bag.write(tmp_path), ARM)


def test_without_the_library_the_mend_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    (tmp_path / "run.mcap").write_bytes(b"x")
    with pytest.raises(BadInput, match=r"needs rosbags; run: pip install 'adaptsim_jax\[ros\]'"):
        ros.read_bag(tmp_path / "run.mcap", Wanted())
