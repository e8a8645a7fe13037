"""The task on a mended model: the same task where nothing was added, and policies that make use of
what was.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum import linear as plain_model
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.pendulum.augmented import in_world, make_mended_pendulum, mended_space
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    descended,
    make_world,
    plain_policy,
    train_policy,
)
from adaptsim_jax.tasks.registry import make_task

THETA = {"m1": (1.5, "kg"), "m2": (1.4, "kg"), "b1": (1.2, "N m s/rad"), "b2": (1.8, "N m s/rad")}


def mended(*effects: tuple[str, str, dict[str, tuple[float, str]]]) -> ModelFile:
    def number(v):
        return Value(v[0], v[0], v[0], v[1])

    declared = {k: number(v) for k, v in THETA.items()}
    added = tuple(AddedEffect(n, w, {k: number(v) for k, v in p.items()}) for n, w, p in effects)
    return ModelFile(
        "pendulum", "linearized", "upright", {"l1": 1.0, "l2": 1.0, "g": 9.81}, declared, added
    )


SPRING = ("spring", "joint2", {"stiffness": (6.0, "N m/rad"), "preload": (4.0, "N m")})
CASES = {
    "spring": SPRING,
    "gain": ("torque_gain", "joint1", {"gain": (-0.4, "1")}),
    "delay": ("delay", "joint1", {"delay": (0.03, "s")}),
}


def costs(given: ModelFile, *trainings):
    """Cost in the model of what each training makes there."""
    world = make_world(given)
    theta = jnp.asarray(given.theta(world.model.plant), jnp.float32)
    eff = jnp.asarray(given.effect_vector(world.model.layout), jnp.float32)
    run = jax.jit(
        lambda: [world.rollout(train(world, theta, eff), theta, eff)[0].cost for train in trainings]
    )
    return [float(c) for c in run()]


@pytest.mark.slow
def test_descent_beats_the_stand_ins_for_dry_friction():
    """No affine force is dry friction: gains found by descent cost less than any that were
    tried.
    """
    given = mended(("coulomb", "joint1", {"level": (5.4, "N m")}))
    tried, after = costs(given, train_policy, descended)
    assert after < 0.99 * tried


@pytest.mark.slow
def test_without_effects_it_is_the_plain_task():
    """Commands are held for 5 ms here and continuous there: the optimal cost moves by less than 2
    %.
    """
    before, after = costs(mended(), plain_policy, train_policy)
    params = jnp.array([v for v, _ in THETA.values()], jnp.float32)
    exact = float(plain_model.rollout(params, plain_model.optimal_gain(params).gain).cost)
    assert before == after
    assert before == pytest.approx(exact, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_a_policy_that_knows_the_effect_is_cheaper(name):
    before, after = costs(mended(CASES[name]), plain_policy, train_policy)
    assert after < before * (1 - 1e-3)


def test_omega_has_the_effects_amplitudes_around_what_was_fitted():
    space, keys = mended_space(mended(SPRING))
    assert space.names == (
        "m1",
        "m2",
        "b1",
        "b2",
        "spring_joint2_stiffness",
        "spring_joint2_preload",
    )
    assert keys[-1] == ("spring", "joint2", "preload")
    low, high = space.parameters[4].low, space.parameters[4].high
    assert 0.0 <= low < 6.0 < high


@pytest.mark.slow
def test_it_is_a_task_as_any_other():
    task = make_mended_pendulum(mended(SPRING))
    key = jax.random.key(0)
    target = jnp.asarray(task.space.values(task.settings["fitted"]), jnp.float32)

    @jax.jit
    def adapt(u):
        policy = task.train(key, gaussian(task.space, u), task.init_policy(key))
        trajectory = task.rollout(key, policy, target)
        return (
            policy,
            trajectory,
            task.reward(trajectory, task.reference(target)),
            task.observe(trajectory),
        )

    policy, trajectory, reward, seen = adapt(task.space.unit(target))
    assert jax.tree.structure(policy) == jax.tree.structure(task.init_policy(key))
    assert float(reward) == pytest.approx(1.0, abs=1e-3) and seen.shape == (task.obs_dim,)
    assert int(trajectory.code) == 0
    off = adapt(task.space.unit(target) + jnp.array([0.3, -0.3, 0, 0, 0.4, -0.4]))[2]
    assert float(off) < float(reward)


@pytest.mark.slow
def test_a_plain_run_meets_a_mended_target():
    task = make_task("pendulum", {})
    params, there = in_world(task, mended(SPRING))
    key = jax.random.key(0)
    policy = task.train(
        key, gaussian(task.space, task.space.unit(jnp.asarray(params, jnp.float32))), None
    )
    reward = jax.jit(
        lambda p: there.reward(there.rollout(key, p, params), there.reference(params))
    )(policy)
    assert np.allclose(params, [v for v, _ in THETA.values()])
    assert float(reward) < 0.999


def test_bad_options_and_targets_are_told():
    with pytest.raises(BadInput, match="no mended model"):
        make_task("pendulum", {"model": 3})
    with pytest.raises(BadInput, match="missing"):
        make_task("pendulum", {"model": {"task": "pendulum", "schema": 2}})
    for gain in (float("nan"), 0, 10**400):
        with pytest.raises(BadInput, match=r"reward_gain = .* must be a positive number"):
            make_task("pendulum", {"model": {"task": "pendulum"}, "reward_gain": gain})
    rigid = ModelFile(
        "pendulum",
        "rigid_body",
        "hanging",
        {"l1": 0.3, "g": 9.81},
        {"p1": Value(0.1, 0.1, 0.1, "kg m^2")},
    )
    with pytest.raises(BadInput, match="p1"):
        in_world(make_task("pendulum", {}), rigid)


@pytest.mark.slow
def test_hardly_any_policy_earns_more_than_1_on_a_rigid_body():
    """The target's own policy is no reference there: the gain is optimal near the goal, not for the
    swing-up.
    """
    theta = {"p1": 0.376, "p3": 0.087, "h1": 0.762, "h2": 0.249, "b1": 0.017, "b2": 0.027}
    units = {"p": "kg m^2", "h": "kg m", "b": "N m s/rad"}
    declared = {k: Value(v, v, v, units[k[0]]) for k, v in theta.items()}
    geometry = {"l1": 0.411, "l2": 0.414, "g": 9.81}
    task = make_mended_pendulum(ModelFile("pendulum", "rigid_body", "hanging", geometry, declared))
    u = jax.random.uniform(jax.random.key(0), (12, task.space.dim))
    policies = jax.jit(jax.vmap(lambda u: task.train(None, gaussian(task.space, u), None)))(u)

    def run(p):
        return jax.vmap(lambda policy: task.rollout(None, policy, p).cost)(policies)

    targets = task.space.physical(u)
    cost, best = (
        np.asarray(jax.jit(jax.vmap(run))(targets)),
        np.asarray(jax.jit(jax.vmap(task.reference))(targets)),
    )
    assert np.all(best <= np.diag(cost) * 1.001)
    assert (
        np.mean(cost < np.diag(cost)[:, None] * 0.999) > 0.2
    )  # what the reference of a linear model would allow
    assert np.mean(cost < best[:, None] * 0.999) < 0.05
