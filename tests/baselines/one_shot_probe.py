"""A task of one decision a trial whose every answer is known: an action times a hidden gain lands
at `gain * action + bias`.
"""

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.one_shot import OneShot, TargetWorld, best_actions

SPACE = Space((Parameter("gain", 1.0, 2.0), Parameter("bias", -0.2, 0.2)))
SETTINGS = {"wd": {"gain": 1.4, "bias": 0.1}, "ood-1": {"gain": 2.6, "bias": 0.1}}
TESTS = np.linspace(-0.8, 0.8, 5, dtype=np.float32)[:, None]


def lands(params, action):
    return params[..., :1] * action + params[..., 1:]


def reward(outcome, context):
    value = jnp.maximum(0.0, 1.0 - jnp.abs(outcome[0] - context[0]))
    return jnp.where(jnp.isfinite(value), value, 0.0)


def act(policy, contexts):
    """A policy is the parameters that it believes in."""
    return jnp.clip((contexts - policy[1]) / policy[0], -1.0, 1.0)


def probe_world(breaks_above: float = np.inf) -> TargetWorld:
    """Trials that land above `breaks_above` fail with code 7."""

    def run(params, contexts, actions):
        outcomes = np.asarray(lands(params, actions), np.float32)
        codes = np.where(outcomes[:, 0] > breaks_above, 7, 0)
        return np.where((codes == 0)[:, None], outcomes, np.nan), codes

    return TargetWorld("probe", run, {0: "fine", 7: "landed too far"})


def probe_task() -> Task:
    def rollout(key, policy, params):
        contexts = jax.random.uniform(key, (2, 1), minval=-1.0)
        return contexts, lands(params[None], act(policy, contexts))

    def score(trajectory):
        return jax.vmap(reward)(trajectory[1], trajectory[0]).mean()

    return Task(
        name="probe",
        space=SPACE,
        targets=SPACE,
        obs_dim=4,
        settings=SETTINGS,
        init_policy=lambda key: jnp.array([1.5, 0.0]),
        train=lambda key, dist, policy: SPACE.physical(dist.mean),
        rollout=rollout,
        observe=lambda trajectory: jnp.nan_to_num(
            jnp.concatenate([t.reshape(-1) for t in trajectory]), nan=4.0
        ),
        score=score,
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: score(trajectory),
    )


def _tune(key, policy, contexts, actions, outcomes, used):
    """Least squares of gain and bias on the first `used` trials."""
    told = (jnp.arange(len(actions)) < used)[:, None]
    rows = jnp.concatenate([actions, jnp.ones_like(actions)], 1) * told
    found = jnp.linalg.solve(rows.T @ rows + 1e-6 * jnp.eye(2), rows.T @ (outcomes * told)[:, 0])
    return jnp.where(used > 1, found, policy)


def probe(breaks_above: float = np.inf) -> OneShot:
    task = probe_task()

    def oracle(world, params):
        return best_actions(world, params, TESTS, reward, (401,), shared=True)[0]

    return OneShot(
        task=task,
        tests=TESTS,
        trials=2,
        action_dim=1,
        draw=lambda key: jax.random.uniform(key, (1,), minval=-1.0),
        act=act,
        explore=lambda key, policy, contexts: (
            act(policy, contexts) + 0.1 * jax.random.normal(key, contexts.shape)
        ),
        reward=reward,
        trajectory=lambda contexts, outcomes: (contexts, outcomes),
        train_uniform=lambda key: jnp.array([1.5, 0.0]),
        tune=_tune,
        outputs=lambda outcome: outcome,
        worth=lambda told, context: 1.0 - jnp.abs(told[0] - context[0]),
        world=lambda engine, **options: probe_world(breaks_above),
        oracle=oracle,
        engine="probe",
        simulator="a line",
        reward_unit="1 - distance",
        oracle_means="a fine grid",
    )
