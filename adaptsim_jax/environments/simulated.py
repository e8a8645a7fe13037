"""An environment as pure functions of its model: anything with `reset(key)` and `step(state,
action)` over an `mjx.Model`.

MuJoCo Playground and Brax hold the model as an attribute, and close their functions over it. Here a
shallow copy of the environment holds the model that it is given, a tracer under `jit`: parameters
are arguments, and one compiled step serves all of them.
"""

import contextlib
import copy
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jax import Array

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.effects.joints.actuator import DELAY
from adaptsim_jax.environments.fields import (
    OF_LAWS,
    Edit,
    Lawed,
    ModelField,
    edit_native,
    edited,
)
from adaptsim_jax.environments.laws import Laws, with_numbers

mjx = mjx_module()


Physics = Callable[[Any, Any, Any, int], Any]  # (model, data, ctrl [nu], substeps) -> data


@dataclass(frozen=True)
class SimulatedTask:
    """Pure functions of one sample. `model`: a pytree, of which `edit` replaces the fields; actions
    lie in [-1, 1].

    native: The file's model, None where there is none (gymnax). length: Steps of an episode, of
    `dt` s each. interface: Nominal values of its fields, where they are others than usual (a delay
    that was measured). laws: What acts beside MJX (`laws.py`), None where nothing does; they are in
    `model` too. late: The longest delay [s] that these hold, 0 where they hold none.
    """

    name: str
    native: mujoco.MjModel | None
    model: Any
    action_dim: int
    length: int
    dt: float
    reset: Callable[[Any, Array], Any]  # (model, key) -> state
    step: Callable  # (model, state, action [A], physics=None) -> state
    # state -> obs [O], reward [], done [] (float)
    observed: Callable[[Any], tuple[Array, Array, Array]]
    data: Callable[[Any], Any]  # state -> mjx.Data, None where there is none
    edit: Callable[[Any, tuple[ModelField, ...], Array], Any] = edited
    interface: Mapping[str, float] = field(default_factory=dict)
    late: float = 0.0
    laws: Any = None

    @property
    def names(self) -> Any:
        """Where fields are found by name: the file's model, with its laws where there are some, or
        gymnax's parameters.
        """
        if self.native is None:
            return self.model
        return self.native if self.laws is None else Lawed(self.native, own_fields(self.laws))


def simulated(
    env: Any, fields: tuple[ModelField, ...] = (), length: int = 0, where: str = "env"
) -> SimulatedTask:
    """`env` as pure functions of its model. fields: Those that will be edited; where the file has
    one of them at 0, such as a dry friction, the model is built so that it can act. BadInput where
    `env` has no `reset` or `step`, or no model to edit.
    """
    holder, native = _models_of(env, where)

    laws = getattr(env, "laws", None)

    def bound(model):
        one = copy.copy(env)
        if laws is not None:
            model, numbers = model
            object.__setattr__(one, "laws", numbers)
        object.__setattr__(one, holder, model)
        return one

    def reset(model, key):
        with jax.numpy_rank_promotion("allow"):  # MJX promotes ranks
            return bound(model).reset(key)

    def step(model, state, action, physics: Physics | None = None):
        with jax.numpy_rank_promotion("allow"), stepping_by(physics, type(env).__name__):
            return bound(model).step(state, action)

    def observed(state):
        obs = state.obs["state"] if isinstance(state.obs, dict) else state.obs
        name = type(env).__name__
        reward, done = (number_of(getattr(state, x), f"{name}.{x}") for x in ("reward", "done"))
        return vector_of(obs, f"{name}.obs"), reward, done

    model, delays = _awake(getattr(env, holder), native, fields), False
    if laws is not None:
        model, delays = (model, laws), DELAY.name in laws.values.effects
    return SimulatedTask(
        name=type(env).__name__,
        native=native,
        model=model,
        action_dim=int(env.action_size),
        length=length or _length(env),
        dt=float(env.dt),
        reset=reset,
        step=step,
        observed=observed,
        data=lambda state: getattr(state, "data", getattr(state, "pipeline_state", None)),
        edit=edited if laws is None else edited_both,
        interface=getattr(env, "interface", {}),
        late=(laws.past - 2) * native.opt.timestep if delays else 0.0,
        laws=laws,
    )


def edited_both(both: tuple[Any, Laws], fields: tuple[ModelField, ...], values: Array) -> Any:
    """A model and its laws with `values [F]` of `fields`; `delay` is that of every command."""
    model, laws = both
    numbers: dict[tuple[str, str, Any], Any] = {}
    for field_, value in zip(fields, values, strict=True):
        if field_.name == "delay" and DELAY.name in laws.values.effects:
            numbers[DELAY.name, "delay", ...] = value
        for edit in field_.edits:
            if edit.array.startswith(OF_LAWS):
                _, effect, parameter = edit.array.split("/")
                numbers[effect, parameter, edit.index[0]] = value
    of_model = [
        i for i, f in enumerate(fields) if not any(e.array.startswith(OF_LAWS) for e in f.edits)
    ]
    rest = tuple(fields[i] for i in of_model)
    return edited(model, rest, values[jnp.asarray(of_model, int)]), with_numbers(laws, numbers)


