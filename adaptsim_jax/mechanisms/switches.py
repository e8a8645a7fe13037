"""What a model file switches off, by the flags and groups of its <option>, is off in the compiled
model.
"""

import mujoco
import numpy as np

SWITCHED = {
    "equality": ("eq_active0",),
    "frictionloss": ("dof_frictionloss", "tendon_frictionloss"),
    "limit": ("jnt_limited", "tendon_limited"),
    "spring": (
        "jnt_stiffness",
        "jnt_stiffnesspoly",
        "tendon_stiffness",
        "tendon_stiffnesspoly",
    ),
    "damper": (
        "dof_damping",
        "dof_dampingpoly",
        "tendon_damping",
        "tendon_dampingpoly",
        "actuator_damping",
    ),
    "gravity": ("body_gravcomp",),
    "clampctrl": ("actuator_ctrllimited",),
}
"""Flag -> arrays of the model that act no more."""
CONSTRAINTS = ("equality", "frictionloss", "limit")


def has_off(model: mujoco.MjModel, flag: str) -> bool:
    """Whether a flag is disabled, by itself or with all constraints."""
    flags = int(model.opt.disableflags)
    is_constraint_off = flag in CONSTRAINTS and has_off(model, "constraint")
    return is_constraint_off or bool(
        flags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}"))
    )


def switch_off(model: mujoco.MjModel) -> None:
    """Set to zero what a file disables."""
    for flag, names in SWITCHED.items():
        if has_off(model, flag):
            for name in names:
                getattr(model, name)[:] = 0
    if has_off(model, "gravity"):
        model.opt.gravity[:] = 0.0
    if has_off(model, "spring") and has_off(model, "damper"):  # then no passive force acts at all
        model.body_gravcomp[:] = 0.0


def is_off(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator does nothing, by its group or by the flag of all."""
    group = int(model.actuator_group[actuator])
    is_group_off = group in np.flatnonzero(int(model.opt.disableactuator) >> np.arange(31) & 1)
    return is_group_off or has_off(model, "actuation")
