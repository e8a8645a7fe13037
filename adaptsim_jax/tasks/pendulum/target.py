"""A mended model as the *target* of Phase 2: policies of any pendulum run act in a world that has
its effects.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mend.pendulum_model import ModelFile
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pendulum.augmented import cheapest, mended_space
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    MendedPolicy,
    MendedWorld,
    make_world,
    plain_policy,
    train_policy,
)
from adaptsim_jax.tasks.pendulum.task import PendulumPolicy


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
