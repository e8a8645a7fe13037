"""The pendulum task on a mended model: the same swing-up and cost, with the effects of a
`model.toml` in the simulator.

Omega has the declared parameters and the effects' amplitudes, each around its fitted value.
Policies are those of `augmented_policy.py`.

The reward is 1 at the reference's cost. Of a linearized model that is the cost of the target's own
policy, which no other beats by much. Of a rigid body it is not: A gain that is optimal near the
goal is far from the best for a swing-up from hanging. Policies trained at other parameters cost
less in half of the cases. There the reference is the cheapest of the target's own policy and of
those of `SPREAD` points of Omega. Rewards above 1 still occur, but are rare.

`in_world` makes a mended model the target of Phase 2, in which policies of any pendulum run act.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats.qmc import Sobol

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.stepping import make_model
from adaptsim_jax.mend.pendulum_model import ModelFile, model_of, read_model
from adaptsim_jax.space import Parameter, Space, gaussian
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    MendedPolicy,
    MendedWorld,
    make_world,
    plain_policy,
    train_policy,
)
from adaptsim_jax.tasks.pendulum.task import SETTINGS, PendulumPolicy, paper_scaling

SPREAD = 16  # points of Omega whose policies a rigid body's reference is the best of


def mended_space(given: ModelFile) -> tuple[Space, list[tuple[str, ...]]]:
    """Omega around a mended model, and what each parameter is: `(theta,)` or `(effect, where,
    parameter)`.
    """
    plant = given.plant()
    parameters, keys = [], []
    for name, low, high in zip(plant.theta_names, plant.low, plant.high, strict=True):
        fitted = given.declared[name]
        damping = name.startswith("b")
        # rigid moments only make sense together
        if damping or given.model == "linearized":
            share = 0.5
        else:
            share = 0.1
        half = max(share * abs(fitted.value), 0.05 if damping else 1e-3)
        ends = max(fitted.value - half, 0.0 if damping else low), fitted.value + half
        parameters.append(
            Parameter(
                name,
                *ends,
                fitted.unit,
                physical_low=min(low, ends[0]),
                physical_high=max(high, ends[1]),
            )
        )
        keys.append((name,))
    for e in given.effects:
        effect = given.effect(e.name)
        for p in effect.amplitudes:
            v = e.parameters[p.name]
            assert v.low is not None and v.high is not None  # see `of_unit`
            half = max(0.5 * abs(v.value), v.high - v.low, 1e-3)
            low = max(v.value - half, 0.0) if p.sign > 0 else v.value - half
            inside = 0.0 if p.sign > 0 else -np.inf
            parameters.append(
                Parameter(
                    f"{e.name}_{e.where}_{p.name}", low, v.value + half, p.unit, physical_low=inside
                )
            )
            keys.append((e.name, e.where, p.name))
    return Space(tuple(parameters)), keys


def make_mended_pendulum(
    source: str | Path | Mapping[str, Any] | ModelFile, reward_gain: float = 10.0
) -> Task:
    """The pendulum task on the mended model of a `model.toml` (or its table): Phase 1 and 2 take it
    as any other.

    Raises BadInput where the file is no model.
    """
    given = _given(source)
    space, keys = mended_space(given)
    top = [p.high for p in space.parameters]
    split = _splitter(given, keys)
    world = make_world(given, np.asarray(split(np.asarray(top))[1]))

    def train(key, dist, policy):
        return train_policy(world, *split(space.physical(dist.mean)))

    def rollout(key, policy, params):
        return world.rollout(policy, *split(params))[0]

    def own(params):
        theta, eff = split(params)
        return world.rollout(train_policy(world, theta, eff), theta, eff)[0].cost

    def reference(params):
        if given.model == "linearized":
            return own(params)
        return jnp.minimum(own(params), cheapest(space, train, rollout, params))

    fitted = {p.name: _fitted(given, key) for p, key in zip(space.parameters, keys, strict=True)}
    settings = {"fitted": fitted}
    if given.model == "linearized":
        settings |= {name: fitted | dict(table) for name, table in SETTINGS.items()}
    empty = jax.eval_shape(
        lambda: train_policy(world, *split(jnp.asarray(list(fitted.values()), jnp.float32)))
    )
    return Task(
        name="pendulum",
        space=space,
        targets=space,
        obs_dim=24,
        settings=settings,
        init_policy=lambda key: jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), empty),
        train=train,
        rollout=rollout,
        observe=paper_scaling,
        score=lambda trajectory: -trajectory.cost,
        reference=reference,
        reward=lambda trajectory, best: 1.0 - reward_gain * (trajectory.cost / best - 1.0),
    )


def cheapest(space: Space, train, rollout, params) -> jax.Array:
    """Least cost `[]` at `params` of the policies of `SPREAD` points of Omega; they are the same
    for all `params`.
    """
    points = jnp.asarray(Sobol(space.dim, rng=0).random(SPREAD), jnp.float32)
    policies = jax.vmap(lambda u: train(None, gaussian(space, u), None))(points)
    return jnp.min(jax.vmap(lambda policy: rollout(None, policy, params).cost)(policies))


def _given(source) -> ModelFile:
    if isinstance(source, ModelFile):
        return source
    if isinstance(source, Mapping):
        return model_of(source, "model.toml")
    return read_model(source)


def _fitted(given: ModelFile, key: tuple[str, ...]) -> float:
    if len(key) == 1:
        return given.declared[key[0]].value
    return next(e.parameters[key[2]].value for e in given.effects if (e.name, e.where) == key[:2])


def _splitter(given: ModelFile, keys):
    """From task parameters `[D]` to theta `[P]` and effect parameters `[E]`; shapes stay as they
    were fitted.
    """
    names = dict.fromkeys(name for name, _ in given.active)
    layout = make_model(given.plant(), tuple(given.effect(n) for n in names)).layout
    base = np.asarray(given.effect_vector(layout), np.float32)
    every = layout.names()
    at = np.array([every.index(key) for key in keys if len(key) == 3], int)
    count = sum(len(key) == 1 for key in keys)

    def split(params):
        params = jnp.asarray(params, jnp.float32)
        theta, eff = params[:count], jnp.asarray(base)
        if len(at):
            eff = eff.at[at].set(params[count:])
        return theta, eff

    return split


def in_world(task: Task, given: ModelFile) -> tuple[np.ndarray, Task]:
    """`(params [D], task)`: the task with its rollouts in the mended model, whatever `params` say,
    and the parameters of Omega as the model has them (those of effects that it lacks: at the start
    of their range).

    Raises BadInput where the run was trained on another kind of pendulum.
    """
    values = {name: value.value for name, value in given.declared.items()}
    for e in given.effects:
        values |= {f"{e.name}_{e.where}_{p}": value.value for p, value in e.parameters.items()}
    for name in given.declared:
        if name not in task.space.names:
            raise BadInput(
                f"{given.path}: its parameter {name!r} is none of the run's "
                f"({', '.join(task.space.names)}); train on this model: adaptsim train pendulum "
                f"--model {given.path}"
            )
    params = np.array([values.get(p.name, p.low) for p in task.space.parameters])
    empty = jax.eval_shape(task.init_policy, jax.random.key(0))
    mended = isinstance(empty, MendedPolicy)
    world = make_world(given, history=empty.recent.shape[0] if mended else 2)
    theta = jnp.asarray(given.theta(world.model.plant), jnp.float32)
    eff = jnp.asarray(given.effect_vector(world.model.layout), jnp.float32)
    if mended:
        own = _same_effects(task, given, world, empty)
    else:

        def own(policy):
            return _linear(world, policy, theta, eff)

    def act(key, policy, params):
        return world.rollout(own(policy), theta, eff)[0]

    def best_known():
        best = world.rollout(train_policy(world, theta, eff), theta, eff)[0].cost
        if given.model == "linearized":
            return best
        return jnp.minimum(best, cheapest(task.space, task.train, act, None))

    best = jax.jit(best_known)()
    return params, replace(
        task,
        rollout=act,
        reference=lambda params: best,
    )


def _linear(world: MendedWorld, policy: PendulumPolicy, theta, eff) -> MendedPolicy:
    """A gain of the plain task as a law in this world: it knows no effect."""
    return plain_policy(world, theta, eff)._replace(gain=policy.gain, code=policy.code)


def _same_effects(task: Task, given: ModelFile, world: MendedWorld, empty: MendedPolicy):
    """Policies of a mended run act as they are; they must have been trained with this model's
    effects in mind.
    """
    alike = (
        mended_space(given)[0].names == task.space.names and empty.recent.shape[0] == world.history
    )
    if not alike or empty.eff.shape[0] != world.model.layout.size:
        raise BadInput(
            f"{given.path}: has other effects than the model that this run was trained on; train "
            f"on this one: adaptsim train pendulum --model {given.path}"
        )
    return lambda policy: policy
