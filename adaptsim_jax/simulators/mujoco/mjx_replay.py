"""A model file over a recording in MJX, from the starts that MuJoCo C has fitted: what MJX ignores
of a file costs, in numbers.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco.acting import control_of
from adaptsim_jax.simulators.mujoco.build import stepped
from adaptsim_jax.simulators.mujoco.rollouts import initial_states, read, residual
from adaptsim_jax.simulators.mujoco.starts import fitted, position_weight
from adaptsim_jax.simulators.mujoco.stretches import cut

STRETCHES = 24  # a median needs no more, and MJX steps slowly on a CPU


def mjx_errors(source: Source, log: Log, horizon: float) -> np.ndarray:
    """rms over time [W, n] rad or m by stretch and joint of the log, for logs without a moving base
    or sensors.
    """
    made = stepped(source, log)
    span = min(horizon, max(t.span for t in log.trials))
    stretches = cut(made, log, span, STRETCHES)
    starts, _ = fitted(made, stretches, position_weight(made, stretches))
    lanes = np.arange(stretches.count)
    states = initial_states(made, stretches, starts, lanes)
    control, spec = control_of(made, stretches, lanes, None)
    path = _stepped(made.model, states, control, spec)
    off = residual(made, stretches, read(made, stretches, path, path, lanes), lanes)
    n = len(made.angle)
    seen = stretches.seen[..., :n]
    return np.sqrt(np.square(off[..., :n]).sum(1) / np.maximum(seen.sum(1), 1))


def _stepped(model: mujoco.MjModel, states: np.ndarray, control: np.ndarray, spec: int):
    """States [W, S + 1, 1 + nq + nv + na] of MJX under controls [W, S, .] from full states."""
    mjx = mjx_module()
    nq, nv, na = model.nq, model.nv, model.na
    own = mjx.put_model(model)
    told = "ctrl" if spec == int(mujoco.mjtState.mjSTATE_CTRL) else "qfrc_applied"

    def run(state, rows):
        _, qpos, qvel, act = jnp.split(state[: 1 + nq + nv + na], [1, 1 + nq, 1 + nq + nv])
        first = mjx.make_data(own).replace(qpos=qpos, qvel=qvel, act=act)

        def step(data, row):
            after = mjx.step(own, data.replace(**{told: row}))
            return after, jnp.concatenate([after.time[None], after.qpos, after.qvel, after.act])

        return jax.lax.scan(step, first, rows)[1]

    every = jax.jit(jax.vmap(run))(
        jnp.asarray(states, jnp.float32), jnp.asarray(control, jnp.float32)
    )
    size = 1 + nq + nv + na
    return np.concatenate([states[:, None, :size], np.asarray(every, float)], 1)
