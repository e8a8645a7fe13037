"""Targets: the same model in MuJoCo C, with another integrator, a smaller step, and what Omega
cannot say.

A target is a table of values by field name, of Omega or not: dry friction, a delay beyond the box,
a weaker motor, a payload. What it does not name is as the file has it. Beside them it may say its
`engine`: `mujoco` (C; by default) or `simulator`; `integrator`; `steps`: how many of its steps make
one of the file's.
"""

import copy
import os
from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.environments.fields import ModelField, edit_native, field_of

mjx = mjx_module()


ENGINE = {"engine": "mujoco", "integrator": "implicitfast", "steps": 2}
SOLVED = (100, 50)
"""Iterations of the solver and its line search at most: a file may give few of them, for MJX's
speed.
"""
INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


DECLARED = "declared"
"""The model of a target that is the environment as it is without its `model`."""


class Target(NamedTuple):
    """values `[F]` of all fields, those of Omega first; the engine's name, integrator and steps;
    the `model.toml` that it has, `DECLARED`, or none.
    """

    values: np.ndarray
    engine: str
    integrator: str
    steps: int
    model: str = ""


def hidden_fields(
    model: Any, targets: Mapping[str, Any], omega: tuple[ModelField, ...]
) -> tuple[ModelField, ...]:
    """The fields that some target names and Omega does not have, in the order in which they
    come.
    """
    names: dict[str, str] = {}
    for target, table in targets.items():
        if not isinstance(table, Mapping):
            raise BadInput(
                f"targets.{target}: is no table; write [targets.{target}] and a line for each field"
            )
        for name in table:
            if name not in (*ENGINE, "model") and name not in {f.name for f in omega}:
                names.setdefault(name, target)
    return tuple(field_of(model, name, f"targets.{target}") for name, target in names.items())


def target_of(
    name: str, table: Mapping[str, Any], fields: tuple[ModelField, ...], compiled: bool
) -> Target:
    """The target called `name`. compiled: There is a MuJoCo model, so that C can run it."""
    values = np.array([f.nominal for f in fields], np.float64)
    for i, field in enumerate(fields):
        if field.name not in table:
            continue
        value = finite(table[field.name])
        if value is None or value < field.minimum:
            what = f"targets.{name}: '{field.name}' = {brief(table[field.name])}"
            raise BadInput(f"{what}; give a number of {field.minimum:g} {field.unit} or more")
        values[i] = value
    options = {key: table.get(key, ENGINE[key]) for key in ENGINE}
    engine = configs.pick("engine", str(options["engine"]), ("mujoco", "simulator"))
    configs.pick("integrator", str(options["integrator"]), INTEGRATORS)
    if type(options["steps"]) is not int or options["steps"] < 1:
        raise BadInput(
            f"targets.{name}: steps = {brief(options['steps'])}; give a whole number of 1 or more"
        )
    return Target(
        values,
        engine if compiled else "simulator",
        options["integrator"],
        options["steps"],
        str(table.get("model", "")),
    )


# what a step may be given, in the order in which MuJoCo packs it
INPUTS = (
    "ctrl",
    "qfrc_applied",
    "xfrc_applied",
    "eq_active",
    "mocap_pos",
    "mocap_quat",
    "userdata",
)


def native_physics(
    model: mujoco.MjModel, fields: tuple[ModelField, ...], target: Target
) -> Callable:
    """`physics(model, data, ctrl [nu], substeps) -> data`: MuJoCo C with the target's values,
    whatever the model that is given says. Forces, mocap poses and switches of equalities are those
    of `data`.

    Derived quantities are those of the state before the last of the file's steps, as MJX leaves
    them.
    """
    c = copy.deepcopy(model)
    c.actuator_delay[:] = 0.0  # a law of the environment's, since states have no past here
    edit_native(c, fields, target.values)
    c.opt.timestep = model.opt.timestep / target.steps
    c.opt.integrator = INTEGRATORS[target.integrator]
    c.opt.iterations = max(c.opt.iterations, SOLVED[0])
    c.opt.ls_iterations = max(c.opt.ls_iterations, SOLVED[1])
    nq, nv, held = c.nq, c.nv, 1 + c.nq + c.nv + c.na  # of a state: time, qpos, qvel, act
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    pool, datas = rollout.Rollout(nthread=threads), [mujoco.MjData(c) for _ in range(threads or 1)]
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    size = mujoco.mj_stateSize(c, spec)
    one_at_a_time = Lock()  # programs of several devices share the threads and their data

    def run(asked):
        lead, rows = asked.shape[:-1], np.array(asked, np.float64).reshape(-1, asked.shape[-1])
        B, n = len(rows), int(rows[:, -1].max()) * target.steps
        sound = np.isfinite(rows).all(1)
        rows[~sound] = 0.0
        start, warmed = np.zeros((B, size)), np.ascontiguousarray(rows[:, held : held + nv])
        start[:, :held] = rows[:, :held]
        given = {
            "control": rows[:, None, held + nv : -1],
            "control_spec": int(mujoco.mjtState.mjSTATE_USER),
            "initial_warmstart": warmed,
        }
        with one_at_a_time:
            states, _ = pool.rollout(c, datas, start, nstep=n, **given)
        before = states[:, -1 - target.steps] if n > target.steps else start
        both = np.concatenate([before[:, :held], states[:, -1, :held]], 1)
        both[~sound] = np.nan
        return both.astype(asked.dtype).reshape(*lead, -1)

    def physics(given, data, ctrl, substeps):
        time, count = jnp.asarray(data.time, jnp.float32), jnp.asarray(substeps, jnp.float32)
        data = data.replace(ctrl=jnp.broadcast_to(ctrl, (c.nu,)))
        inputs = [getattr(data, name).reshape(-1).astype(data.qpos.dtype) for name in INPUTS]
        parts = (time[None], data.qpos, data.qvel, data.act, data.qacc_warmstart, *inputs)
        asked = jnp.concatenate([*parts, count[None]])  # one array: each is a conversion
        out = jax.ShapeDtypeStruct((2 * held,), asked.dtype)
        both = jax.pure_callback(run, out, asked, vmap_method="broadcast_all")
        before, after = both[:held], both[held:]

        def put(data, row):
            time, qpos, qvel, act = jnp.split(row, np.cumsum([1, nq, nv]))
            as_it_was = {"qpos": qpos, "qvel": qvel, "act": act}
            as_it_was = {name: x.astype(getattr(data, name).dtype) for name, x in as_it_was.items()}
            return data.replace(time=time[0].astype(jnp.result_type(data.time)), **as_it_was)

        return put(mjx.forward(given, put(data, before)), after)

    return physics
