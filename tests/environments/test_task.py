"""An environment as a `Task`: its policy is trained once, then Phase 1 and 2 run on it; what is
wrong with one is told.
"""

import itertools
import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.asktell import Session
from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.adaptation.phase1_config import Phase1Config, Phase1Hyper
from adaptsim_jax.adaptation.phase2 import adapt, draw_starts
from adaptsim_jax.adaptation.training import Trained
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.course import TrainingPlan, trained_in
from adaptsim_jax.environments.episodes import ActingPolicy, EpisodeSteps, Rollout, look
from adaptsim_jax.environments.policies import (
    Law,
    Prepared,
    check_fields,
    everywhere,
    shaken,
    starts_of,
)
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import environment_task, ready, task_of
from adaptsim_jax.environments.trainer import PPOTraining, Trainer, TrainerInfo
from adaptsim_jax.learners.ppo import PPOHyper
from adaptsim_jax.space import gaussian
from tests.environments.cart import Cart, State

SMALL = EnvironmentConfig(
    training=PPOTraining(steps=64 * 25 * 40, parallel=64, unroll=25, hidden=(16, 16)),
    references=4,
    components=6,
    targets={"heavy": {"params.mass": 1.8, "params.damping": 0.3}},
)


@pytest.fixture(scope="module")
def made():
    task = task_of(setting_of(Cart(), SMALL))
    said = []
    prepared = task.preparation.make(jax.random.key(0), lambda *told: said.append(told))
    return task, prepared, task.preparation.ready(prepared), said


def rolled(task, means, params):
    key = jax.random.key(3)
    return jax.jit(jax.vmap(lambda m: task.rollout(key, Law(m), params)))(
        jnp.asarray(means, jnp.float32)
    )


def test_training_makes_the_policy_better_and_says_how_far_it_is(made):
    blank, _, task, said = made
    params = task.space.physical(jnp.array([0.5, 0.5]))
    before, after = (rolled(t, [[0.5, 0.5]], params).score[0] for t in (blank, task))
    # standing still 0.5 m off earns exp(-2.5) a step; at the middle a step is worth 1
    assert before < 4.0 and after > 10.0
    assert said[-1][0] == said[-1][1] == SMALL.training.rounds


def test_worlds_are_not_told_while_training_is_blind():
    told, kinds = [], set()

    def train(key, state, worlds, rounds):
        told.extend([float(worlds.known)] * rounds)
        kinds.add(tuple(map(jax.typeof, worlds)))
        return state, TrainerInfo(*[jnp.zeros(rounds)] * 4, *[jnp.zeros((rounds, 2))] * 2)

    trainer = Trainer(
        None, lambda key, learned: learned, train, lambda state: state, None, None, None
    )  # type: ignore[arg-type]
    worlds = everywhere(setting_of(Cart(), SMALL))
    trained_in(trainer, jax.random.key(0), (), worlds, TrainingPlan(40, 0.5))
    assert told == [0.0] * 20 + [1.0] * 20
    assert len(kinds) == 1  # a program for each would be compiled
    told.clear()
    trained_in(trainer, jax.random.key(0), (), worlds, TrainingPlan(40))
    assert told == [1.0] * 40


def test_one_program_trains_at_all_rates_and_lengths():
    programs = []
    for rate, steps in ((1e-3, 64 * 25 * 40), (3e-4, 64 * 25 * 80)):
        training = replace(SMALL.training, steps=steps, hyper=PPOHyper(learning_rate=rate))
        setting = setting_of(Cart(), replace(SMALL, training=training))
        state = setting.trainer.begin(jax.random.key(1), setting.trainer.init(jax.random.key(0)))

        def train(*args, setting=setting):
            return setting.trainer.train(*args, 2)

        program = str(jax.make_jaxpr(train)(jax.random.key(2), state, everywhere(setting)))
        programs.append(re.sub("0x[0-9a-f]+", "", program))  # where functions lie in memory
    assert programs[0] == programs[1]


def test_what_is_observed_tells_worlds_apart_and_rewards_have_their_scale(made):
    *_, task, _ = made
    light, heavy = (
        rolled(task, [[0.5, 0.5]], task.space.physical(jnp.array(u)))
        for u in ([0.0, 0.5], [1.0, 0.5])
    )
    seen = [np.asarray(jax.vmap(task.observe)(x))[0] for x in (light, heavy)]
    assert (
        np.isfinite(seen).all() and np.abs(seen[0] - seen[1]).max() > 1.0
    )  # in units of their own spread
    params = task.space.physical(jnp.array([0.2, 0.8]))
    best, mean = task.reference(params)
    means = np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=2)))
    reward = np.asarray(
        jax.vmap(task.reward, (0, None))(rolled(task, means, params), jnp.stack([best, mean]))
    )
    assert best >= mean and (reward <= 1.0).all()


