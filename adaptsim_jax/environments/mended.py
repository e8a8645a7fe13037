"""An environment whose model carries what `adaptsim diagnose` found of the same robot."""

import copy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.attribution.model_toml import OWN
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.effects.joints import catalogue
from adaptsim_jax.effects.joints.actuator import DELAY
from adaptsim_jax.environments import fields
from adaptsim_jax.mechanisms.model_numbers import array_at, element_names, element_number, place
from adaptsim_jax.mend.model_toml import Form, read_form

mjx = mjx_module()


HELD = {e.name for e in catalogue.OWN if e.in_mjcf and not e.shifts_commands}
SIMPLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
ATTRIBUTES = {
    "body": ("mass", "ipos", "iquat", "inertia"),
    "joint": tuple(fields.ATTRIBUTES["joint"]),
    "actuator": ("gainprm", "biasprm", "forcerange", "forcelimited"),
}


def mended(env: Any, path: str | Path) -> Any:
    """A copy of `env` with what a diagnosis changed in its robot.

    That is each number that `model.xml` has otherwise than `declared.xml`, by the names of bodies,
    joints and actuators. A delay becomes the environment's own.

    Args:
        env: Holds an `mjx.Model` and the `mujoco.MjModel` that it was made of.
        path: Of `model.toml`, with `declared.xml` and `model.xml` beside it, as `diagnose --out`
                writes them.

    Returns:
        An environment of the same kind. BadInput names an effect that no field of a model can say,
        or a name that `env` has not.
    """
    path = Path(path)
    table = configs.read(path)
    if table.get("task") != "mechanism":
        raise BadInput(
            f"{path}: task = {table.get('task')!r}; give the model.toml that `adaptsim diagnose` "
            "wrote of a robot"
        )
    holder = next((a for a in ("_mjx_model", "mjx_model") if a in vars(env)), None)
    keeper = next((a for a in ("_mj_model", "mj_model") if a in vars(env)), None)
    if holder is None or keeper is None:
        raise BadInput(
            f"{path}: {type(env).__name__} holds no mj_model and mjx_model of its own, so it "
            "cannot be mended"
        )
    form = read_form(table, str(path), OWN)
    declared, found = (_compiled(path.parent / name) for name in (form.model, "model.xml"))
    native = copy.deepcopy(getattr(env, keeper))
    delay = _delay(form, native)
    for kind in ATTRIBUTES:
        _copied(kind, native, declared, found, path)
    if not np.array_equal(declared.opt.gravity, found.opt.gravity):
        native.opt.gravity[:] = found.opt.gravity
    mujoco.mj_setConst(native, mujoco.MjData(native))
    one = copy.copy(env)
    object.__setattr__(one, keeper, native)
    object.__setattr__(one, holder, mjx.put_model(native, impl=getattr(env, holder).impl.value))
    object.__setattr__(one, "interface", {"delay": delay} if delay else {})
    return one


def _compiled(path: Path) -> mujoco.MjModel:
    if not path.exists():
        raise BadInput(
            f"{path}: no such file; keep it beside model.toml, as `adaptsim diagnose --out` wrote "
            "it"
        )
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise BadInput(f"{path}: {' '.join(str(error).split())}") from None


def _delay(form: Form, native: mujoco.MjModel) -> float:
    """s, the same for all actuators. BadInput where it is not, or where an effect is none that a
    model's fields can say.
    """
    late: dict[str, float] = {}
    for k, effect in enumerate(form.effects):
        if effect.name == DELAY.name:
            if "delay" in effect.parameters:
                value = effect.parameters["delay"].value
            else:
                value = None
            if value is None or value < 0:
                raise BadInput(
                    f"{form.path}: effects[{k}]: a delay of {value} s; give 0 or more, or delete "
                    "the effect"
                )
            late[effect.where] = value
        elif effect.name not in HELD:
            raise BadInput(
                f"{form.path}: effects[{k}]: no field of a model says '{effect.name}' of "
                f"{effect.where}; delete it from the file to go on without, or train where it is "
                "simulated"
            )
    driven = {native.joint(native.actuator_trnid[i, 0]).name for i in range(native.nu)}
    if late and (set(late) != driven or np.ptp(list(late.values())) > 1e-9):
        listed = ", ".join(f"{joint} {value:g} s" for joint, value in late.items())
        raise BadInput(
            f"{form.path}: delays differ between actuators ({listed}); an environment has one: "
            "give all the same"
        )
    return max(late.values(), default=0.0)


def _copied(
    kind: str,
    native: mujoco.MjModel,
    declared: mujoco.MjModel,
    found: mujoco.MjModel,
    path: Path,
) -> None:
    """What `found` has otherwise than `declared` into `native`; of actuators, what it has otherwise
    than `native`.
    """
    for i, name in enumerate(element_names(found, kind)):
        was = element_number(declared, kind, name) if name else -1
        if was < 0 or (kind == "joint" and int(found.jnt_type[i]) not in SIMPLE):
            continue
        own = element_number(native, kind, str(name))
        if kind == "actuator" and own >= 0:
            other, at = (native, own)
        else:
            other, at = (declared, was)
        for attribute in ATTRIBUTES[kind]:
            value = _number(found, kind, attribute, i)[0]
            there = _number(other, kind, attribute, at)[0]
            if np.allclose(value, there, rtol=1e-9, atol=1e-12):
                continue
            if own < 0:
                known = [other for other in element_names(native, kind) if other]
                near = configs.suggest(str(name), known)
                raise BadInput(f"{path}: the environment's model has no {kind} '{name}'; {near}")
            _number(native, kind, attribute, own)[...] = value


def _number(model: mujoco.MjModel, kind: str, attribute: str, element: int) -> np.ndarray:
    """`[1, ...]`, where it stands in the model."""
    array, row = place(model, kind, attribute, element)
    return array_at(model, array)[row : row + 1]
