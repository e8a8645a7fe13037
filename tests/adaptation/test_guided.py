"""Trajectories of Phase 1 that are led towards their target."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.episode import Guide, heading
from adaptsim_jax.adaptation.phase1 import Phase1Config, Phase1Hyper, make_phase1
from adaptsim_jax.adaptation.reuse import ReuseConfig
from adaptsim_jax.adaptation.training import traced
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import MINUS, PLUS, STAY
from tests.adaptation.toy import make_toy

SIZES = Phase1Config(
    trajectories=40,
    parallel=20,
    horizon=6,
    updates=2,
    batch=8,
    capacity=240,
    archive=240,
    hidden=(8,),
)


def test_a_heading_goes_to_the_target_or_to_the_nearest_place_of_omega():
    space, target = (
        make_toy(4).space,
        jnp.array([2.0, 2.0, 2.0, 4.0]),
    )  # 0.5 in unit coordinates, and beyond the box
    mean = jnp.array([0.2, 0.8, 0.54, 0.99])
    assert heading(space, mean, target, 0.1).tolist() == [PLUS, MINUS, STAY, STAY]
    assert heading(space, mean, target, 0.01).tolist() == [PLUS, MINUS, MINUS, PLUS]


def test_a_share_of_trajectories_is_led_in_most_of_their_steps():
    guide, space = Guide(0.5, make_toy().space), make_toy().space
    mean, target, own = (
        jnp.array([0.2, 0.8]),
        jnp.array([2.0, 2.0]),
        jnp.array([STAY, STAY], jnp.int32),
    )

    def step(t, s):
        return guide(jax.random.key(t), jax.random.key(s), own, mean, target, 0.1)

    tried = np.asarray(
        jax.vmap(lambda t: jax.vmap(lambda s: step(t, s))(jnp.arange(100, 150)))(jnp.arange(100))
    )
    led = (tried != np.asarray(own)).any((1, 2))  # all of a trajectory is led, or none
    assert 35 < led.sum() < 65
    towards = (tried[led] == np.asarray(heading(space, mean, target, 0.1))).mean()
    assert 0.75 < towards < 0.85  # 0.7, and a third of the random ones


@pytest.mark.parametrize(
    "reuse", [ReuseConfig(), ReuseConfig(threshold=0.1, capacity=40, together=20)]
)
def test_led_trajectories_come_nearer_to_their_targets(reuse):
    toy = make_toy()
    task = replace(toy, train_many=lambda keys, dists, policies, trials: dists.mean)
    rewards = []
    for guided in (0.0, 1.0):
        phase1 = make_phase1(task, replace(SIZES, reuse=reuse, guided=guided))
        run = jax.jit(lambda s, phase1=phase1: phase1.run(s, traced(Phase1Hyper()), jnp.arange(1)))
        rewards.append(float(run(jax.jit(phase1.init)(jax.random.key(0)))[1].final_reward[0]))
    assert rewards[1] > rewards[0] + 0.3


def test_a_share_beyond_one_is_refused():
    with pytest.raises(BadInput, match=r"guided = 1\.5"):
        make_phase1(make_toy(), replace(SIZES, guided=1.5))
