"""Bags as drivers, controllers and recorders leave them: other encodings beside, stamps that are
missing or far off, joints that the model lacks, controllers' own states, trajectories that are
replaced, names that are empty, commands between states.
"""

import json

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from tests.faults.servo_files import sines, swung
from tests.logs.log_files import HEAD, motion

pytest.importorskip("rosbags.rosbag1", reason="extra 'ros' is not installed")
mcap = pytest.importorskip("mcap.writer")
from tests.logs.test_bags import LATE, START, Bag, ns, states  # noqa: E402

ARM = ("shoulder", "elbow")
M = motion(2)
SERVOS = ModelNames(ARM, actuators=tuple(ActuatorName(f"p_{j}", j, "position") for j in ARM))


def channels(path, some):
    """An MCAP file of channels (topic, schema, its encoding, its bytes, encoding of messages, [(ns,
    bytes)]).
    """
    with path.open("wb") as file:
        writer = mcap.Writer(file)
        writer.start(profile="", library="tests")
        rows = []
        for topic, schema, how, data, encoding, messages in some:
            number = writer.register_channel(
                topic, encoding, writer.register_schema(schema, how, data)
            )
            rows += [(when, number, body) for when, body in messages]
        for when, number, body in sorted(rows, key=lambda row: row[0]):
            writer.add_message(number, log_time=when, publish_time=when, data=body)
        writer.finish()
    return path


def with_channel(source, path, topic, schema, encoding, messages):
    """The MCAP file `source` with another channel in it."""
    from mcap.reader import make_reader

    with source.open("rb") as file:
        some = {}
        for s, c, m in make_reader(file).iter_messages():
            some.setdefault(c.topic, (c.topic, s.name, s.encoding, s.data, c.message_encoding, []))[
                5
            ].append((m.log_time, m.data))
    return channels(
        path,
        [
            *some.values(),
            (
                topic,
                schema,
                "jsonschema" if encoding == "json" else encoding,
                b"{}",
                encoding,
                messages,
            ),
        ],
    )


