"""Torque and dry friction that depend on the angle in any way."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.effects.base import Motion
from adaptsim_jax.effects.joints.forces import BY_ANGLE, NODES, angle_friction, angle_torque
from tests.generators.mechanism_worlds import write_world

NODE = np.linspace(-0.5, 1.5, NODES)  # rad


def at(q, values):
    """Parameters of one joint [1, 1] whose nodes have `values`, and a motion through angles q."""
    p = {f"at{k}": jnp.full((1, 1), float(z)) for k, z in enumerate(values)}
    p |= {"low": jnp.full((1, 1), NODE[0]), "high": jnp.full((1, 1), NODE[-1])}
    q = jnp.asarray(q, float)[None]
    return p, Motion(q, q, q, q, lambda q: q, q, q)


@pytest.mark.parametrize(
    ("law", "of"), [(angle_torque, lambda z: z), (angle_friction, lambda z: z.level)]
)
def test_it_is_linear_between_its_nodes_and_constant_beyond(law, of):
    values, q = np.sin(3.0 * NODE), np.linspace(-1.0, 2.0, 61)
    p, motion = at(q, values)
    assert np.allclose(of(law(p, motion))[0], np.interp(q, NODE, values), atol=1e-5)


def test_it_is_off_with_all_its_nodes_at_nothing():
    for effect in BY_ANGLE:
        assert effect.describes and [a.default for a in effect.amplitudes] == [0.0] * NODES


@pytest.mark.slow
def test_a_magnet_near_one_angle_is_described_and_not_called_cogging(tmp_path):
    world = write_world(tmp_path / "world", "single", 701, effect="magnet")
    (hidden,) = json.loads((world / "truth.json").read_text())["effects"]
    report = diagnose(world / "recording")
    assert [(e["name"], e["joints"]) for e in report["effects"]] == [
        ("angle_torque", hidden["joints"])
    ]
    assert report["error"]["after"] < 1.5 * report["error"]["noise_floor"]
