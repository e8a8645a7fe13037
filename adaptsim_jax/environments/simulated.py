"""An environment as pure functions of its model: anything with `reset(key)` and `step(state,
action)` over an `mjx.Model`.

MuJoCo Playground and Brax hold the model as an attribute, and close their functions over it. Here a
shallow copy of the environment holds the model that it is given, a tracer under `jit`: parameters
are arguments, and one compiled step serves all of them.
"""

import contextlib
import copy
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import function_named
from adaptsim_jax.environments.fields import Field, edit_native, edited

Physics = Callable[[Any, Any, Any, int], Any]  # (model, data, ctrl [nu], substeps) -> data
OWN = {
    "cartpole": "adaptsim_jax.environments.cartpole:make",
    "arm": "adaptsim_jax.environments.arm:make",
}


@dataclass(frozen=True)
class Simulated:
    """Pure functions of one sample. `model`: a pytree, of which `edit` replaces the fields; actions
    lie in [-1, 1].

    native: the file's model, None where there is none (gymnax). length: steps of an episode, of
    `dt` s each. interface: nominal values of its fields, where they are others than usual (a delay
    that was measured).
    """

    name: str
    native: mujoco.MjModel | None
    model: Any
    action_dim: int
    length: int
    dt: float
    reset: Callable[[Any, jax.Array], Any]  # (model, key) -> state
    step: Callable[..., Any]  # (model, state, action [A], physics=None) -> state
    seen: Callable[
        [Any], tuple[jax.Array, jax.Array, jax.Array]
    ]  # state -> obs [O], reward [], done [] (float)
    data: Callable[[Any], Any]  # state -> mjx.Data, None where there is none
    edit: Callable[[Any, tuple[Field, ...], jax.Array], Any] = edited
    interface: Mapping[str, float] = field(default_factory=dict)

    @property
    def names(self) -> Any:
        """Where fields are found by name: the file's model, or gymnax's parameters."""
        if self.native is None:
            return self.model
        return self.native


def load(name: str, options: dict[str, Any] | None = None, where: str = "env") -> Any:
    """The environment called `name`: `cartpole` or `arm` of ours, `playground:NAME`, `brax:NAME`,
    `gymnax:NAME`, `module:function` or `file.py:function`. options: given to it. BadInput says what
    is missing, and how to get it.
    """
    home, colon, thing = OWN.get(name, name).rpartition(":")
    options = dict(options or {})
    if not colon:
        known = [
            *OWN,
            "playground:NAME",
            "brax:NAME",
            "gymnax:NAME",
            "module:function",
            "file.py:function",
        ]
        raise BadInput(f"{where}: environment '{name}' is unknown; {suggest(name, known)}")
    if home in _PEERS:
        return _PEERS[home](thing, options, where)
    made = function_named(f"{home}:{thing}", where)
    try:
        inspect.signature(made).bind(**options)
    except TypeError as error:
        raise BadInput(f"{where}: {name}: {error}; mend [options]") from None
    return made(**options)


def _playground(name: str, options: dict[str, Any], where: str) -> Any:
    registry = _peer("mujoco_playground", "playground", where).registry
    if name not in registry.ALL_ENVS:
        raise BadInput(f"{where}: Playground has no '{name}'; {suggest(name, registry.ALL_ENVS)}")
    known = registry.get_default_config(name)
    for key in options:
        if key not in known:
            raise BadInput(
                f"{where}: options.{key}: '{name}' has no such option; {suggest(key, known)}"
            )
    if "impl" in known:
        options = {
            "impl": "jax"
        } | options  # Playground's own default is for GPUs, and twenty times slower on a CPU
    if options.get("impl") == "warp":
        _peer("warp", "warp-lang", f'{where}: impl = "warp"')
        if jax.default_backend() == "cpu":
            print(
                f'{where}: impl = "warp" is slow on a CPU; set impl = "jax" in [options]',
                file=sys.stderr,
            )
    return registry.load(name, config_overrides=options)


def _brax(name: str, options: dict[str, Any], where: str) -> Any:
    envs = _peer("brax.envs", "brax", where)
    return envs.get_environment(name, **({"backend": "mjx"} | options))