@pytest.mark.parametrize("encoding", ["json", "protobuf", "flatbuffer", "cbor"])
def test_a_channel_of_another_encoding_is_left_and_told(tmp_path, encoding):
    bag = Bag("mcap")
    states(bag)
    data = b'{"level": 0}' if encoding == "json" else b"\x08\x01"
    path = with_channel(
        bag.write(tmp_path),
        tmp_path / "more.mcap",
        "/battery",
        "vendor.Battery",
        encoding,
        [(ns(0.1), data)] * 3,
    )
    log = read_log(path, ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert any("/battery (vendor.Battery, " in note for note in log.notes)


def json_states(stamp):
    for i, t in enumerate(M["time"]):
        joints = [
            {
                "name": n,
                "position": M["q"][i, j],
                "velocity": M["v"][i, j],
                "effort": M["tau"][i, j],
            }
            for j, n in enumerate(ARM)
        ]
        yield ns(t) + LATE, json.dumps({"timestamp": stamp(ns(t)), "joints": joints}).encode()


def iso(when):
    from datetime import UTC, datetime

    return (
        datetime.fromtimestamp(when // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%S")
        + f".{when % 10**9:09d}Z"
    )


STAMPS = {
    "sec nsec": lambda t: {"sec": t // 10**9, "nsec": t % 10**9},
    "iso": iso,
    "nanosec": lambda t: {"sec": t // 10**9, "nanosec": t % 10**9},
}


@pytest.mark.parametrize("how", STAMPS)
def test_foxglove_joint_states_in_json(tmp_path, how):
    path = channels(
        tmp_path / "f.mcap",
        [
            (
                "/joints",
                "foxglove.JointStates",
                "jsonschema",
                b"{}",
                "json",
                list(json_states(STAMPS[how])),
            )
        ],
    )
    (trial,) = read_log(path, ARM).trials
    np.testing.assert_allclose(trial.q, M["q"])
    np.testing.assert_allclose(trial.u, M["tau"])
    np.testing.assert_allclose(trial.time, M["time"], atol=2e-6)


def test_foxglove_joint_states_in_protobuf(tmp_path):
    pb = pytest.importorskip("google.protobuf.descriptor_pb2")
    from google.protobuf import descriptor_pool, message_factory, timestamp_pb2

    def field(name, number, kind, label=1, type_name=None):
        return pb.FieldDescriptorProto(
            name=name, number=number, type=kind, label=label, type_name=type_name
        )

    numbers = [field(n, k, 1) for k, n in ((2, "position"), (3, "velocity"), (5, "effort"))]
    joint = pb.DescriptorProto(name="JointState", field=[field("name", 1, 9), *numbers])
    inside = [
        field("timestamp", 1, 11, 1, ".google.protobuf.Timestamp"),
        field("joints", 2, 11, 3, ".foxglove.JointState"),
    ]
    whole = pb.DescriptorProto(name="JointStates", field=inside)
    file = pb.FileDescriptorProto(
        name="foxglove/JointStates.proto",
        package="foxglove",
        syntax="proto3",
        message_type=[joint, whole],
        dependency=["google/protobuf/timestamp.proto"],
    )
    known = pb.FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool = descriptor_pool.DescriptorPool()
    for one in (known, file):
        pool.Add(one)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    rows = []
    for i, t in enumerate(M["time"]):
        m = make()
        m.timestamp.seconds, m.timestamp.nanos = divmod(ns(t), 10**9)
        for j, name in enumerate(ARM):
            m.joints.add(
                name=name, position=M["q"][i, j], velocity=M["v"][i, j], effort=M["tau"][i, j]
            )
        rows.append((ns(t) + LATE, m.SerializeToString()))
    schema = pb.FileDescriptorSet(file=[known, file]).SerializeToString()
    path = channels(
        tmp_path / "f.mcap",
        [("/joints", "foxglove.JointStates", "protobuf", schema, "protobuf", rows)],
    )
    (trial,) = read_log(path, ARM).trials
    np.testing.assert_allclose(trial.q, M["q"])
    np.testing.assert_allclose(trial.v, M["v"])
    np.testing.assert_allclose(trial.time, M["time"], atol=1e-9)


def test_foxglove_joint_states_that_are_not_read_are_named(tmp_path):
    path = channels(
        tmp_path / "f.mcap",
        [("/joints", "foxglove.JointStates", "flatbuffer", b"", "flatbuffer", [(ns(0), b"x")])],
    )
    with pytest.raises(BadInput, match=r"/joints .foxglove.JointStates in flatbuffer") as error:
        read_log(path, ARM)
    assert "recover" not in str(error.value)


@pytest.mark.parametrize("kind", ["bag", "ros2", "mcap"])
@pytest.mark.parametrize("bad", [(0,), (0, 1, 2), (7, 30), (59,)])
def test_messages_without_a_stamp_are_left_out_and_the_others_keep_theirs(tmp_path, kind, bad):
    bag = Bag(kind)
    late = np.random.default_rng(0).exponential(4e6, 60).astype(int)
    for i, t in enumerate(M["time"]):
        bag.joints(
            "/joint_states", ns(t), ARM, M["q"][i], M["v"][i], M["tau"][i], stamp=i not in bad
        )
        bag.rows[-1] = (ns(t) + LATE + int(late[i]), *bag.rows[-1][1:])
    log = read_log(bag.write(tmp_path), ARM)
    good = [i for i in range(60) if i not in bad]
    np.testing.assert_array_equal(log.trials[0].q, M["q"][good])
    np.testing.assert_allclose(log.trials[0].time, M["time"][good] - M["time"][good[0]], atol=1e-9)
    assert any(f"{len(bad)} messages without a stamp left out" in note for note in log.notes)


@pytest.mark.parametrize("wrong", [5.0, -3600.0, 4e8])
def test_stamps_far_off_are_left_out(tmp_path, wrong):
    bag = Bag("ros2")
    for i, t in enumerate(M["time"]):
        bag.joints(
            "/joint_states",
            ns(t + (wrong if i in (0, 20, 21) else 0.0)),
            ARM,
            M["q"][i],
            M["v"][i],
            M["tau"][i],
        )
        bag.rows[-1] = (ns(t) + LATE, *bag.rows[-1][1:])
    log = read_log(bag.write(tmp_path), ARM)
    good = [i for i in range(60) if i not in (0, 20, 21)]
    np.testing.assert_array_equal(log.trials[0].q, M["q"][good])
    assert any("3 stamps far from the others'" in note for note in log.notes)


def test_a_clock_that_runs_at_another_pace_than_the_computer_s_is_kept(tmp_path):
    """A simulated clock from 0 at a fifth of real time, with a pause of the recorder."""
    bag = Bag("ros2")
    for i, t in enumerate(M["time"]):
        bag.joints("/joint_states", round(1e9 * (t + 0.01)), ARM, M["q"][i], M["v"][i], M["tau"][i])
        bag.rows[-1] = (START + round(5e9 * t) + (20 * 10**9 if i > 30 else 0), *bag.rows[-1][1:])
    (trial,) = read_log(bag.write(tmp_path), ARM).trials
    np.testing.assert_allclose(trial.time, M["time"], atol=1e-9)


def test_a_sender_without_stamps_counts_by_arrival(tmp_path):
    bag = Bag("ros2")
    for i, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ("shoulder",), M["q"][i, :1], M["v"][i, :1])
        bag.joints("/joint_states", ns(t), ("elbow",), M["q"][i, 1:], M["v"][i, 1:], stamp=False)
    (trial,) = read_log(bag.write(tmp_path), ARM).trials
    np.testing.assert_allclose(trial.q, M["q"], atol=1e-6)


@pytest.mark.parametrize("ignored", [True, False])
@pytest.mark.parametrize("speaks", [(0.3,), (0.2, 0.4), tuple(np.arange(0.0, 0.6, 0.02))])
def test_a_joint_that_the_model_lacks_decides_nothing(tmp_path, ignored, speaks):
    bag = Bag("ros2")
    states(bag)
    for t in speaks:
        bag.joints("/joint_states", ns(t + 0.002), ("gripper",), [0.02])
    path = bag.write(tmp_path)
    log = tmp_path / "log"
    log.mkdir()
    (log / "meta.toml").write_text(
        f'{HEAD}data = "../{path.name}"\n' + ('ignore = ["gripper"]\n' if ignored else "")
    )
    read = read_log(log, ARM)
    np.testing.assert_array_equal(read.trials[0].q, M["q"])
    np.testing.assert_allclose(read.trials[0].time, M["time"], atol=1e-9)
    assert ignored or any("the model lacks are left out: gripper" in note for note in read.notes)


def test_a_joint_of_the_model_that_hardly_speaks_is_held_where_it_is(tmp_path):
    bag = Bag("ros2")
    states(bag)
    bag.joints("/joint_states", ns(0.3), ("gripper",), [0.02])
    log = read_log(bag.write(tmp_path), (*ARM, "gripper"))
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert log.held == {"gripper": 0.02} and any(
        "gripper: 1 messages in all" in note for note in log.notes
    )


@pytest.mark.parametrize("kind", ["bag", "ros2", "mcap"])
def test_empty_names_are_the_model_s_order(tmp_path, kind):
    bag = Bag(kind)
    states(bag, names=())
    log = read_log(bag.write(tmp_path), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    np.testing.assert_array_equal(log.trials[0].u, M["tau"])
    assert any("names are empty" in note for note in log.notes)


def test_the_topic_that_names_the_joints_of_the_model_is_the_state(tmp_path):
    bag = Bag("ros2")
    states(bag)
    for k in range(600):  # a gripper that speaks ten times as often
        bag.joints("/gripper/joint_states", ns(k / 1000), ("gripper",), [0.02])
    np.testing.assert_array_equal(read_log(bag.write(tmp_path), ARM).trials[0].q, M["q"])


@pytest.mark.parametrize(
    "names, says", [(("", ""), ""), (("joint", "joint"), "name 'joint' more than once")]
)
def test_names_that_are_blank_or_repeat(tmp_path, names, says):
    bag = Bag("mcap")
    states(bag, names=names)
    path = bag.write(tmp_path)
    if not says:
        np.testing.assert_array_equal(read_log(path, ARM).trials[0].q, M["q"])
        return
    with pytest.raises(BadInput, match=says):
        read_log(path, ARM)


def test_names_of_another_number_than_positions_are_told(tmp_path):
    bag = Bag("ros2")
    states(bag, names=(*ARM, "gripper"))
    with pytest.raises(BadInput, match="name 3 joints and hold 2 positions"):
        read_log(bag.write(tmp_path), ARM)


TEXT = "std_msgs/Header header\nstring[] joint_names\n"


@pytest.mark.parametrize("kind", ["bag", "ros2", "mcap"])
@pytest.mark.parametrize(
    "ends",
    [
        ("desired", "actual"),
        ("reference", "feedback"),
        ("reference", "feedback", "desired", "actual"),
    ],
)
def test_a_controller_s_own_state_is_a_log(tmp_path, kind, ends):
    from rosbags.typesys import get_types_from_msg

    bag = Bag(kind)
    name, point = (
        "control_msgs/msg/JointTrajectoryControllerState",
        "trajectory_msgs/msg/JointTrajectoryPoint",
    )
    bag.types.register(
        get_types_from_msg(
            TEXT + "".join(f"trajectory_msgs/JointTrajectoryPoint {e}\n" for e in ends), name
        )
    )
    wait, e = bag.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0), np.zeros(0)

    def filled(q, v=e):
        return bag.make(
            point,
            positions=np.asarray(q, float),
            velocities=np.asarray(v, float),
            accelerations=e,
            effort=e,
            time_from_start=wait,
        )

    for i, t in enumerate(M["time"]):
        told = {end: filled(()) for end in ends} | {
            ends[0]: filled(M["q"][i] + 0.1),
            ends[1]: filled(M["q"][i], M["v"][i]),
        }
        bag.rows.append(
            (
                ns(t) + LATE,
                "/arm_controller/state",
                name,
                bag.make(name, header=bag.header(ns(t)), joint_names=list(ARM), **told),
            )
        )
    log = read_log(bag.write(tmp_path), SERVOS)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    np.testing.assert_array_equal(log.trials[0].v, M["v"])
    np.testing.assert_allclose(log.trials[0].u, M["q"] + 0.1)


def test_dynamic_joint_states(tmp_path):
    from rosbags.typesys import get_types_from_msg

    bag = Bag("ros2")
    inner, name = "control_msgs/msg/InterfaceValue", "control_msgs/msg/DynamicJointState"
    bag.types.register(get_types_from_msg("string[] interface_names\nfloat64[] values\n", inner))
    bag.types.register(
        get_types_from_msg(TEXT + "control_msgs/InterfaceValue[] interface_values\n", name)
    )
    for i, t in enumerate(M["time"]):
        values = [
            bag.make(
                inner,
                interface_names=["effort", "position"],
                values=np.array([M["tau"][i, j], M["q"][i, j]]),
            )
            for j in (1, 0)
        ]
        m = bag.make(
            name,
            header=bag.header(ns(t)),
            joint_names=["elbow", "shoulder"],
            interface_values=values,
        )
        bag.rows.append((ns(t) + LATE, "/dynamic_joint_states", name, m))
    (trial,) = read_log(bag.write(tmp_path), ARM).trials
    np.testing.assert_array_equal(trial.q, M["q"])
    np.testing.assert_array_equal(trial.u, M["tau"])


# ---------------------------------------------------------------- commands


def trajectory(bag, sent, names, points, stamp=True, late=LATE):
    kind, point = "trajectory_msgs/msg/JointTrajectory", "trajectory_msgs/msg/JointTrajectoryPoint"
    e, made = np.zeros(0), []
    for after, q in points:
        wait = bag.make(
            "builtin_interfaces/msg/Duration", sec=int(after), nanosec=round(after % 1 * 1e9)
        )
        made.append(
            bag.make(
                point,
                positions=np.asarray(q, float),
                velocities=e,
                accelerations=e,
                effort=e,
                time_from_start=wait,
            )
        )
    m = bag.make(
        kind, header=bag.header(ns(sent) if stamp else 0), joint_names=list(names), points=made
    )
    bag.rows.append((ns(sent) + late, "/arm_controller/joint_trajectory", kind, m))


PLANS = [
    (-0.05, [(0.05, 0.0)]),
    (0.0, [(0.2, 0.3), (0.7, 0.7), (1.2, 1.0), (1.7, 1.3)]),
    (0.9, [(0.25, -0.2), (0.75, -0.5)]),
    (1.9, [(0.2, 0.1)]),
]
HELD = [(0.2, 0.3), (0.7, 0.7), (1.15, -0.2), (1.65, -0.5), (2.1, 0.1)]
RAMPED = [
    (0.0, 0.0),
    (0.2, 0.3),
    (0.7, 0.7),
    (0.9, 0.82),
    (1.15, -0.2),
    (1.65, -0.5),
    (1.9, -0.5),
    (2.1, 0.1),
]


@pytest.mark.parametrize("how", ["hold", "ramp"])
@pytest.mark.parametrize("stamp", [True, False])
@pytest.mark.parametrize("kind", ["bag", "ros2"])
def test_a_new_trajectory_takes_the_place_of_what_is_ahead(tmp_path, how, stamp, kind):
    t = np.arange(300) / 100
    if how == "hold":
        u = np.array([next((q for s, q in reversed(HELD) if x >= s - 1e-9), 0.0) for x in t])[
            :, None
        ]
    else:
        u = np.interp(t, *zip(*RAMPED, strict=True))[:, None]
    q = swung(u, 100.0)
    bag = Bag(kind)
    for i, x in enumerate(t):
        bag.joints("/joint_states", ns(x), ("arm",), q[i])
    for sent, points in PLANS:
        trajectory(bag, sent, ("arm",), [(after, [x]) for after, x in points], stamp)
    path = bag.write(tmp_path)
    names = ModelNames(("arm",), actuators=(ActuatorName("p", "arm", "position"),))
    for more in ("", f'[ros]\ntrajectory = "{how}"\n'):
        log = tmp_path / f"log{len(more)}"
        log.mkdir()
        (log / "meta.toml").write_text(f'{HEAD}data = "../{path.name}"\n{more}')
        read = read_log(log, names)
        assert abs(read.trials[0].u - u).mean() < (1e-9 if how == "hold" else 2e-3)
        assert any("takes the place of what is ahead" in note for note in read.notes)


def test_points_one_at_a_time_are_moved_to(tmp_path):
    """A point every 0.1 s with 0.1 s to get there."""
    goal = sines(3, 32, 10.0, 1)[:, 0]
    t = np.arange(300) / 100
    u = np.interp(t, np.arange(33) / 10, [0.0, *goal])[:, None]
    q = swung(u, 100.0)
    bag = Bag("ros2")
    for i, x in enumerate(t):
        bag.joints("/joint_states", ns(x), ("arm",), q[i])
    for k in range(-1, 30):
        trajectory(bag, k / 10, ("arm",), [(0.1, [0.0 if k < 0 else goal[k]])])
    names = ModelNames(("arm",), actuators=(ActuatorName("p", "arm", "position"),))
    log = read_log(bag.write(tmp_path), names)
    np.testing.assert_allclose(log.trials[0].u, u, atol=1e-3)


@pytest.mark.parametrize("after", [0.002, 0.009, 0.0])
def test_a_command_acts_from_its_own_time(tmp_path, after):
    bag = Bag("ros2")
    u = sines(4, 60, 100.0, 2)
    for i, t in enumerate(M["time"]):
        bag.joints("/joint_states", ns(t), ARM, M["q"][i])
        bag.array("/commands", ns(t + after), u[i])
    (trial,) = read_log(bag.write(tmp_path), SERVOS).trials
    first = 60 - len(trial.time)
    share = after * 100.0
    expected = share * u[first - 1 : 58] + (1 - share) * u[first:59] if after else u[:59]
    np.testing.assert_allclose(trial.u[:-1], expected, atol=1e-6)


@pytest.mark.parametrize("array", [False, True])
@pytest.mark.parametrize("late", [0.001, 0.004])
def test_a_target_counted_anew_between_states_has_the_turns_of_its_angle(tmp_path, late, array):
    def wrap(x):
        return (x + np.pi) % (2 * np.pi) - np.pi

    t = np.arange(200) / 100
    u = (5.0 * t)[:, None]
    q = u - 0.2
    bag = Bag("ros2")
    for i, x in enumerate(t):
        bag.joints("/joint_states", ns(x), ("arm",), wrap(q[i]))
        if array:
            bag.array("/commands", ns(x + late), wrap(u[i]))
        else:
            bag.joints("/commands", ns(x + late), ("arm",), wrap(u[i]))
    names = ModelNames(("arm",), actuators=(ActuatorName("p", "arm", "position"),))
    (trial,) = read_log(bag.write(tmp_path), names).trials
    np.testing.assert_allclose(trial.u - trial.q, 0.2 - 5.0 * late, atol=1e-6)
