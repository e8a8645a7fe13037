"""Units in the headings of columns: read by `adaptsim init`, and told where nothing, or something
else, is declared.
"""

import re
import tomllib

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.guess import guess
from adaptsim_jax.logs.headings import Heading, heading
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion, write_csv

ARM = ("shoulder", "elbow")
NAMES = ModelNames(ARM)
M = motion(2)
SMALL = 0.1 * M["q"]
DEG = 180 / np.pi
MJCF = """<mujoco><worldbody><body>
  <joint name="shoulder" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.2"/>
  <body pos="0 0 -0.4"><joint name="elbow" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.2"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("written", "name", "unit"),
    [
        ("q1 [deg]", "q1", "deg"),
        ("Elbow Position (deg)", "Elbow Position", "deg"),
        ("Elbow Velocity [°/s]", "Elbow Velocity", "deg/s"),
        ("elbow_vel_rad_per_s", "elbow_vel", "rad/s"),
        ("elbow_vel_deg_s", "elbow_vel", "deg/s"),
        ("speed (Rad/Sec)", "speed", "rad/s"),
        ("speed (rad s^-1)", "speed", "rad/s"),
        ("elbow torque (N·m)", "elbow torque", "Nm"),
        ("tau2_mNm", "tau2", "mNm"),
        ("tau2_N_m", "tau2", "Nm"),
        ("t_ms", "t", "ms"),
        ("Time (µs)", "Time", "us"),
        ("pos_deg_1", "pos_1", "deg"),
        ("pos_deg1", "pos1", "deg"),
        ("i1_A", "i1", "A"),
        ("v2_rpm", "v2", "rpm"),
        ("belt position [mm]", "belt position", "mm"),
        # no unit
        ("q1", "q1", None),
        ("position_A", "position_A", None),
        ("observation.state[2]", "observation.state[2]", None),
        ("q [elbow]", "q [elbow]", None),
        ("deg", "deg", None),
        ("q_elbow", "q_elbow", None),
    ],
)
def test_a_heading_is_a_name_and_a_unit(written, name, unit):
    assert heading(written) == Heading(name, unit)


def test_a_joints_own_name_has_no_unit_in_it():
    assert heading("q_arm_deg", ("arm_deg",)) == Heading("q_arm_deg")
    assert heading("q_arm_deg", ("arm",)) == Heading("q_arm", "deg")
    assert heading("position (m)", ("m",)) == Heading("position (m)")


def columns(q, v=None, time="time [ms]", sizes=(DEG, DEG)):
    out = {time: 1e3 * M["time"]} | {
        name: size * SMALL[:, j] for j, (name, size) in enumerate(zip(q, sizes, strict=True))
    }
    return out | {name: 0.1 * M["v"][:, j] for j, name in enumerate(v or ())}


HEADED = {
    "brackets": columns(("q1 [deg]", "q2 [deg]")),
    "suffixes": columns(("q1_deg", "q2_deg"), time="t_ms"),
    "words": columns(("Shoulder Position (deg)", "Elbow Position (deg)"), time="Time (ms)"),
    "joints and units alone": columns(
        ("shoulder (deg)", "elbow (deg)"), ("shoulder (rad/s)", "elbow (rad/s)")
    ),
    "speeds of their own": columns(("q1_deg", "q2_deg"), ("v1", "v2")),
    "two units": columns(("q1 [deg]", "q2 [mrad]"), sizes=(DEG, 1e3)),
}


@pytest.mark.parametrize("name", HEADED)
def test_init_takes_units_from_headings(tmp_path, name):
    """Motion too small for its size to tell degrees by."""
    write_csv(tmp_path / "logs" / "run.csv", HEADED[name])
    (tmp_path / "arm.xml").write_text(MJCF)
    begun = begin(tmp_path / "logs", None, tmp_path / "arm.xml", {})
    assert begun.log is not None, begun.to_mend
    (trial,) = begun.log.trials
    np.testing.assert_allclose(trial.q, SMALL, atol=1e-12)
    np.testing.assert_allclose(trial.time, M["time"], atol=1e-12)
    if trial.v is not None:
        np.testing.assert_allclose(trial.v, 0.1 * M["v"], atol=1e-12)
    said = [line for line in begun.text.splitlines() if "the heading says so" in line]
    assert len(said) >= 2 and all("# guess" in line for line in said)
    assert ("say otherwise" in begun.text) == (name == "two units")


def test_an_archives_arrays_say_their_units_too(tmp_path):
    (tmp_path / "logs").mkdir()
    np.savez(tmp_path / "logs" / "run.npz", time=M["time"], joint_positions_deg=DEG * SMALL)
    (tmp_path / "arm.xml").write_text(MJCF)
    begun = begin(tmp_path / "logs", None, tmp_path / "arm.xml", {})
    assert tomllib.loads(begun.text)["units"] == {"angle": "deg"}
    np.testing.assert_allclose(begun.log.trials[0].q, SMALL, atol=1e-12)


def test_what_numbers_contradict_is_told():
    ranged = ModelNames(ARM, ranges=((-2.0, 2.0), None))
    time = np.arange(60) * 0.01

    def units(c, m=NAMES):
        return guess(c, m).units

    unit, why = units({"time (s)": 1e3 * time, "q1": SMALL[:, 0]})["time"]
    assert unit == "s" and "looks like ms" in why
    unit, why = units(
        {"time": time, "q1 (rad)": DEG * M["q"][:, 0], "q2 (rad)": M["q"][:, 1]}, ranged
    )["angle"]
    assert unit == "rad" and "its range in the model" in why
    fast = {"time": time} | {f"q{j + 1} (rad)": M["q"][:, j] for j in range(2)}
    unit, why = units(fast | {f"v{j + 1} (rad/s)": DEG * M["v"][:, j] for j in range(2)})[
        "velocity"
    ]
    assert unit == "rad/s" and "57" in why
    odd, why = units({"time": time, "q1 (mm)": SMALL[:, 0], "q2": SMALL[:, 1]})["q1"]
    assert odd.unit == "mm" and "no unit of angle" in why


WITHOUT = {
    "angle": (
        'q = ["a [deg]", "b [deg]"]',
        {"a [deg]": DEG * SMALL[:, 0], "b [deg]": DEG * SMALL[:, 1]},
        'angle = "deg"',
    ),
    "speeds beside angles": (
        'q = ["a (rad)", "b (rad)"]\nv = ["va (deg/s)", "vb (deg/s)"]',
        {
            "a (rad)": SMALL[:, 0],
            "b (rad)": SMALL[:, 1],
            "va (deg/s)": 6 * M["v"][:, 0],
            "vb (deg/s)": 6 * M["v"][:, 1],
        },
        'velocity = "deg/s"',
    ),
    "one of two": (
        'q = ["a_deg", "b_rad"]',
        {"a_deg": DEG * SMALL[:, 0], "b_rad": SMALL[:, 1]},
        'q1 = "deg"',
    ),
    "commands": (
        'q = ["a", "b"]\nctrl1 = "m (mNm)"',
        {"a": SMALL[:, 0], "b": SMALL[:, 1], "m (mNm)": 1e3 * SMALL[:, 0]},
        'ctrl1 = "mNm"',
    ),
}


@pytest.mark.parametrize("name", WITHOUT)
def test_a_heading_without_a_declared_unit_is_refused_and_read_as_advised(tmp_path, name):
    names, spoiled, line = WITHOUT[name]
    model = (
        ModelNames(ARM, actuators=(ActuatorName("m", "shoulder"),)) if name == "commands" else NAMES
    )
    table = {"time": M["time"]} | spoiled
    with pytest.raises(BadInput, match="and no unit is declared for it") as error:
        read_log(folder(tmp_path / "a", f"[columns]\n{names}\n", run=table), model)
    assert f"write {line} under [units]" in str(error.value) and "run.csv" in str(error.value)
    log = read_log(
        folder(tmp_path / "b", f"[columns]\n{names}\n[units]\n{line}\n", run=table), model
    )
    np.testing.assert_allclose(log.trials[0].q, SMALL, atol=1e-12)
    if name == "commands":
        np.testing.assert_allclose(log.trials[0].u[:, 0], SMALL[:, 0], atol=1e-12)
    assert not any("heading" in note for note in log.notes)
    if name == "speeds beside angles":
        return  # such speeds are in deg/s by their own numbers
    wrong = re.search(r", or (.*) if the heading is wrong", str(error.value))[1]
    log = read_log(
        folder(tmp_path / "c", f"[columns]\n{names}\n[units]\n{wrong}\n", run=table), model
    )
    np.testing.assert_array_equal(log.trials[0].q[:, 0], next(iter(spoiled.values())))


def test_a_heading_that_is_not_what_is_declared_is_told(tmp_path):
    meta = '[columns]\nq = ["a [deg]", "b (mm)"]\n[units]\nangle = "rad"\n'
    log = read_log(
        folder(
            tmp_path, meta, run={"time": M["time"], "a [deg]": SMALL[:, 0], "b (mm)": SMALL[:, 1]}
        ),
        NAMES,
    )
    assert "column 'a [deg]' is read in rad, as declared; its heading says deg" in log.notes
    np.testing.assert_array_equal(log.trials[0].q, SMALL)
