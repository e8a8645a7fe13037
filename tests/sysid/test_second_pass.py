"""From a recording to model.toml, and with that as the declared model to a second diagnosis; the next experiment."""

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mechanisms.model_file import read_model
from adaptsim_jax.sysid.design.excitation import library
from adaptsim_jax.sysid.pipeline import diagnose
from tests.sysid.small_rig import GEOMETRY, make_trials

FEW = tuple(e for e in catalogue("pendulum") if e.name in ("coulomb", "bias", "quadratic_drag"))
LEVEL = 0.03  # N m of dry friction on joint 2


def write(folder, seed: int, model: str):
    """Six trials of three seconds in files; joint 2 has dry friction."""
    folder.mkdir(parents=True)
    geometry = "".join(f"{k} = {v}\n" for k, v in GEOMETRY.items()) if not model.endswith(".toml") else ""
    table = f"[geometry]\n{geometry}" if geometry else ""
    (folder / "meta.toml").write_text(f'task = "pendulum"\nmodel = "{model}"\nangle_zero = "hanging"\n{table}')
    rub = lambda t, q, v, u: np.array([0.0, -LEVEL * np.tanh(v[1] / 1e-2)])
    for i, trial in enumerate(make_trials(seed, 6, 3.0, 100.0, noise=0.2, extra=rub, velocity=False)):
        rows = np.concatenate([trial.time[:, None], trial.q, trial.torque], 1)
        np.savetxt(folder / f"t{i}.csv", rows, delimiter=",", header="time,q1,q2,tau1,tau2", comments="")
    return folder


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """Report and folder of a first diagnosis."""
    root = tmp_path_factory.mktemp("loop")
    return diagnose(write(root / "data", 3, "rigid_body"), out=root / "out", effects=FEW), root


@pytest.mark.slow
def test_the_mended_model_is_written_with_the_effect_and_its_interval(first):
    report, root = first
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("coulomb", "joint2")]
    model = read_model(root / "out" / "model.toml")
    level = model.effects[0].parameters["level"]
    assert level.value == pytest.approx(LEVEL, rel=0.1) and level.low < level.value < level.high
    assert "coulomb/joint2/level" in model.names


@pytest.mark.slow
def test_the_next_experiment_is_a_csv_that_the_rig_can_run(first):
    report, root = first
    plan = report["next_experiment"]
    table = np.genfromtxt(root / "out" / plan["csv"], delimiter=",", names=True)
    assert table.dtype.names == ("time", "tau1", "tau2") and len(plan["separates"]) == 2
    recorded = [np.genfromtxt(p, delimiter=",", names=True) for p in (root / "data").glob("*.csv")]
    for name in ("tau1", "tau2"):
        assert np.abs(table[name]).max() <= max(np.abs(r[name]).max() for r in recorded) * 1.001
    assert np.all(np.diff(table["time"]) > 0) and plan["distance"] > 0


@pytest.mark.slow
def test_a_second_pass_on_the_mended_model_finds_nothing_more(first):
    _, root = first
    report = diagnose(write(root / "again", 4, "../out/model.toml"), effects=FEW)
    assert report["verdict"] in ("within_noise", "underpowered") and not report["effects"]
    assert report["declared"]["before"]["coulomb joint2 level"]["value"] == pytest.approx(LEVEL, rel=0.1)


def test_library_commands_stay_within_one_and_fade():
    shapes = library(0.01 * np.arange(600), np.random.default_rng(0))
    assert len(shapes) >= 10
    for name, shape in shapes.items():
        assert shape.shape == (600, 2) and np.abs(shape).max() <= 1.0, name
        assert np.all(shape[0] == 0.0) and np.abs(shape[-1]).max() < 0.1 and np.abs(shape).max() > 0.1, name
