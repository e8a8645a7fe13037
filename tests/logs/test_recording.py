"""Reading measured data: what is accepted, in which units, and what every refusal says."""

import subprocess
import sys

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.pendulum import check_known, read_pendulum
from tests.logs.measured_files import META, csv_text, real_rig, table, write


def gentle(rows=60, rate=100.0):
    """A smooth motion with exact velocities, small enough to be plausible in every unit test."""
    t = np.arange(rows) / rate
    q = np.stack([0.5 * np.sin(3 * t), 0.8 * np.sin(5 * t + 1)], axis=1)
    v = np.stack([1.5 * np.cos(3 * t), 4.0 * np.cos(5 * t + 1)], axis=1)
    tau = np.stack([0.1 * np.sin(2 * t), 0.05 * np.cos(2 * t)], axis=1)
    return table(t, q, v, tau)


def refusal(folder, **kwargs):
    """The message with which reading is refused: one line."""
    with pytest.raises(BadInput) as caught:
        read_pendulum(folder, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_columns_come_back_in_si_units_with_shapes(tmp_path):
    columns = gentle() | {"temperature": np.arange(60.0)}
    recording = read_pendulum(write(tmp_path, {"trial_00": columns}))
    trial = recording.trials[0]
    assert trial.q.shape == trial.v.shape == trial.u.shape == (60, 2)
    np.testing.assert_array_equal(trial.q[:, 1], columns["q2"])
    assert not trial.extra and recording.input_kind == "torque"
    assert recording.driven == recording.joint_names == ("joint1", "joint2")
    rig = recording.meta.rig
    assert (rig.model, rig.angle_zero) == ("rigid_body", "hanging")
    assert rig.geometry == {"l1": 0.3, "l2": 0.2, "g": 9.81}
    assert recording.samples == 60 and any("temperature" in note for note in recording.notes)


def test_npz_csv_and_other_delimiters_read_alike(tmp_path):
    columns = gentle()
    folder = write(tmp_path, {"a": columns})
    (folder / "b.csv").write_bytes(b"\xef\xbb\xbf" + csv_text(columns, ";", "\r\n").encode())
    (folder / "c.csv").write_text(csv_text(columns, "\t") + "\n\n")
    (folder / "d.csv").write_text("# " + csv_text(columns))
    np.savez(folder / "e.npz", **columns)
    recording = read_pendulum(folder)
    assert [t.name for t in recording.trials] == ["a", "b", "c", "d", "e"]
    for trial in recording.trials[1:]:
        for field in ("time", "q", "v", "u"):
            np.testing.assert_array_equal(
                getattr(trial, field), getattr(recording.trials[0], field)
            )


def test_trials_are_sorted_as_people_count_and_picked_by_name(tmp_path):
    folder = write(tmp_path, {f"trial_{i}": gentle() for i in (10, 9, 1)})
    assert [t.name for t in read_pendulum(folder).trials] == ["trial_1", "trial_9", "trial_10"]
    assert [t.name for t in read_pendulum(folder).pick(["trial_9"]).trials] == ["trial_9"]
    with pytest.raises(BadInput, match="did you mean 'trial_10'"):
        read_pendulum(folder).pick(["trial_100"])
    assert "trial_100" in refusal(folder, without=["trial_100"])


DEG = 180 / np.pi


@pytest.mark.parametrize(
    ("scale", "units"),
    [
        (
            {"time": 1e3, "q1": DEG, "q2": DEG, "v1": DEG, "v2": DEG, "tau1": 1e3, "tau2": 1e3},
            'time = "ms"\nangle = "deg"\ntorque = "N mm"\n',
        ),
        (
            {"time": 1e3, "q1": DEG, "v1": DEG, "tau2": 1e3},
            'time = "milliseconds"\nangle = "rad"\nq1 = "degrees"\ntau2 = "mN m"\n',
        ),
    ],
    ids=["by quantity", "by column and written out"],
)
def test_declared_units_give_the_same_data(tmp_path, scale, units):
    columns = gentle()
    other = {k: x * scale.get(k, 1.0) for k, x in columns.items()}
    one = read_pendulum(write(tmp_path / "si", {"t": columns})).trials[0]
    two = read_pendulum(write(tmp_path / "other", {"t": other}, f"{META}[units]\n{units}")).trials[
        0
    ]
    for field in ("time", "q", "v", "u"):
        np.testing.assert_allclose(getattr(two, field), getattr(one, field), rtol=1e-12, atol=1e-15)


def test_clock_time_is_counted_from_the_first_row(tmp_path):
    columns = gentle() | {"time": gentle()["time"] + 1.7e9}
    trial = read_pendulum(write(tmp_path, {"t": columns})).trials[0]
    assert trial.time[0] == 0.0 and trial.time[-1] == pytest.approx(0.59, abs=1e-6)


def test_commands_stand_in_for_torques_and_say_so(tmp_path):
    columns = gentle()
    columns["tau1_commanded"], columns["tau2_commanded"] = columns.pop("tau1"), columns.pop("tau2")
    recording = read_pendulum(write(tmp_path, {"t": columns}))
    assert any("commands, not measured" in n for n in recording.notes)
    np.testing.assert_array_equal(recording.trials[0].u[:, 0], columns["tau1_commanded"])


def test_a_joint_without_motor_must_be_declared(tmp_path):
    columns = gentle()
    del columns["tau1"]
    assert "unactuated = [1]" in refusal(write(tmp_path, {"t": columns}))
    recording = read_pendulum(write(tmp_path, {"t": columns}, "unactuated = [1]\n" + META))
    assert not recording.trials[0].u[:, 0].any() and recording.driven == ("joint2",)
    np.testing.assert_array_equal(recording.trials[0].u[:, 1], columns["tau2"])


def test_linearized_model_has_default_geometry_and_a_mended_model_is_a_path(tmp_path):
    folder = write(
        tmp_path,
        {"t": gentle()},
        'task = "pendulum"\nmodel = "linearized"\nangle_zero = "upright"\n',
    )
    assert read_pendulum(folder).meta.rig.geometry == {"l1": 1.0, "l2": 1.0, "g": 9.81}
    (folder / "model.toml").write_text('model = "rigid_body"\n')
    (folder / "meta.toml").write_text(
        'task = "pendulum"\nmodel = "model.toml"\nangle_zero = "hanging"\n'
    )
    rig = read_pendulum(folder).meta.rig
    assert rig.model == "rigid_body" and rig.model_file == str((folder / "model.toml").resolve())


META_FAULTS = [
    (META + "[noise]\nq3 = 0.001\n", "unknown key 'q3' in [noise]"),
    (META.replace("angle_zero", "angel_zero"), "did you mean 'angle_zero'"),
    (META.replace('task = "pendulum"\n', ""), "'task' is missing"),
    (META.replace('model = "rigid_body"\n', ""), "'model' is missing"),
    (META.replace("rigid_body", "rigid-body"), "did you mean 'rigid_body'"),
    (META.replace("pendulum", "scooping"), "task = 'scooping' is unknown"),
    ('task = "push"\n', "task = 'push' is unknown; did you mean 'pushing'?"),
    ("task = [1]\n", "task must be text in quotes"),
    (META.replace("hanging", "down"), "angle_zero = 'down' is unknown"),
    (META.replace('"hanging"', "0.0"), "angle_zero must be text"),
    (META.replace("l1 = 0.3", "l1 = -0.3"), "geometry.l1 = -0.3"),
    (META.replace("l1 = 0.3", 'l1 = "0.3"'), "geometry.l1 must be a number"),
    (META.replace("l1 = 0.3", "l1 = nan"), "geometry.l1 = nan is not finite"),
    (
        META.replace("l1 = 0.3", f"l1 = 0x{'f' * 9000}"),
        "geometry.l1 = a number of thousands of digits is not finite",
    ),
    (META.replace("l1 = 0.3", "L1 = 0.3"), "did you mean 'l1'"),
    (META.replace("l1 = 0.3", "l1 = = 0.3"), "line 6"),
    (META + '[units]\ntime = "minutes"\n', "units.time = 'minutes' is unknown"),
    (META + '[units]\nq3 = "deg"\n', "unknown key 'q3' in [units]"),
    (META + "[known]\nm1 = true\n", "known.m1 must be a number"),
    ("geometry = 3\n" + META.split("[geometry]")[0], "geometry must be a table"),
    ("unactuated = [3]\n" + META, "unactuated must be a list"),
    (META.replace('"rigid_body"', '"nowhere.toml"'), "'nowhere.toml' does not exist"),
]


@pytest.mark.parametrize(("meta", "says"), META_FAULTS)
def test_a_wrong_meta_is_refused_with_its_key(tmp_path, meta, says):
    message = refusal(write(tmp_path, {"t": gentle()}, meta))
    assert "toml" in message and says in message


def test_a_folder_without_meta_or_trials_is_refused(tmp_path):
    assert "does not exist" in refusal(tmp_path / "none")
    (tmp_path / "meta.toml").write_text(META)
    assert "holds no .csv, .npz" in refusal(tmp_path)
    (tmp_path / "meta.toml").unlink()
    assert "meta.toml: missing" in refusal(tmp_path)
    (tmp_path / "actions.csv").write_text("trial,speed,angle\n1,0.6,0\n")
    assert 'it needs one line, task = "pushing" or' in refusal(tmp_path)
    (tmp_path / "file").write_text("")
    assert "is a file" in refusal(tmp_path / "file")


def edited(change):
    """CSV text of the gentle trial with `change(lines)` applied to its list of lines."""
    lines = csv_text(gentle()).splitlines()
    return "\n".join(change(lines)) + "\n"


def put(lines, row, column, value):
    """The lines with one cell replaced; `row` is the line number counted from 1."""
    cells = lines[row - 1].split(",")
    cells[column] = value
    return [*lines[: row - 1], ",".join(cells), *lines[row:]]


def each(lines, rows, column, value):
    """The same in several rows."""
    for row in rows:
        lines = put(lines, row, column, value)
    return lines


CSV_FAULTS = [
    ("", "is empty"),
    ("\n \n", "is empty"),
    (edited(lambda s: s[:1]), "has 0 data rows"),
    (edited(lambda s: s[:3]), "has 2 data rows"),
    (edited(lambda s: s[1:]), "add a header"),
    (edited(lambda s: put(s, 1, 1, "qq1")), "column 'q1' is missing; did you mean 'qq1'"),
    (edited(lambda s: put(s, 1, 5, "q1")), "column 'q1' appears 2 times"),
    (
        edited(lambda s: put(s, 1, 4, "speed")),
        "has velocities, but none of joint 'joint2'; add column v_joint2, or leave all out",
    ),
    (edited(lambda s: each(s, (12, 20, 28, 36), 3, "nan")), "line 12: column v1 holds no number"),
    (edited(lambda s: put(s, 12, 3, "inf")), "line 12: column v1 is inf"),
    (edited(lambda s: put(s, 12, 5, "off")), "line 12: column tau1 is 'off', not a number"),
    (edited(lambda s: each(s, (12, 20, 28, 36), 5, "")), "line 12: column tau1 holds no number"),
    (edited(lambda s: put(s, 12, 5, "1e30")), "line 12: column tau1 is 1e+30"),
    (edited(lambda s: [*s, "0.7,0.1"]), "line 62: has 2 values, the header has 7"),
    (edited(lambda s: [*s[:30], s[29], *s[30:]]), "line 31: time repeats"),
    (edited(lambda s: [*s[:29], s[30], s[29], *s[31:]]), "line 31: time runs backwards"),
    (edited(lambda s: [x.replace(",", ";").replace(".", ",") for x in s]), "decimal comma"),
    (edited(lambda s: [s[0], *(x.replace(".", ",") for x in s[1:])]), "decimal commas suspected"),
    (edited(lambda s: [x.replace(",", " ") for x in s]), "separate columns by commas"),
    (edited(lambda s: put(s, 9, 2, "0.1\x000")), "zero bytes"),
]


@pytest.mark.parametrize(("text", "says"), CSV_FAULTS)
def test_a_damaged_csv_is_refused_with_file_and_line(tmp_path, text, says):
    folder = write(tmp_path, {"good": gentle()})
    (folder / "bad.csv").write_text(text)
    message = refusal(folder)
    assert "bad.csv" in message and says in message


def test_a_damaged_npz_is_refused_and_pickles_are_never_loaded(tmp_path):
    folder = write(tmp_path, {})
    np.savez(folder / "t.npz", **(gentle() | {"q1": np.arange(3.0)}))
    assert "differ in length" in refusal(folder)
    np.savez(folder / "t.npz", **(gentle() | {"q1": np.array([{}] * 60, dtype=object)}))
    assert "t.npz" in refusal(folder)
    np.savez(folder / "t.npz", **(gentle() | {"q1": np.zeros((60, 2))}))
    assert "shape (60, 2)" in refusal(folder)
    (folder / "t.npz").write_bytes((folder / "t.npz").read_bytes()[:200])
    assert "no readable .npz" in refusal(folder)


def swing(rows=400, rate=100.0):
    """A swing of some 60 degrees, as a person would log it."""
    t = np.arange(rows) / rate
    q = np.stack([1.0 * np.sin(5 * t), 1.4 * np.sin(7 * t + 1)], axis=1)
    v = np.stack([5.0 * np.cos(5 * t), 9.8 * np.cos(7 * t + 1)], axis=1)
    return table(t, q, v, np.stack([np.sin(2 * t), np.cos(2 * t)], axis=1))


DEG = 180 / np.pi
UNIT_FAULTS = [
    ({"q1": DEG, "q2": DEG, "v1": DEG, "v2": DEG}, "degrees are suspected"),
    ({"q1": DEG, "q2": DEG}, "q1, q2 in degrees"),
    ({"v1": DEG, "v2": DEG}, "v1, v2 in deg/s"),
    ({"time": 1e3}, "milliseconds"),
    ({"time": 1e3, "v1": 1e-3, "v2": 1e-3}, "milliseconds"),
    ({"v1": 30 / np.pi, "v2": 30 / np.pi}, "revolutions per minute"),
]


@pytest.mark.parametrize(("scale", "says"), UNIT_FAULTS)
def test_a_wrong_unit_is_suspected_and_said(tmp_path, scale, says):
    columns = {k: x * scale.get(k, 1.0) for k, x in swing().items()}
    message = refusal(write(tmp_path, {"t": columns}))
    assert says in message and "[units]" in message and "t.csv" in message


def test_a_fast_arm_that_turns_over_is_not_taken_for_degrees(tmp_path):
    t = np.arange(800) / 200
    q = np.stack([20 * t, -25 * t + np.sin(9 * t)], axis=1)
    v = np.stack([np.full(800, 20.0), -25 + 9 * np.cos(9 * t)], axis=1)
    assert read_pendulum(write(tmp_path, {"t": table(t, q, v, np.zeros_like(q))})).samples == 800


def test_one_trial_that_ran_away_does_not_make_the_others_degrees(tmp_path):
    calm, far = swing(), {k: x * (1.0 if k == "time" else DEG) for k, x in swing().items()}
    assert len(read_pendulum(write(tmp_path, {"a": calm, "b": far, "c": calm})).trials) == 3


def test_a_stated_unit_of_angles_is_believed(tmp_path):
    far = {k: x * (1.0 if k == "time" else DEG) for k, x in swing().items()}
    folder = write(tmp_path, {"t": far})
    assert '"rad" if they are' in refusal(folder)
    with open(folder / "meta.toml", "a") as f:
        f.write('\n[units]\nangle = "rad"\n')
    assert float(np.abs(read_pendulum(folder).trials[0].q).max()) > 50


def test_known_parameters_are_checked_by_whoever_has_their_names():
    check_known("folder", {"m1": 1.0}, ("m1", "m2"))
    with pytest.raises(BadInput, match="did you mean 'm1'"):
        check_known("folder", {"m_1": 1.0}, ("m1", "m2"))


def test_reading_does_not_import_jax(tmp_path):
    write(tmp_path, {"t": gentle()})
    code = (
        "import sys; from adaptsim_jax.logs.pendulum import read_pendulum;from "
        f"adaptsim_jax.logs.quality.audit import audit;audit(read_pendulum({str(tmp_path)!r})); "
        "sys.exit('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(("rig", "trials"), [("rig_a", 8), ("rig_c", 9)])
def test_the_real_rigs_read(rig, trials):
    recording = read_pendulum(real_rig(rig))
    assert len(recording.trials) == trials and recording.driven
    assert all("tau_commanded" in t.extra and t.v is not None for t in recording.trials)
