"""Our own engine of scooping as a backend, in batches on the CPU."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping.hydro import Numerics
from adaptsim_jax.tasks.scooping.interface import BATCH, ROW, STATE, checked, placed


class Settings(NamedTuple):
    """numerics: what makes up the simulator besides physics."""

    numerics: Numerics = Numerics()


def make_hydro(options: model.ScoopOptions, numerics: Numerics):
    hydro.check_numerics(numerics)
    every = round(ROW / numerics.dt)
    if abs(ROW / numerics.dt - every) > 1e-6:
        raise BadInput(
            f"backend hydro, dt = {numerics.dt} s must divide the row of {ROW} s; use 0.0025"
        )

    @jax.jit
    @jax.vmap
    def run(params, action):
        out = hydro.rollout(params, action, options, numerics)
        rows = slice(every, None, every)
        return out.piece[rows, :2], out.tip[rows], out.code

    def simulate(params, commands, initial):
        params, actions, starts = checked(params, commands, initial)
        state, codes = (
            np.zeros((len(params), round(model.SECONDS / ROW), STATE)),
            np.zeros(len(params), int),
        )
        for at in range(0, len(params), BATCH):
            room = np.minimum(
                np.arange(at, at + BATCH), len(params) - 1
            )  # the last batch is filled up
            kind = jnp.result_type(float)
            piece, tip, code = run(
                jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind)
            )
            here = slice(at, min(at + BATCH, len(params)))
            count = here.stop - at
            state[here, :, 0], state[here, :, 2] = np.moveaxis(np.asarray(piece)[:count], -1, 0)
            state[here, :, 3:], codes[here] = np.asarray(tip)[:count], np.asarray(code)[:count]
        return placed(state, codes, starts)

    return simulate


ENGINE = EngineKind(Settings, make_hydro)