def own_fields(laws: Laws) -> dict[str, ModelField]:
    """The numbers of laws as fields, `effect:JOINT.EFFECT.PARAMETER`."""
    out = {}
    for effect in laws.model.effects:
        for p in effect.parameters:
            least = 0.0 if p.sign > 0 else -jnp.inf
            for j, joint in enumerate(laws.joints):
                name = f"effect:{joint}.{effect.name}.{p.name}"
                value = float(laws.values.effects[effect.name][p.name][j, 0])
                edit = Edit(f"{OF_LAWS}{effect.name}/{p.name}", (j,), 1.0)
                out[name] = ModelField(name, value, p.unit, least, (edit,))
    return out


def acting_physics() -> Physics | None:
    """What steps the model while a target is traced; None: MJX."""
    return _ACTING[-1] if _ACTING else None


def number_of(given: Any, what: str) -> Array:
    """`given`, one number of any type and shape, as float32 `[]`. BadInput says what `what` is."""
    found = _numbers(given, what)
    if found.size != 1:
        raise BadInput(
            f"{what}: has the shape {found.shape}; one number is wanted, such as data.qpos[0] for "
            "data.qpos"
        )
    return found.reshape(())


def vector_of(given: Any, what: str) -> Array:
    """`given`, numbers in a row or one alone, as float32 `[O]`. BadInput says what `what` is."""
    found = _numbers(given, what)
    if found.ndim > 1:
        raise BadInput(f"{what}: has the shape {found.shape}; a vector is wanted: add .reshape(-1)")
    return found.reshape(-1)


def _numbers(given: Any, what: str) -> Array:
    try:
        return jnp.asarray(given, jnp.float32)
    except (TypeError, ValueError):
        kind = type(given).__name__
        raise BadInput(f"{what}: is a {kind}; an array of numbers is wanted") from None


def _models_of(env: Any, where: str) -> tuple[str, mujoco.MjModel]:
    """The name of the attribute that holds the `mjx.Model`, and the file's model."""

    def wanted(lacks: str, mend: str = "see docs/howto/environment.md for what it needs"):
        return BadInput(f"{where}: the environment {lacks}; {mend}")

    for name in ("reset", "step"):
        if not callable(getattr(env, name, None)):
            raise wanted(f"has no {name}(...)")
    holder = next((a for a in ("_mjx_model", "mjx_model", "sys") if hasattr(env, a)), None)
    if holder is None:
        raise BadInput(
            f"{where}: the environment holds no mjx.Model (as mjx_model or sys), so it has no "
            "fields to adapt"
        )
    for name in ("action_size", "dt"):
        if not hasattr(env, name):
            raise wanted(f"has no {name}")
    native = getattr(env, "mj_model", None) or getattr(getattr(env, "sys", None), "mj_model", None)
    if native is None:
        raise wanted("holds no mujoco.MjModel (as mj_model) to find names in", "add it")
    return holder, native


def _length(env: Any) -> int:
    config = getattr(env, "_config", None)
    found = getattr(env, "length", None) or getattr(config, "episode_length", None)
    return int(found or 1000)


def _awake(model: Any, native: mujoco.MjModel, fields: tuple[ModelField, ...]) -> Any:
    """`model` with room for dry friction where a field has some and the file has none: MJX lays its
    rows out when it is built.
    """
    asleep = [
        f for f in fields if any("frictionloss" in e.array for e in f.edits) and f.nominal == 0
    ]
    if not asleep:
        return model
    own = copy.copy(native)
    edit_native(own, asleep, [1.0] * len(asleep))
    built = mjx.put_model(own, impl=model.impl.value)
    back = {e.array for f in asleep for e in f.edits}
    return built.tree_replace(
        {array: jnp.asarray(getattr(native, array), jnp.float32) for array in back}
    )


_ACTING: list[Physics] = []  # what steps the model while a target is traced; empty: MJX


@contextlib.contextmanager
def stepping_by(physics: Physics | None, name: str) -> Iterator[None]:
    """Within it environments step by `physics`: ours ask `advance`, Playground's a function of its
    module, others `mjx.step`.

    Raises BadInput where none of these was asked for: the target would be the simulator again,
    without a word.
    """
    if physics is None:
        yield
        return
    asked = []

    def counted(model, data, ctrl, substeps):
        asked.append(substeps)
        return physics(model, data, ctrl, substeps)

    peer: Any = sys.modules.get("mujoco_playground._src.mjx_env")
    theirs, plain = None if peer is None else peer.step, mjx.step
    _ACTING.append(counted)

    def mjx_step(model, data):
        return counted(model, data, data.ctrl, 1)

    def peer_step(model, data, action, n_substeps=1):
        return counted(model, data, action, n_substeps)

    mjx.step = mjx_step
    if peer is not None:
        peer.step = peer_step
    try:
        yield
    finally:
        _ACTING.pop()
        mjx.step = plain
        if peer is not None:
            peer.step = theirs
    if not asked:
        raise BadInput(
            f"{name}: its step does not reach the target's physics; call mjx.step, or advance of "
            "adaptsim_jax.environments.simulated, inside of step and without a jit of its own, or "
            'write engine = "simulator"'
        )


def advance(model: Any, data: Any, ctrl: Array, substeps: int) -> Any:
    """`data` after `substeps` steps under `ctrl [nu]`, in MJX or in what a target steps with."""
    if _ACTING:
        return _ACTING[-1](model, data, ctrl, substeps)

    def one(data, _):
        return mjx.step(model, data.replace(ctrl=ctrl)), None

    return jax.lax.scan(one, data, None, substeps)[0]
