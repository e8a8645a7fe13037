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
from adaptsim_jax.simulators.mujoco.build import make_stepped_model
from adaptsim_jax.simulators.mujoco.rollouts import initial_states, read_channels, residual
from adaptsim_jax.simulators.mujoco.starts import fit_stretch_starts, position_weight
from adaptsim_jax.simulators.mujoco.stretches import cut_stretches

STRETCHES = 24  # a median needs no more, and MJX steps slowly on a CPU


def mjx_errors(source: Source, log: Log, horizon: float) -> np.ndarray:
    """Compute the RMS error over time [W, n] rad or m by stretch and joint of the log, for logs
    without a moving base or sensors.
    """
    stepped_model = make_stepped_model(source, log)
    span = min(horizon, max(t.span for t in log.trials))
    stretches = cut_stretches(stepped_model, log, span, STRETCHES)
    starts, _ = fit_stretch_starts(
        stepped_model, stretches, position_weight(stepped_model, stretches)
    )
    lanes = np.arange(stretches.count)
    states = initial_states(stepped_model, stretches, starts, lanes)
    control, spec = control_of(stepped_model, stretches, lanes, None)
    path = _step(stepped_model.model, states, control, spec)
    residuals = residual(
        stepped_model, stretches, read_channels(stepped_model, stretches, path, path, lanes), lanes
    )
    n = len(stepped_model.angle)
    is_measured = stretches.is_measured[..., :n]
    return np.sqrt(np.square(residuals[..., :n]).sum(1) / np.maximum(is_measured.sum(1), 1))


def _step(model: mujoco.MjModel, states: np.ndarray, control: np.ndarray, spec: int):
    """States [W, S + 1, 1 + nq + nv + na] of MJX under controls [W, S, .] from full states."""
    mjx = mjx_module()
    nq, nv, na = model.nq, model.nv, model.na
    mjx_model = mjx.put_model(model)
    input_field = "ctrl" if spec == int(mujoco.mjtState.mjSTATE_CTRL) else "qfrc_applied"

    def run(state, rows):
        _, qpos, qvel, act = jnp.split(state[: 1 + nq + nv + na], [1, 1 + nq, 1 + nq + nv])
        first = mjx.make_data(mjx_model).replace(qpos=qpos, qvel=qvel, act=act)

        def step(data, row):
            after = mjx.step(mjx_model, data.replace(**{input_field: row}))
            return after, jnp.concatenate([after.time[None], after.qpos, after.qvel, after.act])

        return jax.lax.scan(step, first, rows)[1]

    path = jax.jit(jax.vmap(run))(
        jnp.asarray(states, jnp.float32), jnp.asarray(control, jnp.float32)
    )
    size = 1 + nq + nv + na
    return np.concatenate([states[:, None, :size], np.asarray(path, float)], 1)
