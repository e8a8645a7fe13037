"""The whole of `diagnose`, with the whole catalogue, on files: one hidden effect, and none."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import adaptsim_jax
from adaptsim_jax.commands.diagnose import diagnose
from tests.generators import Spec, make_datasets, write_dataset

SAMPLE = Path(adaptsim_jax.__file__).parent / "logs" / "sample" / "recording"
LEVEL = 0.294  # N m of Coulomb friction at joint 1, put in by the generator (sample/README.md)


@pytest.mark.slow
def test_the_samples_friction_is_named_and_sized(tmp_path):
    report = diagnose(SAMPLE, out=tmp_path)
    assert report["verdict"] == "explained"
    (effect,) = report["effects"]
    assert (effect["name"], effect["where"]) == ("coulomb", "joint1")
    assert effect["parameters"]["level"]["value"] == pytest.approx(LEVEL, rel=0.02)
    error = report["error"]
    assert error["after"] < 0.05 * error["before"]
    assert error["after"] < 1.5 * error["noise_floor"]
    for name in ("report.json", "report.html", "model.toml", "next_experiment.csv"):
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.slow
def test_of_two_effects_that_hide_each_other_both_are_named(tmp_path):
    """Friction at one joint and play at the other: the declared fit goes astray, and no single effect helps it."""
    two = (("coulomb", 2, 5.0), ("backlash", 1, 4.0))
    (data,) = make_datasets([Spec(906, n_trials=4, seconds=4.0, effects=two, world="linearized")])
    report = diagnose(write_dataset(data, tmp_path / "data"), follow_up=False)
    assert report["verdict"] == "explained", report["message"]
    assert {(e["name"], e["where"]) for e in report["effects"]} == {("coulomb", "joint2"), ("backlash", "joint1")}
    sizes = {"coulomb": "level", "backlash": "gap"}
    true = {e["name"]: e["parameters"]["size"] for e in data.truth["effects"]}
    for effect in report["effects"]:
        assert effect["parameters"][sizes[effect["name"]]]["value"] == pytest.approx(true[effect["name"]], rel=0.05)
    assert report["error"]["after"] < 2.0 * report["error"]["noise_floor"]


def test_what_an_earlier_run_left_in_the_folder_goes(tmp_path):
    """A recording that contradicts itself has no model; that of the run before is not this report's."""
    stale = [tmp_path / "out" / name for name in ("model.toml", "leading.toml", "next_experiment.csv")]
    (tmp_path / "out").mkdir()
    for file in stale:
        file.write_text("old")
    data = shutil.copytree(SAMPLE, tmp_path / "data")
    for trial in data.glob("*.csv"):
        rows = np.genfromtxt(trial, delimiter=",", names=True)
        rows["v1"] *= -1.0
        np.savetxt(trial, rows, delimiter=",", header=",".join(rows.dtype.names), comments="")
    assert diagnose(data, out=tmp_path / "out")["verdict"] == "data_fault"
    assert not any(file.exists() for file in stale)
