"""What a report says of servos that lack nothing, of limits and of friction."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.report import with_limits
from adaptsim_jax.attribution.sentences import soft_friction
from adaptsim_jax.report.diagnosis_words import headline, todo

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


def test_a_healthy_belt_lacks_nothing(belt):
    report = diagnose(belt)
    assert (report["verdict"], report["effects"]) == ("within_noise", [])
    error = report["error"]
    assert error["unit"] == "m" and error["before"] == error["after"]
    for stage in ("before", "after"):
        low, high = error["intervals"][stage]
        assert low <= error[stage] <= high


def test_friction_that_is_simulated_soft_is_not_said_to_leave_a_rest():
    named = [SimpleNamespace(candidate=SimpleNamespace(effect="coulomb"))]

    def group(rub):
        return SimpleNamespace(
            model=SimpleNamespace(tree=SimpleNamespace(friction_softness=np.array([rub])))
        )

    assert soft_friction(SimpleNamespace(groups=[group(0.0)]), named, True, 2.0)
    assert not soft_friction(SimpleNamespace(groups=[group(0.01)]), named, True, 2.0)


def test_where_nothing_was_fitted_no_fitted_value_is_recommended():
    error = {"before": 1.0, "noise_floor": 1.0}
    report = {"verdict": "within_noise", "effects": [], "error": error, "declared": {"after": {}}}
    assert "keep the file's values" in todo(report)
    assert "unlike its file's" not in headline(report)
    assert "unlike its file's" in headline(report | {"unlike_file": "mass 2 kg (file 1)"})


def test_a_limit_is_told_in_newton_metres():
    def row(value, low, high, unit):
        return {"value": value, "low": low, "high": high, "unit": unit}

    numbers = {"cut[lift]": row(0.95, 0.94, 0.97, "1"), "peak[lift]": row(80.0, 80.0, 80.0, "N m")}
    told = with_limits(numbers)
    assert told["limit[lift]"] == pytest.approx(row(4.0, 2.4, 4.8, "N m"))
    assert list(told) == ["limit[lift]", *numbers]
