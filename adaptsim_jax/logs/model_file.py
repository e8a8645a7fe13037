"""A recording's own mended model, taken as the declared one."""

from collections.abc import Sequence

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.mend.pendulum_model import ModelFile, read_model


def declared_model(
    recording: Recording, effects: Sequence[Effect] | None = None
) -> ModelFile | None:
    """The mended model that a recording's `meta.toml` names, or None.

    Raises BadInput where the file is bad or is of another rig than the recording says.
    """
    if recording.model_file is None:
        return None
    given = read_model(recording.model_file, effects)
    for key in ("task", "model", "angle_zero"):
        there, here = getattr(given, key), getattr(recording, key)
        if there != here:
            raise BadInput(
                f"{given.path}: {key} = {there!r}, but meta.toml of the recording says {here!r}; "
                f"mend one"
            )
    for key in set(given.geometry) & set(recording.geometry):
        if abs(given.geometry[key] - recording.geometry[key]) > 1e-9 * abs(given.geometry[key]):
            raise BadInput(
                f"{given.path}: geometry.{key} = {given.geometry[key]:g}, but the recording has "
                f"{recording.geometry[key]:g}; a mended model is of one rig: mend one of them"
            )
    return given
