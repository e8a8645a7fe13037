"""The whole of `diagnose`, with the whole catalogue, on files: one hidden effect, and none."""

from pathlib import Path

import pytest

import adaptsim_jax.closeloop
from adaptsim_jax.closeloop.diagnose import command_of, diagnose
from adaptsim_jax.closeloop.recording import read_recording
from tests.generators import make_dataset, write_dataset

SAMPLE = Path(adaptsim_jax.closeloop.__file__).parent / "sample" / "recording"
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
def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    folder = write_dataset(make_dataset(20001, n_trials=4, seconds=4.0), tmp_path / "data")
    report = diagnose(folder)
    assert report["verdict"] in ("within_noise", "underpowered")
    assert report["effects"] == []
    assert report["error"]["before"] < 1.3 * report["error"]["noise_floor"]


@pytest.mark.slow
def test_a_known_mass_that_is_wrong_is_not_called_an_effect(tmp_path):
    data = make_dataset(301, n_trials=4, seconds=4.0, world="linearized")
    folder = Path(write_dataset(data, tmp_path / "data"))
    true = data.truth["declared"]["m2"]
    with (folder / "meta.toml").open("a") as file:
        file.write(f"\n[known]\nm2 = {1.2 * true}\n")
    report = diagnose(folder)
    assert report["verdict"] == "confounded_with_declared"
    assert report["effects"] == []
    assert f"{true:.3g}"[:4] in report["message"]


def test_the_report_names_the_command_that_repeats_it():
    recording = read_recording(SAMPLE)
    assert command_of(recording, 0, []) == f"adaptsim diagnose {SAMPLE}"
    assert command_of(recording, 3, ["spring", "bias"]).endswith(" --seed 3 --exclude spring bias")
