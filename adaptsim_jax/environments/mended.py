"""An environment whose model carries what `adaptsim diagnose` found of the same robot."""

import copy
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np

from adaptsim_jax.attribution.in_mjcf import other_joints
from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.model_toml import OWN, applied
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.effects.joints.actuator import DELAY
from adaptsim_jax.environments import fields
from adaptsim_jax.environments.found_laws import IN_MODEL, actuator_at, laws_of
from adaptsim_jax.environments.laws import Laws, advanced, read, room
from adaptsim_jax.environments.simulated import acting_physics, stepping_by
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.mechanisms.mjcf import mechanism_of
from adaptsim_jax.mechanisms.model_numbers import (
    array_and_row,
    array_at,
    element_names,
    element_number,
)
from adaptsim_jax.mechanisms.spec import read_source
from adaptsim_jax.mend.mjcf import Changes, lost_of, mended_mjcf
from adaptsim_jax.mend.model_toml import Form, read_form

mjx = mjx_module()

SIMPLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
ATTRIBUTES = {
    "body": ("mass", "ipos", "iquat", "inertia", "gravcomp"),
    "joint": tuple(fields.ATTRIBUTES["joint"]),
}


def mended(env: Any, path: str | Path) -> Any:
    """A copy of `env` with all that a diagnosis found of its robot.

    What MJX holds goes into the model, by the names of bodies, joints and actuators. The rest acts
    in each of its steps (`laws.py`): the copy's `laws`, a pytree of numbers.

    Args:
        env: Holds an `mjx.Model` and the `mujoco.MjModel` that it was made of.
        path: Of `model.toml`, with `declared.xml` beside it, as `diagnose --out` writes them.

    Returns:
        An environment of the same kind. BadInput names what does not fit: a name that `env` has
        not, an effect that needs an actuator where there is none.
    """
    path = Path(path)
    table = configs.read(path)
    if table.get("task") != "mechanism":
        raise BadInput(
            f"{path}: task = {table.get('task')!r}; give the model.toml that `adaptsim diagnose` "
            "wrote of a robot"
        )
    env = getattr(env, "declared", env)
    keeper = holders(env, str(path))[1]
    if lost_of(getattr(env, keeper)) is not None:
        raise BadInput(
            f"{path}: the environment's model is a model.xml, which has what was found; make the "
            "environment of the declared file, or leave model.toml out"
        )
    form = read_form(table, str(path), OWN)
    if form.own.get("linear"):
        raise BadInput(f"{path}: linear = true, which no engine of environments has; give another")
    declared = declared_machine(path.parent / form.model)
    found = applied(table, str(path), declared)
    native = copy.deepcopy(getattr(env, keeper))
    _put_model(native, declared, found, form)
    laws = laws_of(native, found, str(path))
    return lawful(env, native, laws)


def holders(env: Any, where: str) -> tuple[str, str]:
    """The names of the attributes that hold the `mjx.Model` and the `mujoco.MjModel`."""
    own = vars(env)
    holder = next((a for a in ("_mjx_model", "mjx_model") if a in own), None)
    keeper = next((a for a in ("_mj_model", "mj_model") if a in own), None)
    if holder is None or keeper is None:
        raise BadInput(
            f"{where}: {type(env).__name__} holds no mj_model and mjx_model of its own, so it "
            "cannot be mended"
        )
    return holder, keeper


def lawful(env: Any, native: mujoco.MjModel, laws: Laws | None) -> Any:
    """A copy of `env` over the model `native`, stepped by `laws`."""
    holder, keeper = holders(env, "env")
    mujoco.mj_setConst(native, mujoco.MjData(native))
    one = copy.copy(env)
    impl = getattr(env, holder).impl.value
    object.__setattr__(one, keeper, native)
    object.__setattr__(one, holder, mjx.put_model(native, impl=impl))
    object.__setattr__(one, "laws", laws)
    object.__setattr__(one, "declared", env)
    if laws is None:
        return one
    late = laws.values.effects.get(DELAY.name)
    delay = 0.0 if late is None else float(np.max(late["delay"]))
    object.__setattr__(one, "interface", {"delay": delay} if delay else {})
    own = type(env)
    if not issubclass(own, Lawful):
        object.__setattr__(one, "__class__", type(own.__name__, (Lawful, own), {}))
    return one


def as_asked(env: Any, where: str = "env") -> Any:
    """`env`, or a copy that has what its file asks of MJX and MJX ignores: delays of actuators,
    polynomials of damping and stiffness. BadInput where that cannot be.
    """
    own = getattr(env, "mj_model", None) or getattr(getattr(env, "sys", None), "mj_model", None)
    if own is None or hasattr(env, "laws"):
        return env
    native = copy.deepcopy(own)
    laws = laws_of(native, None, where)
    return env if laws is None else lawful(env, native, laws)