def _gymnax(name: str, options: dict[str, Any], where: str) -> Any:
    gymnax = _peer("gymnax", "gymnax", where)
    if name not in gymnax.registered_envs:
        raise BadInput(f"{where}: gymnax has no '{name}'; {suggest(name, gymnax.registered_envs)}")
    return gymnax.make(name, **options)[0]


def _peer(module: str, package: str, where: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise BadInput(
            f"{where}: needs {package} ({error.name} is missing); pip install {package}"
        ) from None


_PEERS: dict[str, Callable[[str, dict[str, Any], str], Any]] = {
    "playground": _playground,
    "brax": _brax,
    "gymnax": _gymnax,
}


def simulated(
    env: Any, fields: tuple[Field, ...] = (), length: int = 0, where: str = "env"
) -> Simulated:
    """`env` as pure functions of its model. fields: those that will be edited; where the file has
    one of them at 0, such as a dry friction, the model is built so that it can act. BadInput where
    `env` has no `reset` or `step`, or no model to edit.
    """
    for name in ("reset", "step"):
        if not callable(getattr(env, name, None)):
            raise BadInput(
                f"{where}: the environment has no {name}(...); see docs/howto/environment.md for "
                f"what it needs"
            )
    holder = next((a for a in ("_mjx_model", "mjx_model", "sys") if hasattr(env, a)), None)
    if holder is None:
        raise BadInput(
            f"{where}: the environment holds no mjx.Model (as mjx_model or sys), so it has no "
            f"fields to adapt"
        )
    for name in ("action_size", "dt"):
        if not hasattr(env, name):
            raise BadInput(
                f"{where}: the environment has no {name}; see docs/howto/environment.md for what "
                f"it needs"
            )
    native = getattr(env, "mj_model", None) or getattr(getattr(env, "sys", None), "mj_model", None)
    if native is None:
        raise BadInput(
            f"{where}: the environment holds no mujoco.MjModel (as mj_model) to find names in; add "
            f"it"
        )

    def bound(model):
        one = copy.copy(env)
        object.__setattr__(one, holder, model)
        return one

    def reset(model, key):
        with jax.numpy_rank_promotion("allow"):  # MJX promotes ranks
            return bound(model).reset(key)

    def step(model, state, action, physics: Physics | None = None):
        with jax.numpy_rank_promotion("allow"), _physics(physics, type(env).__name__):
            return bound(model).step(state, action)

    def seen(state):
        if isinstance(state.obs, dict):
            obs = state.obs["state"]
        else:
            obs = state.obs
        done = jnp.asarray(state.done, jnp.float32)
        return obs.astype(jnp.float32), jnp.asarray(state.reward, jnp.float32), done

    return Simulated(
        name=type(env).__name__,
        native=native,
        model=_awake(getattr(env, holder), native, fields),
        action_dim=int(env.action_size),
        length=length or _length(env),
        dt=float(env.dt),
        reset=reset,
        step=step,
        seen=seen,
        data=lambda state: getattr(state, "data", getattr(state, "pipeline_state", None)),
        interface=getattr(env, "interface", {}),
    )


def _length(env: Any) -> int:
    config = getattr(env, "_config", None)
    found = getattr(env, "length", None) or getattr(config, "episode_length", None)
    return int(found or 1000)


def _awake(model: Any, native: mujoco.MjModel, fields: tuple[Field, ...]) -> Any:
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
def _physics(physics: Physics | None, name: str) -> Iterator[None]:
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
    mjx.step = lambda model, data: counted(model, data, data.ctrl, 1)
    if peer is not None:
        peer.step = lambda model, data, action, n_substeps=1: counted(
            model, data, action, n_substeps
        )
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


def advance(model: Any, data: Any, ctrl: jax.Array, substeps: int) -> Any:
    """`data` after `substeps` steps under `ctrl [nu]`, in MJX or in what a target steps with."""
    if _ACTING:
        return _ACTING[-1](model, data, ctrl, substeps)

    def one(data, _):
        return mjx.step(model, data.replace(ctrl=ctrl)), None

    return jax.lax.scan(one, data, None, substeps)[0]
