"""`adaptsim robot` on a run of a mended model: `next` names the controller, and what it writes can
be run.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile, write_model
from adaptsim_jax.tasks.pendulum.controller import read_controller

SIZES = ("trajectories=4", "parallel=2", "updates=1", "capacity=100", "archive=100", "horizon=2")


@pytest.mark.slow
def test_next_says_what_has_to_be_run_and_it_runs(tmp_path, capsys):
    def value(x, unit):
        return Value(x, x, x, unit)

    declared = {"m1": value(1.5, "kg"), "m2": value(1.4, "kg")}
    declared |= {"b1": value(1.2, "N m s/rad"), "b2": value(1.8, "N m s/rad")}
    bias = AddedEffect("bias", "joint1", {"torque": value(4.0, "N m")})
    geometry = {"l1": 1.0, "l2": 1.0, "g": 9.81}
    write_model(
        tmp_path / "m.toml",
        ModelFile("pendulum", "linearized", "upright", geometry, declared, (bias,)),
    )
    sizes = [word for size in SIZES for word in ("--set", f"phase1.{size}")]
    run, folder = str(tmp_path / "run"), str(tmp_path / "robot")
    assert (
        main(["train", "pendulum", "--run", run, "--model", str(tmp_path / "m.toml"), *sizes]) == 0
    )
    capsys.readouterr()
    assert main(["robot", "new", run, "--dir", folder, "--starts", "1", "--iterations", "1"]) == 0
    said = capsys.readouterr().out
    assert "torque = -gain" not in said and "it is more than its gain" in said
    assert re.search(r"read_controller\('(.*)'\)", said).group(1) == folder
    controller = read_controller(folder)
    torque = controller([-np.pi, 0.0, 0.0, 0.0], 0.0)
    assert torque.shape == (2,) and np.all(np.isfinite(torque)) and np.any(torque != 0)