class Lawful:
    """Puts `laws` into the steps of the class beside it: what the policy sees is what the sensors
    say, rewards are of what there is.
    """

    laws: Laws

    def reset(self, key):
        """The start of an episode."""
        state: Any = super().reset(key)  # pyright: ignore[reportAttributeAccessIssue]
        data = data_of(state)
        state = with_data(state, data.replace(userdata=room(self.laws)))
        return self._seen(state, None)

    def step(self, state, action):
        """A step of the environment."""
        laws, other = self.laws, acting_physics()
        if other is not None and not laws.of_commands:
            raise BadInput(
                f"{type(self).__name__}: what was found acts within MJX's steps, and no other "
                'engine\'s; write engine = "simulator" for this target'
            )

        def physics(model, data, ctrl, substeps):
            return advanced(laws, model, data, ctrl, substeps, other)

        with stepping_by(physics, type(self).__name__):
            after: Any = super().step(state, action)  # pyright: ignore[reportAttributeAccessIssue]
        return self._seen(after, action)

    def _seen(self, state, action):
        """The same moment as the sensors show it: the environment's own observation of it."""
        if not self.laws.sensing:
            return state
        data = data_of(state)

        def physics(model, _, ctrl, substeps):
            shown = mjx.forward(model, read(self.laws, model, data))
            return shown.replace(ctrl=ctrl)

        if action is None:
            action = jnp.zeros(self.action_size)  # pyright: ignore[reportAttributeAccessIssue]
        with stepping_by(physics, type(self).__name__):
            seen: Any = super().step(state, action)  # pyright: ignore[reportAttributeAccessIssue]
        return _replaced(state, obs=seen.obs)


def data_of(state: Any) -> Any:
    """The `mjx.Data` of an environment's state."""
    return state.data if hasattr(state, "data") else state.pipeline_state


def with_data(state: Any, data: Any) -> Any:
    """The state with other data."""
    name = "data" if hasattr(state, "data") else "pipeline_state"
    return _replaced(state, **{name: data})


def _replaced(state: Any, **values: Any) -> Any:
    return state._replace(**values) if hasattr(state, "_replace") else state.replace(**values)


def declared_machine(path: Path) -> Machine:
    """The machine of a model file, commanded by its actuators, without a recording."""
    if not path.exists():
        raise BadInput(
            f"{path}: no such file; keep it beside model.toml, as `adaptsim diagnose --out` wrote "
            "it"
        )
    mechanism = mechanism_of(read_source(path))
    names = tuple(a.name for a in mechanism.actuators)
    joints = mechanism.tree.joint_names
    time, q = np.zeros(1), np.zeros((1, len(joints)))
    still = LogTrial("still", time, q, q, np.zeros((1, len(names))))
    log = Log(str(path), LogMeta(), joints, (still,), "command", names, joints)
    return machine(mechanism, log)


def _put_model(native: mujoco.MjModel, was: Machine, now: Machine, form: Form) -> None:
    """What MJX's model holds of a `model.toml`, where it is not as declared."""
    gravity = np.asarray(now.tree.gravity)
    changes = Changes(
        inertial=np.asarray(now.tree.inertial),
        joints=other_joints(was, now, IN_MODEL),
        gravity=gravity if np.any(gravity != was.tree.gravity) else None,
        lift=form.own.get("lift"),
    )
    declared, found = (
        mujoco.MjModel.from_xml_string(mended_mjcf(was.mechanism, c)) for c in (Changes(), changes)
    )
    for kind in ATTRIBUTES:
        _copied(kind, native, declared, found, form.path)
    if changes.gravity is not None:
        native.opt.gravity[:] = gravity
    for name in (*form.own.get("servo", {}), *form.own.get("gain", {})):
        _put_servo(native, name, now, form.path)


def _put_servo(native: mujoco.MjModel, joint: str, now: Machine, path: str) -> None:
    """The law of the actuator of a joint, as the diagnosis has it."""
    j = now.tree.joint_names.index(joint)
    k = actuator_at(native, joint, path)
    if k < 0:
        raise BadInput(
            f"{path}: servo.{joint}: the environment's model has no actuator at it; add one, or "
            "delete the table"
        )
    ratio = float(now.gear[j]) / float(native.actuator_gear[k, 0])
    law = now.actuator[:, j]
    native.actuator_gainprm[k, 0] = law[0] * ratio
    native.actuator_biasprm[k, :3] = law[1] * ratio, law[2] * ratio**2, law[3] * ratio**2
    native.actuator_biastype[k] = int(mujoco.mjtBias.mjBIAS_AFFINE)
    limits = np.sort(law[4:] * ratio)
    native.actuator_forcelimited[k] = bool(np.isfinite(limits).all())
    if native.actuator_forcelimited[k]:
        native.actuator_forcerange[k] = limits


def _copied(
    kind: str,
    native: mujoco.MjModel,
    declared: mujoco.MjModel,
    found: mujoco.MjModel,
    path: Path,
) -> None:
    """What `found` has otherwise than `declared` into `native`."""
    for i, name in enumerate(element_names(found, kind)):
        was = element_number(declared, kind, name) if name else -1
        if was < 0 or (kind == "joint" and int(found.jnt_type[i]) not in SIMPLE):
            continue
        own = element_number(native, kind, str(name))
        for attribute in ATTRIBUTES[kind]:
            value = _number(found, kind, attribute, i)[0]
            there = _number(declared, kind, attribute, was)[0]
            if np.allclose(value, there, rtol=1e-9, atol=1e-12):
                continue
            if own < 0:
                known = [other for other in element_names(native, kind) if other]
                near = configs.suggest(str(name), known)
                raise BadInput(f"{path}: the environment's model has no {kind} '{name}'; {near}")
            _number(native, kind, attribute, own)[...] = value


def _number(model: mujoco.MjModel, kind: str, attribute: str, element: int) -> np.ndarray:
    """`[1, ...]`, where it stands in the model."""
    array, row = array_and_row(model, kind, attribute, element)
    return array_at(model, array)[row : row + 1]
