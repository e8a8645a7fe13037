"""The files of `examples/`, which the pages show, are taken by their readers (the package there: test_extend_page.py)."""

import shutil
from pathlib import Path

import pytest

from adaptsim_jax.adaptation.sweep_spec import read_sweep
from adaptsim_jax.logs.log_meta import read_log_meta
from adaptsim_jax.logs.meta import read_meta

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.slow
def test_a_sweep():
    sweep = read_sweep(EXAMPLES / "sweep.toml")
    assert len(sweep.members) == 16 * 4 * 8 * 2


def test_meta_of_a_mechanism(tmp_path):
    (tmp_path / "bags").mkdir()
    (tmp_path / "logs").mkdir()
    for name in ("bags/run.mcap", "logs/robot.xml"):
        (tmp_path / name).touch()
    meta = read_log_meta(shutil.copy(EXAMPLES / "meta_mechanism.toml", tmp_path / "logs" / "meta.toml"))
    assert meta.columns["tau_elbow"] == "motor2" and meta.fit == {"inertias": True, "damping": ["elbow"]}


def test_meta_of_a_pendulum():
    meta = read_meta(EXAMPLES / "meta_pendulum.toml")
    assert meta.known == {"b1": 0.01} and meta.unactuated == (1,)
