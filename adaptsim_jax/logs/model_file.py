"""`model.toml` written, and a recording's own mended model taken as the declared one.

`mechanisms/model_file.py` says what stands in the file and reads it.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from adaptsim_jax import __version__
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.mechanisms.model_file import SCHEMA, ModelFile, read_model

__all__ = ["ModelFile", "declared_model", "read_model", "write_model"]


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


def write_model(path: str | Path, model: ModelFile) -> ModelFile:
    """Write `model.toml`, whole or not at all; returns the same with its path. Raises BadInput
    where it cannot.
    """
    write_bytes(path, text_of(model).encode())
    return replace(model, path=str(path))


def text_of(model: ModelFile) -> str:
    """The TOML text of a model."""
    head = {
        "schema": SCHEMA,
        "task": model.task,
        "model": model.model,
        "angle_zero": model.angle_zero,
    }
    if model.known:
        head |= {"geometry": model.geometry, "known": model.known}
    else:
        head |= {"geometry": model.geometry}
    head["declared"] = {name: asdict(value) for name, value in model.declared.items()}
    parts = [
        '# A model fitted by `adaptsim diagnose`; give it to diagnose (meta.toml: model = "..."), '
        "train or adapt."
    ]
    parts.append(config.dumps(head))
    for effect in model.effects:
        parts.append("[[effects]]\n" + config.dumps({"name": effect.name, "where": effect.where}))
        for name, value in effect.parameters.items():
            parts.append(f"[effects.parameters.{name}]\n" + config.dumps(asdict(value)))
    if model.trial_clock:
        parts.append(config.dumps({"trial_clock": model.trial_clock}))
    covariance = {"names": list(model.names), "matrix": np.asarray(model.covariance).tolist()}
    provenance = {"package": f"adaptsim_jax {__version__}"} | model.provenance
    parts.append(config.dumps({"covariance": covariance, "provenance": provenance}))
    return "\n".join(parts)