PHASE1 = Phase1Config(
    trajectories=20, parallel=10, horizon=3, updates=4, capacity=60, archive=60, hidden=(16,)
)


@pytest.mark.long
def test_phase_1_and_2_run_and_a_session_told_the_same_goes_the_same_way(made):
    *_, task, _ = made
    phase1, hyper = make_phase1(task, PHASE1), Phase1Hyper()
    state, info = jax.jit(phase1.run)(phase1.init(jax.random.key(0)), hyper, jnp.arange(2))
    assert np.isfinite(np.asarray(info.reward)).all()
    target = jnp.asarray(task.space.values(task.settings["heavy"]), jnp.float32)
    start_key, _ = jax.random.split(jax.random.key(5))
    starts = draw_starts(start_key, state.archive, 60, 1)
    found = adapt(
        jax.random.key(0), task, phase1.bdq, state.learner.target, starts, target, StepPlan(3)
    )
    session, visits = Session(Trained(phase1, hyper, state, 2), starts=1, iterations=3, seed=5), []
    while not session.done:
        asked = session.ask()
        visits.append(asked.policy.mean)
        trajectory = task.rollout(jax.random.key(len(visits)), asked.policy, target)
        session.tell(float(task.score(trajectory)), task.observe(trajectory))
    np.testing.assert_allclose(
        np.stack(visits), found.history.mean[0], atol=1e-6
    )  # nothing of this task is drawn
    assert session.best().params == pytest.approx(
        dict(zip(task.space.names, map(float, task.space.physical(found.mean)), strict=True)),
        rel=1e-5,
    )
    with pytest.raises(BadInput, match="all 4 trials are told"):
        session.tell(0.0, np.zeros(6))


def test_a_measured_episode_is_read_as_a_simulated_one(made):
    *_, task, _ = made
    rng = np.random.default_rng(0)
    obs, action, reward = (
        rng.normal(size=(25, 2)),
        rng.uniform(-1, 1, (25, 1)),
        rng.uniform(size=25),
    )
    whole = look(
        EpisodeSteps(*(jnp.asarray(x, jnp.float32) for x in (obs, action, reward)), jnp.ones(25)),
        ActingPolicy(None, None),
    )  # type: ignore[arg-type]
    read = task.read(obs, action, reward)
    np.testing.assert_allclose(read.features, whole.features, rtol=1e-6)
    short = task.read(obs[:10], action[:10], reward[:10])
    assert short.length == 10 and short.score == pytest.approx(reward[:10].sum(), rel=1e-6)
    with pytest.raises(BadInput, match="action: the shape is"):
        task.read(obs, action[:5], reward)
    assert task.act(Law(jnp.full(2, 0.5)), jnp.array([0.5, 0.0])).shape == (1,)


def test_an_asked_policy_acts_for_one_observation_and_for_many(made):
    *_, task, _ = made
    phase1 = make_phase1(task, PHASE1)
    state = phase1.init(jax.random.key(0))
    session = Session(Trained(phase1, Phase1Hyper(), state, PHASE1.rounds), starts=1, iterations=1)
    act, obs = session.ask().act, np.random.default_rng(0).normal(size=(3, 4, 2))
    many = act(obs)
    assert many.shape == (3, 4, 1) and act(obs[0]).shape == (4, 1)
    np.testing.assert_allclose(many[1, 2], act(obs[1, 2]), atol=1e-6)


def test_what_a_start_brought_is_taken_off_the_return(made):
    *_, task, _ = made
    rng = np.random.default_rng(0)
    value, merit = rng.normal(3.0, 2.0, 400), rng.normal(0.0, 1.0, 400)
    zero = np.zeros(400)
    mean, spread, worth = starts_of(Rollout(5.0 * value + merit, value, zero, zero))  # type: ignore[arg-type]
    assert (mean, spread, worth) == pytest.approx((value.mean(), value.std(), 5.0), rel=0.02)
    assert starts_of(Rollout(-5.0 * value, value, zero, zero))[2] == 0.0  # type: ignore[arg-type]
    shown = Rollout(jnp.asarray(7.0), jnp.asarray(2.0), jnp.zeros(()), jnp.zeros(3))
    assert task.score(shown) == 5.0


