"""Domain randomisation in the form that Playground and Brax take: `(model, rng [B]) -> (models,
in_axes)`.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import mujoco

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.fields import edited, space_of


def domain_randomize(
    native: mujoco.MjModel, ranges: Mapping[str, Any]
) -> Callable[[Any, jax.Array], tuple[Any, Any]]:
    """Fields by name, each drawn from its range for every environment.

    Args:
        native: the model that `ranges` names fields of.
        ranges: for each name `[low, high]`, or `[low, high, "log"]`, as in env.toml; not those of
                the interface, such as `delay`.

    Returns:
        `randomize(model, rng [B]) -> (models, in_axes)`: an `mjx.Model` whose edited arrays have a
        leading axis `[B]`, and the pytree that says which, as `randomization_fn` of Playground's
        and Brax's training takes it.
    """
    space, fields = space_of(native, ranges)
    for field in fields:
        if not field.edits:
            raise BadInput(
                f"domain_randomize: '{field.name}' is of the interface, not of the model; leave it "
                f"out"
            )
    arrays = sorted({edit.array for field in fields for edit in field.edits})

    def randomize(model: Any, rng: jax.Array) -> tuple[Any, Any]:
        def one(key):
            new = edited(model, fields, space.physical(space.sample(key)))
            return {array: _leaf(new, array) for array in arrays}

        in_axes = jax.tree.map(lambda _: None, model).tree_replace(dict.fromkeys(arrays, 0))
        return model.tree_replace(jax.vmap(one)(rng)), in_axes

    return randomize


def _leaf(model: Any, array: str) -> Any:
    for part in array.split("."):
        model = getattr(model, part)
    return model
