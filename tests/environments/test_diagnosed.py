"""`randomisation.toml`: what a report leaves open, and what training makes of it."""

import json

import jax
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.diagnosed import diagnosed
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import play_in, task_of
from adaptsim_jax.mend.randomisation import read_randomisation, write_randomisation
from adaptsim_jax.tasks.registry import make_task
from tests.environments import catalogue

LEVEL = {"value": 0.1, "low": 0.08, "high": 0.12, "unit": "N m"}
REPORT = {
    "effects": [
        {
            "name": "coulomb",
            "where": "shoulder",
            "joints": ["shoulder"],
            "parameters": {"level": LEVEL},
        }
    ],
    "declared": {"after": {}},
}


@pytest.fixture
def folder(tmp_path):
    catalogue.written(tmp_path, "stribeck")
    (tmp_path / "report.json").write_text(json.dumps(REPORT))
    write_randomisation(tmp_path)
    return tmp_path


def test_found_numbers_have_intervals_and_the_rest_a_reason(folder):
    rows = {row.name: row for row in read_randomisation(folder / "randomisation.toml").rows}
    level = rows["joint:shoulder.frictionloss"]
    assert (level.low, level.centre, level.high, level.source) == (0.08, 0.1, 0.12, "fitted")
    excess = rows["effect:shoulder.stribeck.excess"]
    assert excess.source == "found" and "interval is not known" in excess.because
    mass = rows["body:fore.mass"]
    assert mass.source == "file" and mass.centre == pytest.approx(0.5)
    assert mass.high - mass.low == pytest.approx(0.1) and "do not fix it" in mass.because
    assert "joint:elbow.frictionloss" not in rows  # the file has none


def test_servos_have_correlations_by_the_interval_of_their_quotient(tmp_path):
    catalogue.written(tmp_path, "servo")
    number = {"unit": "", "low": 8.0, "value": 9.0, "high": 10.0}
    quotient = {"unit": "s", "low": 0.0329, "value": 0.0333, "high": 0.0337}
    damping = {"unit": "", "low": 0.27, "value": 0.3, "high": 0.33}
    numbers = {"kp": number, "damping": damping, "damping_over_kp": quotient}
    row = {"name": "position_gain", "where": "elbow", "joints": ["elbow"], "parameters": numbers}
    after = {"kp of elbow": number}
    report = {"effects": [row], "declared": {"after": after}}
    (tmp_path / "report.json").write_text(json.dumps(report))
    write_randomisation(tmp_path)
    found = read_randomisation(tmp_path / "randomisation.toml")
    assert {r.name: r for r in found.rows}["actuator:elbow.gain"].low == 8.0
    assert found.names == ("actuator:elbow.gain", "joint:elbow.damping")
    assert found.matrix[0][1] > 0.98  # their quotient is known far better than they are


def test_omega_and_the_first_mean_of_e_are_the_diagnosis(folder):
    options = diagnosed({"fields": {"body:fore.mass": [0.1, 5.0]}}, folder)
    assert options["fields"]["body:fore.mass"] == pytest.approx([0.4, 0.6])
    assert options["fields"]["joint:shoulder.frictionloss"] == pytest.approx([0.06, 0.14])
    assert options["start"]["joint:shoulder.frictionloss"] == 0.1
    setting = setting_of(catalogue.arm(), EnvironmentConfig(**options))
    assert "effect:shoulder.stribeck.excess" in setting.space.names
    np.testing.assert_allclose(task_of(setting).first, 0.5, atol=0.01)
    off = {"body:fore.mass": 0.45}
    first = task_of(
        setting_of(catalogue.arm(), EnvironmentConfig(**options | {"start": off}))
    ).first
    assert first is not None and first[0] == pytest.approx(0.25) and first[1] == pytest.approx(0.5)


def test_targets_stay_the_declared_machine(folder):
    targets = {"real": {"joint:shoulder.frictionloss": 0.3}}
    options = diagnosed({"fields": {"body:fore.mass": [0.1, 5.0]}, "targets": targets}, folder)
    setting = setting_of(catalogue.arm(), EnvironmentConfig(**options))
    assert setting.sim.laws is not None
    target = setting.targets["real"]
    play, values = play_in(setting, target)
    numbers = dict(zip([f.name for f in play.fields], np.asarray(values), strict=True))
    declared = setting_of(
        catalogue.arm(), EnvironmentConfig(fields={"body:fore.mass": [0.1, 5.0]})
    ).sim
    assert play.sim.laws is None and target.engine == "mujoco"
    assert numbers["joint:shoulder.frictionloss"] == pytest.approx(0.3)
    assert numbers["body:fore.mass"] == pytest.approx(0.5)
    assert not any(name.startswith("effect:") for name in numbers)
    np.testing.assert_allclose(play.sim.native.body_mass, declared.native.body_mass)


def test_the_first_mean_of_e_is_known_within_a_traced_program(folder):
    config = EnvironmentConfig(**diagnosed({"fields": {"body:fore.mass": [0.1, 5.0]}}, folder))
    setting = setting_of(catalogue.arm(), config)
    first = jax.jit(lambda x: x + task_of(setting).first)(0.0)
    np.testing.assert_allclose(first, 0.5, atol=0.01)


def test_an_environment_takes_a_model_by_name_and_a_mass_on_a_table_does_not():
    with pytest.raises(BadInput, match=r"nowhere/model\.toml"):
        make_task("environment", {"env": "cartpole", "model": "nowhere/model.toml"})
    with pytest.raises(BadInput, match="unknown key 'model'"):
        make_task("scooping", {"model": "nowhere/model.toml"})


def test_a_delay_of_every_command_is_a_number_of_the_laws(tmp_path):
    catalogue.written(tmp_path, "delay")
    model = str(tmp_path / "model.toml")
    config = EnvironmentConfig(model=model, fields={"delay": [0.0, 0.03]})
    setting = setting_of(catalogue.arm(), config)
    delay = np.array([0.02], np.float32)
    _, laws = setting.sim.edit(setting.sim.model, setting.fields, delay)
    np.testing.assert_allclose(laws.values.effects["delay"]["delay"], 0.02)


def test_what_is_known_well_is_not_moved(folder):
    path = folder / "randomisation.toml"
    path.write_text(
        path.read_text()
        .replace("low = 0.08", "low = 0.0999")
        .replace("high = 0.12", "high = 0.1001")
    )
    assert "joint:shoulder.frictionloss" not in diagnosed({}, folder)["fields"]
    path.write_text('schema = 1\nmodel = "model.toml"\n')
    with pytest.raises(BadInput, match="nothing to adapt"):
        diagnosed({}, folder)
    path.unlink()
    with pytest.raises(BadInput, match="no such file; give the folder"):
        diagnosed({}, folder)
