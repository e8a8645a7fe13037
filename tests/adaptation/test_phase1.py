"""Phase 1 on a toy whose best answer is known: it learns, compiles once, and does not depend on how
it is cut.
"""

from dataclasses import fields, replace

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import (
    Phase1Config,
    Phase1Hyper,
    archive_size,
    make_phase1,
    shape_reward,
)
from adaptsim_jax.adaptation.phase1_config import POSITIVE, SHARES
from adaptsim_jax.adaptation.phase2 import (
    adapt,
    adapt_many,
    best_of,
    best_visit,
    draw_starts,
    smoothed,
    stack,
    starts_of,
    train_many,
)
from adaptsim_jax.adaptation.training import TrainConfig, preset, traced
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import BDQHyper
from tests.adaptation.toy import make_toy

PLAIN = replace(preset("paper-pendulum").hyper, threshold=0.0)
SMALL = Phase1Config(
    trajectories=60,
    parallel=10,
    horizon=4,
    updates=3,
    batch=16,
    capacity=80,
    archive=120,
    hidden=(16,),
)


@pytest.fixture(scope="module")
def small():
    phase1 = make_phase1(make_toy(), SMALL)
    return phase1, jax.jit(phase1.init), jax.jit(phase1.run)


def _bits(tree):
    tree = tree._replace(key=jax.random.key_data(tree.key))
    return [np.asarray(x).tobytes() for x in jax.tree.leaves(tree)]


@pytest.mark.slow
def test_cut_anywhere_it_ends_with_the_same_bits(small):
    _, init, run = small
    hyper = traced(PLAIN)
    whole, _ = run(init(jax.random.key(3)), hyper, jnp.arange(6))
    state = init(jax.random.key(3))
    for numbers in (
        jnp.arange(0, 3),
        jnp.arange(3, 4),
        jnp.arange(4, 5),
        jnp.arange(5, 6),
    ):  # two lengths to compile
        state, _ = run(state, hyper, numbers)
    assert _bits(state) == _bits(whole)
    other, _ = run(init(jax.random.key(4)), hyper, jnp.arange(6))
    assert _bits(other) != _bits(whole)


def test_one_trace_for_a_sweep_of_every_hyper_parameter():
    phase1 = make_phase1(make_toy(), SMALL)
    chex.clear_trace_counter()
    run = jax.jit(chex.assert_max_traces(phase1.run, n=1))
    state = jax.jit(phase1.init)(jax.random.key(0))
    leaves, tree = jax.tree.flatten(traced(Phase1Hyper()))
    ends = []
    for i in range(len(leaves)):
        changed = [x * 0.5 + 0.01 if j == i else x for j, x in enumerate(leaves)]
        ends.append(run(state, jax.tree.unflatten(tree, changed), jnp.arange(6))[1].loss)
    assert len(ends) == len(leaves)


def test_vmap_over_seeds_and_rates_is_the_single_runs(small):
    phase1, init, run = small
    keys = jax.random.split(jax.random.key(0), 2)
    hypers = [traced(replace(PLAIN, learner=BDQHyper(learning_rate=r))) for r in (1e-3, 1e-2)]
    both = jax.tree.map(lambda *x: jnp.stack(x), *hypers)
    many = jax.jit(
        lambda k, h: jax.vmap(lambda k, h: phase1.run(phase1.init(k), h, jnp.arange(6)))(k, h)
    )
    _, info = many(keys, both)
    for i, hyper in enumerate(hypers):
        alone = run(init(keys[i]), hyper, jnp.arange(6))[1]
        # batched products sum in another order, and six rounds of Adam amplify that
        chex.assert_trees_all_close(
            jax.tree.map(lambda x, i=i: x[i], info), alone, rtol=2e-3, atol=2e-4
        )


def test_replay_and_archive_hold_what_happened(small):
    phase1, init, run = small
    state, _ = run(init(jax.random.key(1)), traced(replace(PLAIN, delta=0.25)), jnp.arange(6))
    obs, after = np.asarray(state.replay.obs), np.asarray(state.replay.next_obs)
    move = np.array([-0.25, 0.25, 0.0])[np.asarray(state.replay.action)]
    mean = (obs[:, :2] + 1) / 2
    np.testing.assert_allclose((after[:, :2] + 1) / 2, np.clip(mean + move, 0, 1), atol=1e-6)
    # the toy shows twice the distance to the target, and is rewarded by the distance that is left
    left = np.linalg.norm(after[:, 2:] / 2, axis=1)
    np.testing.assert_allclose(state.replay.reward, np.maximum(1 - 2 * left, 0), atol=1e-5)
    assert np.asarray(state.replay.bootstrap).reshape(-1, 4).tolist() == [[1, 1, 1, 0]] * 20
    # 6 rounds of 40 fill the ring of 120 twice over; policies of the toy are the means
    np.testing.assert_array_equal(state.archive.mean, state.archive.policy)
    assert archive_size(phase1, 6) == 120 and archive_size(phase1, 2) == 80
    assert len(np.unique(np.asarray(state.archive.mean), axis=0)) > 60


