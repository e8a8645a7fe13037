"""The audit of signals serves any mechanism: it warns, and refuses nothing that can be read."""

import shutil
from pathlib import Path

import numpy as np

import adaptsim_jax
from adaptsim_jax.attribution.conventions import check_signals
from adaptsim_jax.attribution.load import load

SAMPLE = Path(adaptsim_jax.__file__).parent / "attribution" / "sample" / "recording"


def spoiled(folder, change):
    """The machine of the sample with one trial changed, by `change(columns)` in place."""
    shutil.copytree(SAMPLE, folder)
    trial = folder / "trial_00.csv"
    rows = np.genfromtxt(trial, delimiter=",", names=True)
    columns = {name: rows[name].copy() for name in rows.dtype.names}
    change(columns)
    header = ",".join(columns)
    np.savetxt(
        trial, np.stack(list(columns.values()), 1), delimiter=",", header=header, comments=""
    )
    return load(folder)


def test_the_sample_is_not_doubted():
    found = check_signals(load(SAMPLE))
    assert found.warnings == [] and found.exclude == ()


def test_outliers_gaps_and_clipped_torques_are_warned_of(tmp_path):
    def spike(c):
        angle = next(name for name in c if name.startswith("q"))
        c[angle][150] += 1.0

    machine = spoiled(tmp_path / "spike", spike)
    (found,) = check_signals(machine).of("spike")
    assert (found.trial, found.severity) == ("trial_00", "warn")
    assert any("lone outlier" in line for line in check_signals(machine).warnings)
    assert np.isfinite(machine.tracks[0].q).all()  # all is used as it is

    def gap(c):
        for name in c:
            c[name] = np.delete(c[name], np.s_[200:230])

    assert check_signals(spoiled(tmp_path / "gap", gap)).of("gap")

    def clip(c):
        torque = next(name for name in c if name.startswith(("tau", "ctrl")))
        most = 0.4 * np.max(np.abs(c[torque]))
        c[torque] = np.clip(c[torque], -most, most)

    assert check_signals(spoiled(tmp_path / "clip", clip)).limits


def test_nothing_of_it_is_a_fault(tmp_path):
    def still(c):
        for name in c:
            if name != "time":
                c[name] = 1e-4 * c[name]

    found = check_signals(spoiled(tmp_path / "still", still))
    assert found.of("no_motion") and not found.fault and not found.exclude
