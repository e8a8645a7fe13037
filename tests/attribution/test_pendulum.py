"""The double pendulum of `task = "pendulum"` as a mechanism."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import INERTIA, TILT
from adaptsim_jax.attribution.pendulum import base_parameters
from adaptsim_jax.attribution.pendulum_diagnosis import diagnose_pendulum
from adaptsim_jax.attribution.problem import tilted
from adaptsim_jax.attribution.replay import replay
from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.mechanisms import dynamics
from adaptsim_jax.mechanisms.double_pendulum.plant import double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from tests.logs.measured_files import real_rig

THETA = np.array([0.12, 0.03, 0.4, 0.12, 0.01, 0.02])
L1 = 0.3


@pytest.mark.parametrize(("zero", "down"), [("hanging", 1.0), ("upright", -1.0)])
def test_written_as_mjcf_it_has_the_same_base_parameters_and_gravity(tmp_path, zero, down):
    file = tmp_path / "double_pendulum.xml"
    file.write_text(double_pendulum_mjcf(THETA, {"l1": L1}, zero))
    tree = read_mechanism(file).tree
    np.testing.assert_allclose(
        base_parameters(np.asarray(tree.inertial), L1, down), THETA[:4], rtol=1e-7
    )
    np.testing.assert_allclose(tree.damping, THETA[4:])
    q = np.array([0.4, -1.1])
    with jax.enable_x64(True):
        for angle in (0.0, 0.2):
            turned = tilted(np.asarray(tree.gravity), 0.0, angle)
            told = dynamics.gravity_force(
                tree, jnp.asarray(tree.inertial), jnp.asarray(q), jnp.asarray(turned)
            )
            outer = GRAVITY * THETA[3] * np.sin(q.sum() + angle)
            right = [GRAVITY * THETA[2] * np.sin(q[0] + angle) + outer, outer]
            np.testing.assert_allclose(np.abs(told), np.abs(right), rtol=1e-6)


@pytest.mark.slow
def test_on_a_real_rig_friction_holds_out_and_the_files_say_the_same(tmp_path):
    """Four trials of rig_a: what is named is dry friction, and on the other trials it helps."""
    folder = real_rig("rig_a")
    recording = read_pendulum(folder)
    some, others = recording.trials[:4], [t.name for t in recording.trials[4:]]
    report = diagnose_pendulum(recording.pick([t.name for t in some]), out=tmp_path)
    assert report["verdict"] == "partly_explained"
    assert "coulomb" in {e["name"] for e in report["effects"]}
    held_out = {
        m: replay(load(folder, tmp_path / m).without([t.name for t in some])).as_dict()
        for m in FILES
    }
    assert set(held_out["model.toml"]["trials"]) == set(others)
    for mended in (
        "model.toml",
        "model.xml",
    ):  # the second has a look-alike for what MJCF cannot hold
        assert held_out[mended]["median"] < 0.7 * held_out["declared.xml"]["median"]
    if {e["name"] for e in report["effects"]} <= {
        "viscous",
        "coulomb",
        "armature",
        "spring",
        TILT,
        INERTIA,
    }:
        assert held_out["model.xml"]["median"] == pytest.approx(
            held_out["model.toml"]["median"], rel=0.05
        )


FILES = ("declared.xml", "model.xml", "model.toml")
