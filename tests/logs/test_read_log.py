"""Logs from CSV and NPZ: columns by order and by name, units, angles, inputs, trials."""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion, named, numbered, write_csv

ARM = ("shoulder", "elbow")
M = motion(2)


def refused(source, model=None) -> str:
    with pytest.raises(BadInput) as caught:
        read_log(source, model)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_columns_by_order_and_by_name_are_the_same(tmp_path):
    by_order = read_log(folder(tmp_path / "a", "", t=numbered(M, "q", "v", "tau")), ARM)
    swapped = {k: v for k, v in reversed(named(M, ARM, "q", "v", "tau").items())}
    by_name = read_log(folder(tmp_path / "b", "", t=swapped), ARM)
    for log in (by_order, by_name):
        (trial,) = log.trials
        assert (log.joint_names, log.input_kind, log.input_names) == (ARM, "torque", ARM)
        np.testing.assert_array_equal(trial.q, M["q"])
        np.testing.assert_array_equal(trial.v, M["v"])
        np.testing.assert_array_equal(trial.u, M["tau"])


def test_one_joint_needs_no_number_and_a_file_no_folder(tmp_path):
    one = {"time": M["time"], "q": M["q"][:, 0], "u": M["tau"][:, 0]}
    log = read_log(write_csv(tmp_path / "run.csv", one))
    assert (log.joint_names, log.input_kind, log.trials[0].name) == (("joint1",), "voltage", "run")
    assert log.trials[0].v is None
    assert any("no meta.toml" in note for note in log.notes)