def test_no_learning_during_warmup():
    phase1 = make_phase1(make_toy(), replace(SMALL, warmup=2))
    init, run = jax.jit(phase1.init), jax.jit(phase1.run)
    start = init(jax.random.key(0))
    state, _ = run(start, traced(PLAIN), jnp.arange(2))
    # the optimiser's moments likewise
    jax.tree.map(np.testing.assert_array_equal, state.learner, start.learner)
    state, _ = run(state, traced(PLAIN), jnp.arange(2, 4))
    assert np.any(state.learner.online != start.learner.online)


def test_shaped_reward_by_hand():
    reward = jnp.array([1.0, 0.96, 0.94, -3.0, jnp.nan, -jnp.inf])
    sparse = shape_reward(reward, preset("paper-pendulum").hyper)
    np.testing.assert_allclose(sparse, [1.0, 0.96, 0.0, 0.0, 0.0, 0.0], rtol=1e-6)
    sharp = shape_reward(reward, Phase1Hyper(threshold=-9.0, gain=10.0, soft=0.0))
    np.testing.assert_allclose(sharp, [1.0, 0.6, 0.4, 0.0, 0.0, 0.0], rtol=1e-5)
    soft = shape_reward(reward, Phase1Hyper(threshold=-1e9, gain=10.0, soft=1.0, far=0.0))
    np.testing.assert_allclose(soft, [1.0, 1 / 1.4, 1 / 1.6, 1 / 41, 0.0, 0.0], rtol=1e-5)
    mixed = shape_reward(reward, Phase1Hyper(threshold=-1e9, gain=10.0, soft=1.0, far=0.25))
    log = 1 - np.log1p([0.0, 0.4, 0.6, 40.0]) / np.log1p(1e4)
    np.testing.assert_allclose(mixed[:4], 0.75 * soft[:4] + 0.25 * log, rtol=1e-5)
    np.testing.assert_array_equal(mixed[4:], 0.0)


@pytest.mark.slow
def test_it_learns_to_reach_the_target():
    """The known answer: every parameter within half a step (0.05) of the target after at most ten
    steps.
    """
    task = make_toy(2)
    phase1 = make_phase1(
        task, Phase1Config(trajectories=3000, parallel=50, updates=60, capacity=20_000)
    )
    hyper = traced(Phase1Hyper(gain=2.0))
    run = jax.jit(lambda k: phase1.run(phase1.init(k), hyper, jnp.arange(phase1.config.rounds))[0])
    state = run(jax.random.key(0))
    targets = task.space.physical(task.space.sample(jax.random.key(1), (200,)))
    starts = draw_starts(jax.random.key(2), state.archive, 20_000, 2)
    result = jax.jit(
        jax.vmap(
            lambda t: adapt(jax.random.key(3), task, phase1.bdq, state.learner.target, starts, t)
        )
    )(targets)
    first, last = (np.asarray(-result.history.score[:, :, i]) for i in (0, -1))
    # a random point of the square is 0.52 away on average; the best on the grid of steps 0.038
    assert first.mean() > 0.35 and last.mean() < 0.1
    assert np.mean(-result.score) < 0.06


def test_best_of_skips_what_diverged():
    task = make_toy(2)
    phase1 = make_phase1(task, SMALL)
    weights = jax.jit(phase1.init)(jax.random.key(0)).learner.online
    starts = draw_starts(jax.random.key(0), jax.jit(phase1.init)(jax.random.key(0)).archive, 1, 2)
    history = adapt(
        jax.random.key(0), task, phase1.bdq, weights, starts, jnp.array([1.5, 2.5]), StepPlan(3)
    ).history
    history = history._replace(score=history.score.at[0, 0].set(jnp.nan).at[1, 2].set(7.0))
    result = best_of(history)
    assert result.score == 7.0
    np.testing.assert_array_equal(result.mean, history.mean[1, 2])


def test_the_first_visit_stands_for_none_that_is_finite():
    assert tuple(map(int, best_visit(jnp.array([[0.1, 0.4, jnp.nan], [jnp.inf, 0.3, 0.2]])))) == (
        0,
        1,
    )
    assert tuple(map(int, best_visit(np.full((2, 3), np.nan)))) == (0, 0)


