"""Gains of position servos that a regression takes for others than the file's, and a whole fit
brings back.
"""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution import servo
from adaptsim_jax.attribution.diagnose import diagnose, with_rows
from adaptsim_jax.attribution.equation import commands
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.report import with_limits
from adaptsim_jax.attribution.sentences import soft_friction
from adaptsim_jax.report.diagnosis_words import headline, todo
from tests.attribution.test_equation import SERVO, prepared, servo_log

BELT = """<mujoco><option timestep="0.001"/><worldbody><body name="carriage">
<joint name="belt" type="slide" axis="1 0 0" damping="4"/><geom type="box" size=".05 .05 .03" mass="0.8"/></body></worldbody>
<actuator><position name="belt" joint="belt" kp="400" kv="20"/></actuator></mujoco>"""  # noqa: E501


@pytest.fixture(scope="module")
def belt(tmp_path_factory):
    """A healthy belt's log: three trials of 6 s at 100 Hz of the model in the file."""
    folder, model, rng = (
        tmp_path_factory.mktemp("belt"),
        mujoco.MjModel.from_xml_string(BELT),
        np.random.default_rng(7),
    )
    (folder / "belt.xml").write_text(BELT)
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "belt.xml"\n')
    for trial in range(3):
        data, rows = mujoco.MjData(model), []
        size, speed, phase = rng.uniform(0.03, 0.09, 3), rng.uniform(1, 14, 3), rng.uniform(0, 6, 3)
        for k in range(6000):
            if k % 10 == 0:
                data.ctrl[0] = size @ np.sin(speed * data.time + phase) * min(1.0, 2 * data.time)
                rows.append([data.time, data.qpos[0] + rng.normal(0, 2e-5), data.ctrl[0]])
            mujoco.mj_step(model, data)
        np.savetxt(
            folder / f"move_{trial}.csv",
            rows,
            "%.7f",
            ",",
            header="time,q_belt,target_belt",
            comments="",
        )
    return folder


@pytest.mark.long
def test_a_gain_that_the_fit_brings_back_to_the_files_is_the_files(belt):
    """Of a slide without weight only kp over mass is told: a regression is led astray by lags of a
    fraction of a row.
    """
    assert servo.calibrated(load(belt, None), 0.5)[1]  # it is misled
    report = diagnose(belt)
    assert (report["verdict"], report["effects"]) == ("within_noise", [])
    error = report["error"]
    assert error["unit"] == "m" and error["before"] == error["after"]
    for stage in ("before", "after"):
        low, high = error["intervals"][stage]
        assert low <= error[stage] <= high


def test_a_gain_that_stays_far_from_the_files_is_told_in_its_own_unit(belt):
    machine = load(belt, None)
    own = servo.Servo(0, 40.0, 2.0, 0.0, 0.0, 0.0, True, 9.0, 1.0, 0.1, 1.0, 1e-4)
    found = servo.with_gains(machine, [own])
    assert found.servo_times[0] == pytest.approx(0.1) and np.array_equal(
        found.actuator[:3], 0.1 * machine.actuator[:3]
    )

    def at(gain):
        return SimpleNamespace(entries=servo.servo_entries((own,)), values=np.array([gain]))

    assert servo.still_off(found, (own,), at(0.5)) == (own,)
    assert servo.still_off(found, (own,), at(8.9)) == ()
    (row,) = servo.servo_rows(found, machine, (own,), at(0.5), np.array([0.01]))
    kp = row["parameters"]["kp"]
    assert kp["unit"] == "N/m" and kp["value"] == pytest.approx(60.0) and "400" in kp["meaning"]
    assert kp["low"] == pytest.approx(
        40.0 * 1.49, rel=1e-6
    )  # by half of the interval that is given
    rows = {"damping of belt": {"value": 24.1, "file": 4.0}}
    servo.damped_by_file(rows, machine, (own,))
    assert rows["damping of belt"]["file"] == pytest.approx(24.0)  # kv is 20
    report = {
        "effects": [],
        "verdict": "within_noise",
        "message": "It simulates. Nothing need be added.",
    }
    with_rows(report, [row])
    assert (
        report["message"]
        == "kp is not the file's: belt 60 N/m. It simulates. Nothing more need be added."
    )


def test_friction_that_is_simulated_soft_is_not_said_to_leave_a_rest():
    named = [SimpleNamespace(candidate=SimpleNamespace(effect="coulomb"))]

    def group(rub):
        return SimpleNamespace(model=SimpleNamespace(tree=SimpleNamespace(rub=np.array([rub]))))

    assert soft_friction(SimpleNamespace(groups=[group(0.0)]), named, True, 2.0)
    assert not soft_friction(SimpleNamespace(groups=[group(0.01)]), named, True, 2.0)


def test_where_nothing_was_fitted_no_fitted_value_is_recommended():
    error = {"before": 1.0, "noise_floor": 1.0}
    report = {"verdict": "within_noise", "effects": [], "error": error, "declared": {"after": {}}}
    assert "keep the file's values" in todo(report)
    assert "unlike its file's" not in headline(report)
    assert "unlike its file's" in headline(report | {"unlike_file": "mass 2 kg (file 1)"})


def test_a_limit_that_the_file_lacks_is_no_softer_servo(tmp_path):
    """What its command errors show is told by the file's gains, cut off, far better than by any
    others.
    """
    own = {"kp": 30.0, "kv": 2.0, "friction": 0.0}
    folder = servo_log(tmp_path / "servo", **own, limit='forcerange="-0.4 0.4"')
    (folder / "model.xml").write_text(SERVO.format(**own, limit=""))
    machine, problem, _ = prepared(folder)
    (every,) = balances(problem, machine.tracks, trusted=False)
    (found,) = commands.servos(problem, every)
    assert found.file < 0.2 * found.left
    assert servo.calibrated(machine, 0.5)[1] == ()


def test_a_limit_is_told_from_a_gain():
    asked, clear = 10.0 * np.sin(np.linspace(0.0, 20.0, 500)), np.ones(500)
    assert np.abs(commands._limited(asked, np.clip(asked, -4.0, 4.0), clear)).max() < 0.1
    assert np.sqrt(np.mean(np.square(commands._limited(asked, 0.3 * asked, clear)))) > 0.5


def test_a_limit_is_told_in_newton_metres():
    def row(value, low, high, unit):
        return {"value": value, "low": low, "high": high, "unit": unit}

    numbers = {"cut[lift]": row(0.95, 0.94, 0.97, "1"), "peak[lift]": row(80.0, 80.0, 80.0, "N m")}
    told = with_limits(numbers)
    assert told["limit[lift]"] == pytest.approx(row(4.0, 2.4, 4.8, "N m"))
    assert list(told) == ["limit[lift]", *numbers]
