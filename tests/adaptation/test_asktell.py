"""Ask/tell against Phase 2: told simulated trajectories, it visits the same distributions."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.asktell import AskTell
from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import DistributionArchive
from adaptsim_jax.adaptation.phase2 import adapt
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.bdq import BDQConfig, make_bdq
from adaptsim_jax.mechanisms.double_pendulum import linear as model
from adaptsim_jax.tasks.pendulum.measured import measured_trajectory
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum
from tests.mechanisms.linear_trajectory import linear_trajectory

TARGET = (1.8, 0.3, 1.5, 1.5)


@pytest.fixture(scope="module")
def made():
    task = make_pendulum(PendulumConfig(scaling="paper", reference="optimum"))  # compiles sooner
    bdq = make_bdq(BDQConfig(obs_dim=task.space.dim + task.obs_dim, branches=task.space.dim))
    weights = bdq.init(jax.random.key(3)).online
    means = jnp.array([[0.2, 0.8, 0.5, 0.5], [0.9, 0.1, 0.3, 0.6]])
    starts = DistributionArchive(
        means, jax.vmap(task.init_policy)(jax.random.split(jax.random.key(0), 2))
    )
    return task, bdq, weights, starts


def told_all(made, trial):
    task, bdq, weights, starts = made
    loop = AskTell(task, bdq, weights, iterations=3)
    state, means, scores = loop.init(jax.random.key(1), starts), [], []
    for _ in range(loop.trials(state)):
        means.append(np.asarray(state.mean))
        state, info = loop.tell(state, trial(task, state))
        scores.append(float(info.score))
    return state, np.array(means), np.array(scores)


def simulated(task, state):
    return task.rollout(jax.random.key(0), state.policy, jnp.array(TARGET))


@pytest.mark.slow
@pytest.mark.parametrize("doubt", [0.0, 0.3])
def test_visits_and_deploys_what_phase_2_does(made, doubt):
    task, bdq, weights, starts = made
    task = replace(task, doubt=doubt)
    state, means, scores = told_all((task, bdq, weights, starts), simulated)
    result = adapt(jax.random.key(1), task, bdq, weights, starts, jnp.array(TARGET), StepPlan(3))
    np.testing.assert_allclose(means, result.history.mean.reshape(-1, 4), atol=1e-6)
    # compiled alone or under vmap, the Riccati solution differs by rounding of single precision
    np.testing.assert_allclose(scores, result.history.score.reshape(-1), rtol=1e-4)
    assert doubt or scores.argmax() == int(jnp.argmax(result.history.score))
    np.testing.assert_allclose(state.best_mean, result.mean, atol=1e-6)
    np.testing.assert_allclose(state.best_policy.gain, result.policy.gain, rtol=1e-3, atol=1e-4)


def recorded(policy, seconds=2.6, rate=500.0, velocities=True):
    """What a logger on the target would write, from the exact solution at its own rate."""
    A, B = model.linearized(jnp.array(TARGET))
    time = np.arange(0.0, seconds, 1.0 / rate)
    x, u = linear_trajectory(A, B, policy.gain, jnp.array(model.START), jnp.asarray(time))
    names = {"q1": x[:, 0], "q2": x[:, 1], "tau1": u[:, 0], "tau2": u[:, 1]}
    if velocities:
        names |= {"v1": x[:, 2], "v2": x[:, 3]}
    return {
        "time": time + 12.5,
        **{name: np.asarray(value, float) for name, value in names.items()},
    }


@pytest.mark.slow
@pytest.mark.parametrize("velocities", [True, False])
def test_a_measured_trial_has_the_return_and_observation_of_the_task(made, velocities):
    """Torques held from row to row are late by half a row; the loop decays at about 8/s, so 2 * 8 *
    0.25 ms.
    """
    task, _, _, starts = made
    policy = task.train(
        jax.random.key(0), jax.tree.map(lambda x: x[0], _gaussians(task, starts)), None
    )
    exact = task.rollout(jax.random.key(0), policy, jnp.array(TARGET))
    columns = recorded(policy, rate=2000.0, velocities=velocities)
    seen = measured_trajectory(columns, "trial.csv")
    np.testing.assert_allclose(seen.cost, exact.cost, rtol=0.005)
    np.testing.assert_allclose(seen.angles, exact.angles, atol=2e-3)


def _gaussians(task, starts):
    from adaptsim_jax.space import gaussian

    return gaussian(task.space, starts.mean)


def test_bad_trials_are_refused_in_a_line(made):
    task, _, _, starts = made
    policy = task.train(
        jax.random.key(0), jax.tree.map(lambda x: x[0], _gaussians(task, starts)), None
    )
    good = recorded(policy)
    bad = [
        ({**good, "time": good["time"][::-1]}, "time runs backwards"),
        ({name: column[:300] for name, column in good.items()}, "run the policy for 2.5 s"),
        ({**good, "q1": good["q1"] + np.pi}, "the task starts hanging"),
        ({**good, "q1": np.degrees(good["q1"])}, "column v1 is 0.0175 times the slope of q1"),
        (
            {name: column for name, column in good.items() if name != "tau2"},
            "column 'tau2' is missing",
        ),
    ]
    for columns, says in bad:
        with pytest.raises(BadInput, match=f"^trial.csv: .*{says}"):
            measured_trajectory(columns, "trial.csv")


def test_a_trial_that_is_not_finite_never_wins(made):
    def sometimes(task, state):
        out = simulated(task, state)
        return out._replace(cost=jnp.where(state.told == 1, jnp.nan, out.cost))

    state, _, scores = told_all(made, sometimes)
    assert np.isnan(scores[1]) and np.isfinite(state.best_score)


def test_no_iterations_are_refused(made):
    task, bdq, weights, _ = made
    with pytest.raises(BadInput, match="nothing would be adapted"):
        AskTell(task, bdq, weights, iterations=0)
