"""Episodes as a film needs them: places of a model's joints over time, of policies in a target."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from adaptsim_jax.environments.rollout import Acting
from adaptsim_jax.environments.task import Setting, play_in


def filmed_episode(
    setting: Setting, acting: Acting, policy: Any, target: str
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """`(qpos [T, nq], mocap [T, 3 n], s a row, the model's bytes)` of one episode of `policy` in
    the target, from a start that is the same for all policies.
    """
    play, values = play_in(setting, setting.targets[target])

    @jax.jit
    def run(policy):
        world = play.world(values)
        live = play.reset(world, jax.random.key(0))

        def step(carry, key):
            live, memory = carry
            action, memory = acting.act(key, policy, memory, live)
            after = play.step(world, live, action)
            data = setting.sim.data(after.state)
            return (after, memory), (data.qpos, data.mocap_pos.reshape(-1), after.done)

        keys = jax.random.split(jax.random.key(1), setting.sim.length)
        return jax.lax.scan(step, (live, acting.start(policy)), keys)[1]

    qpos, mocap, done = map(np.asarray, run(jax.tree.map(jnp.asarray, policy)))
    over = np.flatnonzero(done > 0)
    end = int(over[0]) + 1 if len(over) else len(qpos)
    return qpos[:end], mocap[:end], setting.sim.dt, model_bytes(setting.sim.native)


def model_bytes(model: Any) -> np.ndarray:
    """A compiled model as bytes (mjb)."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer
