"""Recordings as files, conditions, seeds, disguises, suites, and the sample that ships with the
package.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.generators import Spec, make_dataset, make_datasets, make_sample, write_dataset
from tests.generators.suites import POWER_MULTIPLES, SUITES, disguise, outside_cases

SHORT = {"n_trials": 2, "seconds": 1.5, "angle_zero": "hanging"}


def read(file: Path) -> dict[str, np.ndarray]:
    names = file.read_text().partition("\n")[0].split(",")
    return dict(zip(names, np.loadtxt(file, delimiter=",", skiprows=1).T, strict=True))


def test_files_hold_the_recording_and_not_the_truth(tmp_path):
    ds = make_dataset(5, "clean", [("coulomb", 2, 4.0)], declare_noise=True, **SHORT)
    folder = write_dataset(ds, tmp_path / "rig")
    assert sorted(f.name for f in folder.iterdir()) == ["meta.toml", "trial_00.csv", "trial_01.csv"]
    assert tomllib.loads((folder / "meta.toml").read_text()) == ds.meta
    assert set(ds.meta) == {"task", "model", "angle_zero", "geometry", "noise"}
    for i, trial in enumerate(ds.trials):
        back = read(folder / f"trial_{i:02d}.csv")
        assert list(back) == ["time", "q1", "q2", "v1", "v2", "tau1", "tau2"]
        for name, column in trial.items():
            np.testing.assert_allclose(back[name], column, rtol=1e-7, atol=1e-9)


def test_a_seed_is_one_recording_and_one_rig_under_all_conditions():
    a, b = (make_dataset(5, "coloured", **SHORT) for _ in range(2))
    c = make_datasets([Spec(6, "clean", **SHORT), Spec(5, "coloured", **SHORT)])[1]
    d = make_dataset(5, "high_noise", [("spring", 1, 3.0)], **SHORT)
    for x in (b, c):
        for left, right in zip(a.trials, x.trials, strict=True):
            for name in left:
                np.testing.assert_allclose(left[name], right[name], rtol=0, atol=1e-9)
    assert a.truth["rig"] == d.truth["rig"]
    assert make_dataset(7, **SHORT).truth["rig"] != a.truth["rig"]


def test_conditions_are_what_they_say():
    names = (
        "quantised",
        "jitter",
        "slow",
        "few_short",
        "closed_loop",
        "coloured",
        "high_noise",
        "low_noise",
    )
    made = dict(zip(names, make_datasets([Spec(8, c, **SHORT) for c in names]), strict=True))
    bits = made["quantised"].truth["sensor"]["bits"]
    q = made["quantised"].trials[0]["q1"] * 2**bits / (2 * np.pi)
    assert 12 <= bits <= 16 and np.abs(q - np.round(q)).max() < 1e-6
    assert "v1" not in made["quantised"].trials[0]
    gaps = np.concatenate([np.diff(t["time"]) for t in made["jitter"].trials])
    assert gaps.min() > 0 and np.std(gaps) > 2e-4 and gaps.max() > 0.008
    assert 0.01 <= np.diff(made["slow"].trials[0]["time"]).min() <= 0.02
    assert [len(t["time"]) for t in made["few_short"].trials] == [600] * 3
    assert set(made["closed_loop"].truth["kinds"]) == {"tracking"}
    assert 0.01 <= made["coloured"].truth["sensor"]["disturbance_share"] <= 0.05
    rough = [np.diff(made[c].trials[0]["q1"], 3).std() for c in ("high_noise", "low_noise")]
    assert rough[0] > 5 * rough[1]


def test_sensor_noise_has_the_declared_spread():
    ds = make_dataset(9, "high_noise", declare_noise=True, **SHORT)
    for channel, std in ds.meta["noise"].items():
        x = np.concatenate([np.diff(t[channel], 4) for t in ds.trials])
        assert x.std() / np.sqrt(70) == pytest.approx(std, rel=0.2), (
            channel
        )  # 70 = sum of squared binomials


def test_coloured_disturbance_is_not_in_the_file_but_in_the_motion():
    quiet, shaken = make_datasets([Spec(8, c, **SHORT) for c in ("clean", "coloured")])
    np.testing.assert_allclose(quiet.trials[0]["tau1"], shaken.trials[0]["tau1"])
    assert np.abs(quiet.trials[0]["q1"] - shaken.trials[0]["q1"]).max() > 5e-3


def test_disguises_keep_the_measurements():
    ds = make_dataset(5, "clean", **SHORT)
    twice, mixed = disguise(ds, "duplicated", 5), disguise(ds, "shuffled", 5)
    assert len(twice.trials) == 4 and len(mixed.trials) == 2
    ms = disguise(ds, "milliseconds", 5)
    np.testing.assert_allclose(ms.trials[0]["time"], 1e3 * ds.trials[0]["time"])
    assert ms.meta["units"] == {"time": "ms"} and "units" not in ds.meta
    smooth = disguise(ds, "filtered", 5).trials[0]["v1"]
    assert 0 < np.abs(smooth - ds.trials[0]["v1"]).max() < 0.1


def test_suites_are_reproducible_and_their_seeds_apart():
    for name, cases in SUITES.items():
        first, again, scoring = cases(12, 0), cases(12, 0), cases(12, 10000)
        assert first == again and len({c.name for c in first}) == len(first)
        assert not {c.spec.seed for c in first} & {c.spec.seed for c in scoring}, name
        for c in first:
            assert all(
                c.variant or m >= (POWER_MULTIPLES[0] if name == "power" else 3.0)
                for _, _, m in c.spec.effects
            )
    for c in outside_cases(60, 0):
        assert c.spec.effects[0][0] in c.exclude
        assert ("tilt" in c.exclude) == ("encoder_offset" in c.exclude)


@pytest.mark.slow
def test_the_shipped_sample_is_what_its_script_makes(tmp_path):
    make_sample.main(tmp_path)
    shipped = make_sample.FOLDER
    files = sorted(f.relative_to(shipped) for f in (shipped / "recording").iterdir())
    assert [f.name for f in files] == ["meta.toml", *(f"trial_{i:02d}.csv" for i in range(4))]
    assert sum((shipped / f).stat().st_size for f in files) < 400_000
    assert (tmp_path / "README.md").read_text() == (shipped / "README.md").read_text()
    for f in files[1:]:
        ours, theirs = read(tmp_path / f), read(shipped / f)
        for name in ours:
            np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-4, atol=1e-5)
