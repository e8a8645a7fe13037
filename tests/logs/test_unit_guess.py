"""Units that nobody wrote: what backs a guess, and what is a question only; ways of sliding joints
that are no metres.
"""

import re
import tomllib

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from adaptsim_jax.logs.unit_guess import Question, guess_units
from tests.logs.log_files import folder, write_csv

TIME = np.arange(300) * 0.01
SWING = np.sin(2 * np.pi * TIME)
DEG = 180 / np.pi
SLIDER = """<mujoco><worldbody><body>
  <joint name="belt" type="slide" axis="1 0 0" {}/><geom size="0.1"/></body></worldbody>
  <actuator><position joint="belt" kp="100" kv="10"/></actuator></mujoco>"""
RANGE = 'range="-.4 .4"'


def of(q, model, **more):
    return guess_units({"time": TIME, "q_a": q, **more}, model.joints, False, model)


def servo(limits=None, slides=False, kind="position"):
    return ModelNames(
        ("a",),
        ("a",) if slides else (),
        actuators=(ActuatorName("m", "a", kind),),
        ranges=(limits,),
    )


def test_a_wheel_that_turns_a_few_times_is_asked_about():
    turns = 33.0 * np.sin(0.5 * TIME)
    (unit, why) = of(turns, servo(kind="motor"))["angle"]
    assert unit == Question("deg") and "turns" in why
    assert guess_units({"time": TIME, "q": turns})["angle"][0] == Question("deg")


def test_a_size_is_a_guess_where_something_backs_it():
    arm = 40.0 * SWING
    assert of(arm, servo((-1.0, 1.0), kind="motor"))["angle"][0] == "deg"  # the range
    assert of(arm, servo())["angle"][0] == "deg"  # a servo that would turn 40 rad/s
    assert of(arm, servo(kind="motor"))["angle"][0] == Question("deg")
    rate = np.gradient(arm, TIME)
    assert of(arm, servo(kind="motor"), v_a=rate / DEG)["angle"][0] == "deg"  # speeds in rad/s
    assert of(SWING, servo((-1.0, 1.0))) == {}


@pytest.mark.parametrize(
    ("reach", "limits", "unit"),
    [
        (0.3, (-0.4, 0.4), None),
        (135.0, (-0.4, 0.4), "mm"),
        (30.0, (0.0, 0.5), Question("mm")),  # or cm
        (135.0, None, Question("mm")),
        (2.0, None, None),
    ],
)
def test_ways_of_a_sliding_joint_are_lengths(reach, limits, unit):
    found = of(reach * SWING, servo(limits, slides=True))
    assert "angle" not in found
    assert found.get("length", (None,))[0] == unit


def test_speeds_tell_the_unit_of_ways():
    ways = 135.0 * SWING
    found = of(ways, servo(slides=True), v_a=np.gradient(ways, TIME) / 1e3)
    assert {key: unit for key, (unit, _) in found.items()} == {"length": "mm", "v_a": "m/s"}


@pytest.mark.parametrize(("headings", "named"), [(True, True), (False, True), (False, False)])
def test_a_belt_in_millimetres(tmp_path, headings, named):
    """By its heading, by the model's range, and where the model is the only one beside the data."""
    q, u = ("belt position [mm]", "belt setpoint [mm]") if headings else ("q_belt", "target_belt")
    write_csv(tmp_path / "run.csv", {"time": TIME, q: 150 * SWING, u: 155 * SWING})
    (tmp_path / "slider.xml").write_text(SLIDER.format(RANGE))
    begun = begin(tmp_path, None, tmp_path / "slider.xml" if named else None, {})
    assert tomllib.loads(begun.text)["units"] == {"length": "mm"}
    assert "angle" not in begun.text.partition("[units]")[2].partition("[angles]")[0]
    np.testing.assert_allclose(begun.log.trials[0].q[:, 0], 0.15 * SWING, atol=1e-12)


@pytest.mark.parametrize(("times", "units"), [(375.0, ["mm"]), (100.0, ["mm", "cm"])])
def test_ways_far_beyond_the_declared_range_are_refused_and_read_as_advised(
    tmp_path, times, units, capsys
):
    table = {"time": TIME, "q_belt": 0.4 * times * SWING, "target_belt": 0.41 * times * SWING}
    data = folder(tmp_path / "a", 'model = "slider.xml"\n', run=table)
    (data / "slider.xml").write_text(SLIDER.format(RANGE))
    assert main(["diagnose", str(data), "--out", str(tmp_path / "out")]) == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert "belt slides as far as" in told and "times its declared range" in told
    assert re.findall(r'length = "(\w+)"', told) == [*units, "m"]
    for unit, size in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)):
        log = read_log(
            folder(
                tmp_path / unit,
                f'model = "../a/slider.xml"\n[units]\nlength = "{unit}"\n',
                run=table,
            )
        )
        np.testing.assert_allclose(log.trials[0].q[:, 0], size * table["q_belt"], rtol=1e-12)


@pytest.mark.parametrize(("reach", "limits"), [(2.0, (-0.4, 0.4)), (50.0, None)])
def test_ways_that_may_be_no_metres_are_told(tmp_path, reach, limits):
    table = {"time": TIME, "q_a": reach * SWING, "target_a": 1.01 * reach * SWING}
    log = read_log(folder(tmp_path, "", run=table), servo(limits, slides=True))
    assert any('if that is no metres, write length = "mm"' in note for note in log.notes)
    within = read_log(folder(tmp_path / "b", "", run=table), servo((-100.0, 100.0), slides=True))
    assert not any("metres" in note for note in within.notes)


def test_a_unit_of_commands_acts_and_an_unknown_one_is_refused(tmp_path):
    model = servo(kind="motor")
    table = {"time": TIME, "q_a": SWING, "ctrl_m": 5.0 * SWING}
    for line, size in (
        ("ctrl = 0.02", 0.02),
        ('ctrl_m = "mNm"', 1e-3),
        ("", 1.0),
        ("torque = 0.02", 1.0),
    ):
        log = read_log(folder(tmp_path, f"[units]\n{line}\n", run=table), model)
        np.testing.assert_allclose(log.trials[0].u[:, 0], 5.0 * size * SWING, rtol=1e-12)
    with pytest.raises(BadInput, match="ctrl_m is in per cent of a range"):
        read_log(folder(tmp_path, '[units]\nctrl_m = "percent"\n', run=table), model)