def test_phase_1_judges_policies_in_a_target_from_the_same_starts(made):
    class Anywhere(Cart):
        def reset_env(self, key, params):
            state = State(jax.random.uniform(key), jnp.zeros(()))
            return self.seen(state), state

    task = ready(setting_of(Anywhere(), SMALL), made[1])
    one, other = (task.space.physical(jnp.array(u)) for u in ([0.5, 0.5], [0.2, 0.5]))
    run = jax.jit(lambda key, target: task.rehearse(key, Law(jnp.full(2, 0.5)), target))
    first, again = (run(jax.random.key(k), one) for k in (0, 1))
    assert first.score == again.score and first.score != run(jax.random.key(0), other).score
    assert jnp.abs(first.features - again.features).max() > 0.0
    assert task.reference(one)[0] >= first.score - 1e-4


def test_an_environment_without_a_step_or_a_model_is_refused():
    class Nothing:
        def reset(self, key): ...

    with pytest.raises(BadInput, match=r"has no step\(...\)"):
        environment_task(Nothing())
    Nothing.step = lambda self, state, action: state
    with pytest.raises(BadInput, match=r"holds no mjx.Model"):
        environment_task(Nothing())


def test_a_field_that_does_nothing_is_told_by_name():
    task = environment_task(
        Cart(), {"params.mass": [0.5, 2.0], "params.unused": [0.2, 1.0]}, replace(SMALL, targets={})
    )
    with pytest.raises(BadInput, match=r"follows from 'params.unused'"):
        task.preparation.make(jax.random.key(0))


def test_rewards_that_are_not_finite_are_told_before_anything_is_trained():
    env = Cart()
    env.reward = lambda state: jnp.log(state.place - 10.0)
    with pytest.raises(
        BadInput, match=r"the return is not finite under random actions at {'params.mass'"
    ):
        environment_task(env, config=SMALL).preparation.make(jax.random.key(0))


def test_an_environment_that_keeps_a_state_of_its_own_is_told():
    env, rng = Cart(), np.random.default_rng(0)
    env.reset_env = lambda key, params: (
        jnp.zeros(2),
        State(jnp.full((), rng.normal()), jnp.zeros(())),
    )
    with pytest.raises(BadInput, match="is not pure"):
        environment_task(env, config=SMALL).preparation.make(jax.random.key(0))


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["tuned", "planned"])
def test_the_other_policies_serve_phase_1_too(policy):
    config = replace(
        SMALL, policy=policy, tune=1, training=replace(SMALL.training, steps=64 * 25 * 10)
    )
    task = task_of(setting_of(Cart(), config))
    task = task.preparation.ready(task.preparation.make(jax.random.key(0)))
    phase1 = make_phase1(task, replace(PHASE1, trajectories=4, parallel=2, capacity=12, archive=12))
    _, info = jax.jit(phase1.run)(phase1.init(jax.random.key(0)), Phase1Hyper(), jnp.arange(2))
    assert np.isfinite(np.asarray(info.reward)).all()
    if policy == "planned":  # it needs no training: a plan of 40 steps ahead finds the middle
        params = task.space.physical(jnp.array([0.5, 0.5]))
        assert rolled(task, [[0.5, 0.5]], params).score[0] > 12.0


def test_a_policy_is_tuned_in_worlds_of_omega_alone():
    setting = setting_of(Cart(), replace(SMALL, policy="tuned", spread=0.05))
    seen = []
    trainer = setting.trainer._replace(
        begin=lambda key, learned: learned,
        train=lambda key, state, worlds, rounds: (seen.append(worlds) or state, None),
        learned=lambda state: state,
        policy=lambda learned: learned,
    )
    task = ready(setting._replace(trainer=trainer), Prepared((), None, jnp.zeros(3)))
    task.train(jax.random.key(0), gaussian(task.space, jnp.array([0.0, 1.0])), None)
    np.testing.assert_allclose(seen[0].low, [0.0, 0.95], atol=1e-6)
    np.testing.assert_allclose(seen[0].high, [0.05, 1.0], atol=1e-6)


def test_a_field_that_does_nothing_in_a_part_of_its_range_is_told(capsys):
    env = Cart()
    usual = env.step_env
    # of a damping and another of 1.05 the greater acts, as with the friction of two geoms
    env.step_env = lambda key, state, action, params: usual(
        key, state, action, params.replace(damping=jnp.maximum(params.damping, 1.05))
    )
    setting = setting_of(env, SMALL)
    check_fields(setting.space, shaken(setting))
    said = capsys.readouterr().err
    assert "'params.damping' from 0.1 to 0.575, 0.575 to 1.05 (" in said
    assert said.count("\n") == 1
