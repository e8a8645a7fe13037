"""What a reader of logs must know of a model, taken from the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptsim_jax.logs.log import ActuatorName, ModelNames

if TYPE_CHECKING:
    from adaptsim_jax.mechanisms.mjcf import Mechanism


def model_names(mechanism: Mechanism) -> ModelNames:
    """The names of a mechanism: joints, which of them slide, the tree, the actuators."""
    tree = mechanism.tree
    return ModelNames(
        joints=tuple(tree.joint_names),
        slides=tuple(name for name, kind in zip(tree.joint_names, tree.kinds, strict=True) if kind == "slide"),
        parents=tuple(int(parent) for parent in tree.parent),
        actuators=tuple(ActuatorName(a.name, tree.joint_names[a.joint], a.kind) for a in mechanism.actuators),
    )
