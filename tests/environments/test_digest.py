"""A trained policy is taken again only for the environment that it was trained in."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation import training
from adaptsim_jax.core import traced
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.environments.setting import EnvironmentConfig, digest, setting_of
from adaptsim_jax.environments.task import environment_task
from adaptsim_jax.environments.trainer import PPOTraining
from tests.environments import small
from tests.environments.cart import Cart

MJCF = small.MJCF.format(constraint="enable")
GOAL = 0.0


def distance(data):
    """What the reward calls; both the function and the goal are changed from outside."""
    return data.qpos[0] - GOAL


def reward(data, action):
    return jnp.exp(-10.0 * jnp.square(distance(data)))


def reward_alike(data, action):
    # the same, in other words
    far = distance(data)
    return jnp.exp(-10.0 * jnp.square(far))


def made(mjcf=MJCF, reward=reward, **options):
    given = {
        "start": lambda key, qpos: (qpos + 0.5, jnp.zeros(1)),
        "control_dt": 0.04,
        "length": 25,
        "fields": small.FIELDS,
    }
    return ModelEnvironment(
        mjcf, lambda data: jnp.concatenate([data.qpos, data.qvel]), reward, **(given | options)
    )


def of(env, **options):
    return digest(setting_of(env, EnvironmentConfig(**options)))


@pytest.fixture(scope="module")
def first():
    return of(made())


def test_the_same_environment_in_other_words_has_the_same_digest(first):
    commented = MJCF.replace("<worldbody>", "<!-- a --><worldbody>")
    assert of(made()) == first
    assert of(made(commented, reward_alike)) == first


@pytest.mark.parametrize(
    "change",
    [
        {"reward": lambda data, action: jnp.exp(-9.0 * jnp.square(distance(data)))},
        {"start": lambda key, qpos: (qpos + 0.4, jnp.zeros(1))},
        {"done": lambda data: jnp.abs(data.qpos[0]) > 2.0},
        {"control_dt": 0.02},
        {"mjcf": MJCF.replace('mass="1"', 'mass="1.1"')},
        {"fields": {"body:cart.mass": (0.5, 2.1, "log"), "joint:slide.damping": (0.1, 2.0)}},
    ],
    ids=["reward", "start", "done", "control_dt", "mass", "omega"],
)
def test_each_change_has_another_digest(first, change):
    assert of(made(**change)) != first


@pytest.mark.parametrize(
    ("name", "value"), [("GOAL", 0.2), ("distance", lambda data: data.qpos[0] + 0.1)]
)
def test_a_constant_and_a_function_that_the_reward_uses_count(first, monkeypatch, name, value):
    monkeypatch.setattr(sys.modules[__name__], name, value)
    assert of(made()) != first


def test_how_a_policy_is_trained_counts(first):
    assert of(made(), targets={"heavy": {"body:cart.mass": 2.0}}) == first  # a policy knows none
    assert of(Cart()) != of(Cart(), training=PPOTraining(steps=20_000))
    assert of(Cart()) != of(Cart(), length=24)


def test_a_second_process_finds_the_same(first):
    code = "from tests.environments import test_digest as t; print(t.of(t.made()))"
    root = Path(__file__).parents[2]
    path = os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "7"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=root, capture_output=True, text=True
    )
    assert done.stdout.split()[-1] == first, done.stderr


def test_parameters_without_a_model_count():
    env = Cart()
    env.default_params = env.default_params.replace(push=5.0)
    assert of(Cart()) == of(Cart()) != of(env)


def test_a_policy_that_is_taken_again_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ADAPTSIM_CACHE", str(tmp_path))
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", "true")
    blank = environment_task(Cart()).preparation.blank  # type: ignore[union-attr]

    def again(env):
        task = environment_task(env)
        trained = task.preparation._replace(make=lambda key, report, kept: blank(key))  # type: ignore[union-attr]
        return training.learned(task, trained, 0, None)

    first = again(Cart())
    assert not capsys.readouterr().err
    second = again(Cart())
    assert "is taken again" in capsys.readouterr().err
    assert all(map(np.array_equal, jax.tree.leaves(first), jax.tree.leaves(second)))
    other = Cart()
    other.default_params = replace(other.default_params, push=5.0)
    again(other)
    assert not capsys.readouterr().err


def test_a_digest_does_not_hang_on_what_was_traced_before():
    def called(x):
        return jnp.where(x > 0, x, jnp.zeros_like(x)) + jnp.where(x > 1, x, 2.0 * x)

    alone = traced.digest_of(called, jnp.zeros(3))
    jax.make_jaxpr(lambda x: jnp.where(x > 2, x, -x))(jnp.zeros(3))
    jax.jit(called)(jnp.ones(3))
    assert traced.digest_of(called, jnp.zeros(3)) == alone
    assert traced.digest_of(called, jnp.zeros(4)) != alone
    jax.clear_caches()
    assert traced.digest_of(jax.jit(called), jnp.zeros(3)) != ""
    assert traced.digest_of(called, jnp.zeros(3)) == alone


def test_arrays_that_are_closed_over_count_by_their_values():
    def with_table(table):
        return traced.digest_of(lambda x: x @ jnp.asarray(table), jnp.zeros(2))

    assert with_table(np.eye(2)) == with_table(np.eye(2)) != with_table(2.0 * np.eye(2))