def test_an_archive_of_matrices(tmp_path):
    np.savez(
        tmp_path / "run.npz",
        time=M["time"],
        q=M["q"],
        v=M["v"],
        tau=M["tau"],
        camera=np.zeros((3, 4, 5)),
    )
    log = read_log(tmp_path / "run.npz", ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    np.testing.assert_array_equal(log.trials[0].u, M["tau"])
    assert "columns ignored: camera" in log.notes


def test_matrices_by_names_of_their_own(tmp_path):
    meta = '[columns]\nq = "qpos"\ntarget = "qpos_des"\n'
    folder(tmp_path, meta)
    np.savez(tmp_path / "run.npz", t=M["time"], qpos=M["q"], qpos_des=M["tau"])
    log = read_log(tmp_path, ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert log.input_kind == "command"
    np.savez(tmp_path / "run.npz", t=M["time"][1:], qpos=M["q"], qpos_des=M["tau"])
    assert "arrays differ in length (time 59" in refused(tmp_path, ARM).replace("(t 59", "(time 59")


def test_joints_counted_from_zero(tmp_path):
    columns = {"t": M["time"], "q0": M["q"][:, 0], "q1": M["q"][:, 1]}
    log = read_log(write_csv(tmp_path / "run.csv", columns), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    assert log.input_kind == "none" and log.trials[0].u.shape == (60, 0)


def test_a_trial_column_cuts_one_file_in_trials(tmp_path):
    columns = {k: np.concatenate([v, v]) for k, v in numbered(M, "q", "tau").items()}
    columns["trial"] = np.array(["slow"] * 60 + ["fast"] * 60)
    log = read_log(write_csv(tmp_path / "runs.csv", columns), ARM)
    assert [trial.name for trial in log.trials] == ["slow", "fast"]
    assert all(np.array_equal(trial.q, M["q"]) for trial in log.trials)


def test_renamed_columns_units_and_a_velocity_that_follows_its_angle(tmp_path):
    meta = """
ignore = ["spare"]
[columns]
time = "Zeit"
q = ["a", "b"]
tau_elbow = "strom"
[units]
time = "ms"
angle = "deg"
tau_elbow = "mNm"
"""
    columns = {
        "Zeit": M["time"] * 1e3,
        "a": np.degrees(M["q"][:, 0]),
        "b": np.degrees(M["q"][:, 1]),
        "v1": np.degrees(M["v"][:, 0]),
        "v2": np.degrees(M["v"][:, 1]),
        "strom": M["tau"][:, 1] * 1e3,
        "tau_shoulder": M["tau"][:, 0],
        "spare": M["time"],
    }
    (trial,) = read_log(folder(tmp_path, meta, t=columns), ARM).trials
    np.testing.assert_allclose(trial.time, M["time"], atol=1e-12)
    np.testing.assert_allclose(trial.q, M["q"], atol=1e-12)
    np.testing.assert_allclose(trial.v, M["v"], atol=1e-12)
    np.testing.assert_allclose(trial.u, M["tau"], atol=1e-12)


def test_a_sliding_joint_is_in_metres_where_angles_are_in_degrees(tmp_path):
    meta = '[units]\nangle = "deg"\nlength = "mm"\n'
    columns = {
        "time": M["time"],
        "q_cart": 1e3 * M["q"][:, 0],
        "q_pole": np.degrees(M["q"][:, 1]),
        "tau_cart": M["tau"][:, 0],
    }
    names = ModelNames(
        ("cart", "pole"), slides=("cart",), actuators=(ActuatorName("push", "cart"),)
    )
    log = read_log(folder(tmp_path, meta, t=columns), names)
    np.testing.assert_allclose(log.trials[0].q, M["q"], atol=1e-12)
    np.testing.assert_array_equal(log.trials[0].u, np.stack([M["tau"][:, 0], np.zeros(60)], axis=1))
    assert log.driven == ("cart",)
    assert any("free to move: pole" in note for note in log.notes)


def test_absolute_angles_zeros_and_reversed_joints(tmp_path):
    meta = (
        '[angles]\nconvention = "absolute"\nzero = {shoulder = 3.0, elbow = 3.0}\n'
        'reversed = ["elbow"]\n'
    )
    logged = {
        "time": M["time"],
        "q1": M["q"][:, 0] + 3.0,
        "q2": M["q"][:, 0] - M["q"][:, 1] + 3.0,
        "v1": M["v"][:, 0],
        "v2": M["v"][:, 0] - M["v"][:, 1],
        "tau1": M["tau"][:, 0],
        "tau2": -M["tau"][:, 1],
    }
    (trial,) = read_log(folder(tmp_path, meta, t=logged), ARM).trials
    np.testing.assert_allclose(trial.q, M["q"], atol=1e-12)
    np.testing.assert_allclose(trial.v, M["v"], atol=1e-12)
    np.testing.assert_allclose(trial.u, M["tau"], atol=1e-12)


def test_absolute_angles_follow_the_tree_not_the_order(tmp_path):
    names = ModelNames(("hip", "arm", "knee"), parents=(-1, -1, 0))
    m = motion(3)
    shown = m["q"] + np.stack([np.zeros(60), np.zeros(60), m["q"][:, 0]], axis=1)
    meta = '[angles.convention]\nknee = "absolute"\n'
    (trial,) = read_log(
        folder(tmp_path, meta, t=numbered(m | {"q": shown}, "q", "tau")), names
    ).trials
    np.testing.assert_allclose(trial.q, m["q"], atol=1e-12)


def test_targets_go_through_the_models_actuators(tmp_path):
    names = ModelNames(
        ARM,
        actuators=(
            ActuatorName("m2", "elbow", "position"),
            ActuatorName("m1", "shoulder", "position"),
        ),
    )
    columns = numbered(M | {"target": M["q"] + 0.1}, "q", "target")
    log = read_log(folder(tmp_path / "a", "[angles]\nzero = {q2 = 0.5}\n", t=columns), names)
    assert (log.input_kind, log.input_names, log.driven) == ("command", ("m2", "m1"), ARM)
    np.testing.assert_allclose(log.trials[0].u, M["q"][:, ::-1] + [0.1 - 0.5, 0.1], atol=1e-12)
    by_actuator = {
        "time": M["time"],
        **numbered(M, "q"),
        "ctrl_m1": M["q"][:, 0],
        "ctrl_m2": M["q"][:, 1],
    }
    told = read_log(folder(tmp_path / "b", "", t=by_actuator), names)
    np.testing.assert_array_equal(told.trials[0].u, M["q"][:, ::-1])


SERVOS = {
    "position": '<position joint="{j}" kp="3" kv="0.1" gear="{g}"/>',
    "general": '<general joint="{j}" biastype="affine" gainprm="0.5" biasprm="0.2 -4 -1" '
    'gear="{g}"/>',
    "intvelocity": '<intvelocity joint="{j}" kp="3" gear="{g}" actrange="-9 9"/>',
}


@pytest.mark.parametrize("kind", SERVOS)
@pytest.mark.parametrize("gear", [1.0, 20.0, -15.0])
def test_a_target_in_radians_rests_where_the_joint_is_there(tmp_path, kind, gear):
    """What a servo is told to go to an angle leaves no force at that angle, whatever its gear, gain
    and bias are.
    """
    import mujoco

    from adaptsim_jax.logs.read import names_of

    servos = "".join(SERVOS[kind].format(j=j, g=gear) for j in ARM)
    bodies = "".join(f'<body><joint name="{j}"/><geom size="0.1" mass="1"/></body>' for j in ARM)
    model = tmp_path / "robot.xml"
    model.write_text(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>"
    )
    columns = named(M | {"target": M["q"][::-1]}, ARM, "q", "target")
    log = read_log(folder(tmp_path / "a", "", t=columns), names_of(str(model))[1])
    compiled = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(compiled)
    for row in (3, 30, 57):
        data.qpos[:] = M["q"][::-1][row]
        data.ctrl[:] = log.trials[0].u[row]
        if compiled.na:
            data.act[:] = log.trials[0].u[row]
        mujoco.mj_forward(compiled, data)
        np.testing.assert_allclose(data.qfrc_actuator, 0.0, atol=1e-9)
    told = named(M, ARM, "q") | {f"ctrl_{j}": M["q"][:, k] for k, j in enumerate(ARM)}
    same = read_log(folder(tmp_path / "b", "", t=told), names_of(str(model))[1])
    np.testing.assert_allclose(same.trials[0].u, M["q"], rtol=1e-12)


@pytest.mark.parametrize("path", ['"..\\robot.xml"', "'..\\robot.xml'", '"..\\\\robot.xml"'])
def test_a_path_of_windows_is_refused_with_a_slash(tmp_path, path):
    data = folder(tmp_path / "a", f"model = {path}\n", t=numbered(M, "q"))
    with pytest.raises(BadInput, match="write / in place of a backslash"):
        read_log(data)


@pytest.mark.parametrize("end", ["Z", "+00:00", "", "+02:00"])
def test_times_of_iso_8601_are_seconds(tmp_path, end):
    from datetime import datetime, timedelta

    begin = datetime(2026, 3, 4, 14, 5, 1)
    stamps = [(begin + timedelta(seconds=t)).isoformat() + end for t in M["time"]]
    columns = numbered(M, "q", "tau") | {"time": np.array(stamps)}
    log = read_log(folder(tmp_path / "a", "", t=columns), ARM)
    np.testing.assert_allclose(log.trials[0].time, M["time"], atol=1e-6)


def test_what_was_commanded_is_kept_beside_what_was_measured(tmp_path):
    columns = numbered(M, "q", "tau") | {"tau1_commanded": M["time"], "tau2_commanded": -M["time"]}
    log = read_log(folder(tmp_path / "a", "", t=columns), ARM)
    np.testing.assert_array_equal(
        log.trials[0].extra["tau_commanded"], np.stack([M["time"], -M["time"]], axis=1)
    )
    del columns["tau1"], columns["tau2"]
    commanded = read_log(folder(tmp_path / "b", "", t=columns), ARM)
    np.testing.assert_array_equal(commanded.trials[0].u[:, 1], -M["time"])
    assert "torques are commands, not measured" in commanded.notes


def test_meta_says_which_of_several_inputs_counts(tmp_path):
    columns = numbered(M | {"target": 1.1 * M["q"]}, "q", "tau", "target")
    assert read_log(folder(tmp_path / "a", "", t=columns), ARM).input_kind == "torque"
    log = read_log(folder(tmp_path / "b", 'input = "command"\n', t=columns), ARM)
    assert log.input_kind == "command"
    np.testing.assert_array_equal(log.trials[0].extra["tau"], M["tau"])


def test_excluded_trials(tmp_path):
    meta = '[trials]\nexclude = ["bad*"]\npayload = {heavy_1 = 0.2}\n'
    c = numbered(M, "q", "tau")
    log = read_log(folder(tmp_path, meta, bad_1=c, heavy_1=c, heavy_2=c, light=c), ARM)
    assert [t.name for t in log.trials] == ["heavy_1", "heavy_2", "light"]
    assert [t.name for t in log.pick(["light"]).trials] == ["light"]


def test_an_encoder_that_counts_from_minus_pi_to_pi(tmp_path):
    q = np.outer(np.linspace(0, 3, 60), [7.0, -2.0])
    wrapped = (q + np.pi) % (2 * np.pi) - np.pi
    log = read_log(write_csv(tmp_path / "run.csv", numbered(M | {"q": wrapped}, "q")), ARM)
    np.testing.assert_allclose(log.trials[0].q, q, atol=1e-9)
    assert any("jumps of whole turns taken out" in note for note in log.notes)
    names = ModelNames(ARM, slides=("shoulder",))
    sliding = read_log(tmp_path / "run.csv", names)
    np.testing.assert_array_equal(sliding.trials[0].q[:, 0], wrapped[:, 0])


def test_ignored_columns_may_hold_anything(tmp_path):
    columns = numbered(M, "q") | {"q9": np.array(["open"] * 60), "q_gripper": np.array([""] * 60)}
    log = read_log(folder(tmp_path, 'ignore = ["q9", "gripper"]\n', t=columns), ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])


def test_angles_that_may_be_degrees_are_told(tmp_path):
    log = read_log(
        write_csv(tmp_path / "run.csv", numbered(M | {"q": np.degrees(M["q"])}, "q")), ARM
    )
    assert any('if they are degrees, write angle = "deg"' in note for note in log.notes)


def test_a_trial_in_degrees_among_others_is_told(tmp_path):
    trials = {
        f"t{k}": numbered(M | {"q": np.degrees(M["q"]) if k == 1 else M["q"]}, "q")
        for k in range(3)
    }
    log = read_log(folder(tmp_path, "", **trials), ARM)
    assert any(
        "in t1, 1 rad in the others: if they are degrees there" in note for note in log.notes
    )


def test_data_may_lie_elsewhere(tmp_path):
    write_csv(tmp_path / "data" / "run.csv", numbered(M, "q"))
    log = read_log(folder(tmp_path / "mine", 'data = "../data"\n'), ARM)
    assert [t.name for t in log.trials] == ["run"]


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("meta", "says"),
    [
        ('modle = "a.xml"', "unknown key 'modle'; did you mean 'model'?"),
        ('model = "a.xml"', "model 'a.xml' does not exist"),
        ('input = "torqe"', "did you mean 'torque'?"),
        (
            "[angles]\nzero = {elbwo = 1.0}",
            "angles.zero names 'elbwo', no joint and no column; did you mean 'elbow'?",
        ),
        ('[angles]\nconvention = "abs"', "'relative', 'absolute'"),
        ('[units]\nq1 = "degre"', "units.q1 = 'degre' is unknown; did you mean 'deg'?"),
        ('[units]\nq1 = "s"', "column q1 is in s, which is no unit of angle"),
        ('[units]\nqq = "deg"', "[units] names 'qq', no column, joint or quantity"),
        ('[columns]\nq1 = "nope"', "has no column 'nope', which [columns] gives to q1"),
        ('[columns]\nq1 = "tau1"\nq2 = "tau1"', "gives column 'tau1' to q1, q2"),
        ('[trials]\nexclude = ["nope"]', "trials.exclude names 'nope', no trial"),
        ('[trials]\nexclude = ["t"]', "leaves no trial"),
        ("[noise]\nelbowww = 1e-4", "[noise] names 'elbowww', no column, joint or quantity"),
        ('input = "current"', 'has no column for input = "current"'),
    ],
)
def test_bad_meta(tmp_path, meta, says):
    message = refused(folder(tmp_path, meta + "\n", t=numbered(M, "q", "tau")), ARM)
    assert says.replace("'relative', 'absolute'", "known: relative, absolute") in message
    assert "meta.toml" in message or "t.csv" in message


def test_the_old_task_is_told_from_a_mechanism(tmp_path):
    path = folder(tmp_path, "", t=numbered(M, "q"))
    (path / "meta.toml").write_text('task = "pendulum"\n')
    assert 'write task = "mechanism"' in refused(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c | {"q3": c["q1"]}, "column 'q3': the model has 2 joint(s)"),
        (
            lambda c: c | {"q_elbwo": c["q1"]},
            "the model has no joint 'elbwo'; did you mean 'elbow'?",
        ),
        (
            lambda c: c | {"q_elbow": c["q1"]},
            "columns 'q2' and 'q_elbow' are both q of joint 'elbow'",
        ),
        (
            lambda c: {k: v for k, v in c.items() if k != "q2"},
            "no angle of the model's joint 'elbow'",
        ),
        (lambda c: {k: v for k, v in c.items() if k != "time"}, "column 'time' is missing"),
        (lambda c: c | {"v1": c["q1"]}, "none of joint 'elbow'; add column v_elbow"),
        (
            lambda c: {k: v for k, v in c.items() if k != "tau2"},
            "no torque of joint 'elbow', which has a motor",
        ),
        (
            lambda c: {k: v for k, v in c.items() if not k.startswith("tau")},
            "no command for actuator 'm1'",
        ),
        (
            lambda c: c | {"q1": np.where(np.arange(60) == 7, 1e9, c["q1"])},
            "line 9: column q1 is 1e+09 in SI units",
        ),
        (
            lambda c: c | {"q1": np.where(np.arange(60) % 15 == 7, np.nan, c["q1"])},
            "line 9: column q1 holds no number",
        ),
        (
            lambda c: c | {"time": np.where(np.arange(60) == 7, 0.0, c["time"])},
            "line 9: time runs backwards",
        ),
        (
            lambda c: c | {"time": 0 * c["time"] + 5.0},
            "time never changes; call the one that does time, in a log by [columns] time",
        ),
        (
            lambda c: c | {"time": np.array(["01.05.2026 12:00:00"] * 60)},
            "a date that is not of ISO 8601; write seconds, with pandas",
        ),
        (
            lambda c: c | {"time": 1e3 * c["time"]},
            'time is suspected in milliseconds; write time = "ms"',
        ),
        (
            lambda c: c | {"v1": 57.3 * M["v"][:, 0], "v2": 57.3 * M["v"][:, 1]},
            'write velocity = "deg/s"',
        ),
        (
            lambda c: {"time": c["time"], **numbered(M | {"target": 1.1 * M["q"]}, "q", "target")},
            "has a target, but its actuator 'm1'",
        ),
        (lambda c: c | {"q": c["q1"]}, "column 'q' names no joint, but the model has 2"),
    ],
)
def test_bad_columns(tmp_path, change, says):
    names = ModelNames(ARM, actuators=(ActuatorName("m1", "shoulder"), ActuatorName("m2", "elbow")))
    message = refused(folder(tmp_path, "", t=change(numbered(M, "q", "tau"))), names)
    assert "t.csv" in message and says in message


def test_a_motor_that_was_off_is_said(tmp_path):
    names = ModelNames(ARM, actuators=(ActuatorName("m1", "shoulder"),))
    assert (
        read_log(folder(tmp_path, 'input = "none"\n', t=numbered(M, "q")), names).input_kind
        == "none"
    )


def test_trials_that_differ_in_their_input(tmp_path):
    path = folder(tmp_path, "", a=numbered(M, "q", "tau"), b=numbered(M, "q"))
    message = refused(path, ARM)
    assert "a.csv: has torque columns, trial b has none" in message


def test_targets_without_an_actuator(tmp_path):
    names = ModelNames(ARM, actuators=())
    message = refused(
        folder(tmp_path, "", t=numbered(M | {"target": 1.1 * M["q"]}, "q", "target")), names
    )
    assert "the model has no actuator; add <actuator>" in message


@pytest.mark.parametrize("name", ["nowhere", "empty", "notes.txt"])
def test_no_data(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello")
    assert name in refused(tmp_path / name)


def test_a_damaged_archive(tmp_path):
    (tmp_path / "run.npz").write_bytes(b"PK\x03\x04 not really")
    assert "is no readable .npz" in refused(tmp_path / "run.npz")