def test_one_lucky_return_among_poor_ones_is_not_deployed():
    mean = jnp.array([[0.1], [0.15], [0.2], [0.9], [0.95], [1.0]])
    score = jnp.array([1.0, 8.0, 2.0, 6.0, 7.0, 6.0])
    assert (
        jnp.argmax(smoothed(mean, score, 0.0)) == 1 and jnp.argmax(smoothed(mean, score, 1.0)) > 2
    )
    other = 10.0 * smoothed(mean, score, 1.0) - 3.0
    np.testing.assert_allclose(smoothed(mean, 10.0 * score - 3.0, 1.0), other, rtol=1e-4)
    failed = smoothed(jnp.concatenate([mean, mean[:1]]), jnp.append(score, -jnp.inf), 1.0)
    np.testing.assert_allclose(
        failed[:6], smoothed(mean, score, 1.0), rtol=1e-5
    )  # of what did not fail alone
    assert failed[6] == -jnp.inf


@pytest.mark.parametrize(
    ("change", "mend"),
    [
        ({"trajectories": 65}, "use 60"),
        ({"capacity": 100}, "use 80"),
        ({"archive": 50}, "use 40"),
        ({"batch": 0}, r"phase1\.batch = 0: give at least 1"),
        ({"parallel": 0}, r"phase1\.parallel = 0: give at least 1"),
        ({"trajectories": 0}, r"phase1\.trajectories = 0: give at least 1"),
        ({"trajectories": -10}, r"phase1\.trajectories = -10: give at least 1"),
        ({"warmup": -1}, r"phase1\.warmup = -1"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(change, mend):
    with pytest.raises(BadInput, match=mend):
        make_phase1(make_toy(), replace(SMALL, **change))


@pytest.mark.parametrize(
    ("change", "mend"),
    [
        ({"epsilon_share": 0.0}, r"hyper\.epsilon_share = 0.0: give a positive number"),
        ({"delta": -0.1}, r"hyper\.delta = -0.1: give a positive number"),
        ({"delta": 1.5}, r"hyper\.delta = 1.5: give at most 1"),
        ({"rate_end": -1.0}, r"hyper\.rate_end = -1.0: give at least 0"),
        ({"obs_noise": -1.0}, r"hyper\.obs_noise = -1.0: give at least 0"),
        ({"inside": float("nan")}, r"hyper\.inside = nan"),
        ({"learner": BDQHyper(discount=1.5)}, r"hyper\.learner\.discount = 1.5: give at most 1"),
        (
            {"learner": BDQHyper(learning_rate=0.0)},
            r"hyper\.learner\.learning_rate = 0.0: give a positive number",
        ),
    ],
)
def test_rates_that_make_no_sense_are_refused(change, mend):
    with pytest.raises(BadInput, match=mend):
        TrainConfig(hyper=replace(Phase1Hyper(), **change))


def test_every_rate_is_checked_but_the_threshold_of_the_reward():
    """Any threshold makes sense: rewards may be of any size below 1."""
    checked = {name.removeprefix("learner.") for name in (*POSITIVE, *SHARES, "obs_noise")}
    names = {f.name for f in fields(Phase1Hyper)} - {"learner"} | {f.name for f in fields(BDQHyper)}
    assert names - checked == {"threshold"}


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_that_would_stand_for_another_is_refused(seed):
    with pytest.raises(BadInput, match=f"seed = {seed}: give a whole number"):
        TrainConfig(seed=seed)


@pytest.mark.slow
def test_seeds_side_by_side_are_the_runs_alone(small):
    phase1, seeds = small[0], np.arange(3, dtype=np.uint32)
    hypers = stack([PLAIN] * 3)
    alone, notes = train_many(phase1, hypers, seeds, at_once=1), []
    both = train_many(phase1, hypers, seeds, at_once=2, progress=lambda *x: notes.append(x[0]))
    assert notes == [2, 3]  # the last of two is filled up, and left out again
    # products of batches are summed in another order, and six rounds of Adam amplify that
    chex.assert_trees_all_close(both, alone, rtol=2e-3, atol=2e-4)
    starts, targets = starts_of(phase1, alone, seeds, 2), np.array([[1.2, 2.9]])
    found = [
        adapt_many(phase1, alone, starts, targets, iterations=2, at_once=n).mean for n in (1, 2)
    ]
    assert found[0].shape == (3, 1, 2, 3, 2)
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
