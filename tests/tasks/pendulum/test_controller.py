"""A robot's loop that calls the controller of a mended policy gets the torques that the simulated
trial had.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile, write_model
from adaptsim_jax.tasks.one_shot import leaves_by_name
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    _ahead,
    along,
    lqr,
    make_world,
    plain_policy,
)
from adaptsim_jax.tasks.pendulum.controller import read_controller

THETA = {"m1": (1.5, "kg"), "m2": (1.4, "kg"), "b1": (1.2, "N m s/rad"), "b2": (1.8, "N m s/rad")}


def model(**effects) -> ModelFile:
    def value(x, unit):
        return Value(x, x, x, unit)

    declared = {k: value(*v) for k, v in THETA.items()}
    added = tuple(
        AddedEffect(name, "joint1", {p: value(*v) for p, v in given.items()})
        for name, given in effects.items()
    )
    return ModelFile(
        "pendulum", "linearized", "upright", {"l1": 1.0, "l2": 1.0, "g": 9.81}, declared, added
    )


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """A folder as `adaptsim robot next` leaves it, with a policy that predicts and cancels, and its
    simulated trial.
    """
    folder = tmp_path_factory.mktemp("robot")
    given = model(delay={"delay": (0.03, "s")}, bias={"torque": (4.0, "N m")})
    world = make_world(given)
    theta = jnp.asarray(given.theta(world.model.plant), jnp.float32)
    eff = jnp.asarray(given.effect_vector(world.model.layout), jnp.float32)
    plain = plain_policy(world, theta, eff)._replace(share=jnp.float32(1.0))
    _, loop = world.rollout(plain, theta, eff)
    gain, feed, A, B, _ = lqr(world, theta, eff, along(world, theta, eff, loop))
    policy = _ahead(world, plain._replace(gain=gain, feed=feed), A, B)
    write_model(folder / "model.toml", given)
    config.write(folder / "policy.toml", {"what": "trial 1 of 2", "policy": leaves_by_name(policy)})
    return folder, world, jax.jit(lambda: world.rollout(policy, theta, eff)[1])()


@pytest.mark.slow
def test_the_controller_commands_what_the_simulation_commanded(trial):
    folder, world, loop = trial
    controller = read_controller(folder)
    for _ in range(2):  # a second trial starts afresh
        controller.reset()
        said = np.asarray(loop.measured) - world.goal
        torque = np.array([controller(y, k * controller.period) for k, y in enumerate(said[:100])])
        scale = np.abs(np.asarray(loop.command[:100])).max()
        np.testing.assert_allclose(torque, loop.command[:100], atol=1e-4 * scale)
    gain = np.asarray(controller.policy.gain)
    alone = -said[:100] @ gain.T
    assert np.abs(torque - alone).max() > 0.1 * scale  # the gain alone is another policy


def test_a_plain_policy_is_refused(tmp_path):
    write_model(tmp_path / "model.toml", model())
    config.write(tmp_path / "policy.toml", {"policy": {"gain": [[1.0] * 4] * 2, "code": 0}})
    with pytest.raises(BadInput, match="holds no policy of a mended model"):
        read_controller(tmp_path)
