"""The course of a policy's training: the best by evaluation is kept, what went wrong is said, and
what was stopped goes on to the same bits.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.store import Kept
from adaptsim_jax.environments.course import TrainingPlan, trained_in
from adaptsim_jax.environments.policies import everywhere
from adaptsim_jax.environments.setting import setting_of
from adaptsim_jax.environments.trainer import Trainer, TrainerInfo
from tests.environments.cart import Cart
from tests.environments.test_task import SMALL

SETTING = setting_of(Cart(), SMALL)


def course(worth, idle=0.0, lost=(0.0, 0.0)):
    """A training whose policy is the number of rounds so far, which returns `worth` of it."""

    def train(key, state, worlds, rounds):
        shares = jnp.broadcast_to(jnp.asarray(lost), (rounds, 2))
        info = TrainerInfo(*[jnp.zeros(rounds)] * 4, shares, jnp.ones((rounds, 3)))
        return state + rounds, info

    def returns(key, policy, worlds, mix, count):
        return jnp.where(mix[0] > 0, worth(policy), idle) + 0.1 * jax.random.normal(key, (count,))

    def same(x):
        return x

    trainer = Trainer(None, lambda key, learned: learned, train, same, same, None, None, returns)
    start, plan = jnp.zeros(()), TrainingPlan(100)
    return float(trained_in(trainer, jax.random.key(0), start, everywhere(SETTING), plan))


def test_a_training_that_fell_keeps_its_best_and_says_so(capsys):
    assert course(lambda rounds: 18.3 - 0.02 * (rounds - 60.0) ** 2) == 60.0
    said = capsys.readouterr().err
    assert "fell from a return of 18" in said and "60 % of it is kept" in said
    assert said.count("\n") == 1


def test_one_that_rose_to_the_end_says_nothing(capsys):
    assert course(lambda rounds: 0.1 * rounds) == 100.0
    assert not capsys.readouterr().err


def test_a_policy_that_earns_less_than_standing_still_is_not_called_trained(capsys):
    course(lambda rounds: 0.042 * rounds, idle=12.5)
    said = capsys.readouterr().err
    assert "the policy returns 4.1" in said and "doing nothing 12.4" in said


def test_rewards_and_observations_that_are_no_number_are_told_apart(capsys):
    course(lambda rounds: 0.1 * rounds, lost=(0.002, 0.0))
    said = capsys.readouterr().err
    assert "the reward is no number in 0.20 % of" in said.replace("0.20%", "0.20 %")
    assert "first at [1.0, 1.0, 1.0]" in said and "observed is no number" not in said
    course(lambda rounds: 0.1 * rounds, lost=(0.0, 0.03))
    said = capsys.readouterr().err
    assert "what is observed is no number in 3.00%" in said and "the reward" not in said


def test_a_reward_without_a_number_is_counted_where_it_comes_from():
    """Just where the task is solved; random actions hardly get there."""
    env = Cart()
    usual = env.reward
    env.reward = lambda state: jnp.where(jnp.abs(state.place) < 0.3, jnp.nan, usual(state))
    setting = setting_of(env, SMALL)
    trainer = setting.trainer
    state = trainer.begin(jax.random.key(1), trainer.init(jax.random.key(0)))
    _, info = trainer.train(jax.random.key(2), state, everywhere(setting), 10)
    lost, where = np.asarray(info.lost), np.asarray(info.where)
    assert (lost[:, 1] == 0.0).all() and (lost[:, 0] > 0.0).any()
    assert (np.abs(where[lost[:, 0] > 0.0, 0]) < 0.3).all()


class Stopped(Exception): ...


def test_a_training_that_was_stopped_goes_on_to_the_same_bits(tmp_path):
    training = replace(SMALL.training, steps=64 * 25 * 40)
    setting = setting_of(Cart(), replace(SMALL, training=training))
    trainer, key = setting.trainer, jax.random.key(5)
    first, rounds = trainer.init(jax.random.key(0)), training.rounds

    def run(kept=None, stop=10**9):
        def report(done, total, note):
            seen.append(done)
            if done >= stop:
                raise Stopped

        plan = TrainingPlan(rounds, 0.5, kept)
        return trained_in(trainer, key, first, everywhere(setting), plan, report)

    seen = []
    straight = run()
    kept = Kept(tmp_path / "so-far", "environment", "d", every=0.0)
    with pytest.raises(Stopped):
        run(kept, stop=30)
    seen.clear()
    again = run(Kept(tmp_path / "so-far", "environment", "d"))
    assert seen == [30, 40]  # the third chunk was not yet kept when it was stopped
    assert all(map(np.array_equal, *map(jax.tree.leaves, (straight, again))))
    other = Kept(tmp_path / "so-far", "environment", "another environment")
    assert other.restore(first) == (first, 0)
