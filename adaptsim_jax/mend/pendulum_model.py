"""The double pendulum's `model.toml`: what the form holds for it, checked against its model.

    model = "rigid_body"            # or "linearized"
    angle_zero = "hanging"          # or "upright"
    [geometry]                      # l1, l2 in m, g in m/s^2
    [known]                         # parameters that were not fitted

The rest is as every `model.toml` has it (`model_toml.py`). What files of before say of a clock and
of a covariance is read over.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.effects.registry import catalogue, effect_named
from adaptsim_jax.mechanisms.plant import Plant
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.mend.model_toml import (
    RENEW,
    AddedEffect,
    Form,
    Value,
    numbers_at,
    of_unit,
    read_form,
    text_at,
)

OWN = ("angle_zero", "geometry", "known", "trial_clock", "covariance")
USE = 'give it to diagnose (meta.toml: model = "..."), train or adapt'
FORMER = {
    "width": 0.02,
    "softness": 0.0,
    "bend": 0.0,
    "hardening": 0.0,
    "second_sine": 0.0,
    "second_cosine": 0.0,
    "damping": 0.0,
    "exponent": 1.0,
}
"""Finer shapes that files of before have, and the most by which they do nothing: read over then."""


@dataclass(frozen=True)
class ModelFile:
    """A model as `model.toml` holds it; `path` is where it was read from, `library` the catalogue
    that its effects are taken from (the task's where empty).
    """

    task: str
    model: str
    angle_zero: str
    geometry: dict[str, float]
    declared: dict[str, Value]
    effects: tuple[AddedEffect, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    path: str = "model.toml"
    library: tuple[Effect, ...] = ()

    def effect(self, name: str) -> Effect:
        """What an effect's name stands for; raises BadInput where neither library nor catalogue has
        it.
        """
        return effect_named(name, self.library or catalogue(self.task))

    @property
    def active(self) -> tuple[tuple[str, str], ...]:
        """(effect, where) of every effect."""
        return tuple((e.name, e.where) for e in self.effects)

    def plant(self) -> Plant:
        """The declared model without its effects."""
        return make_plant(self.model, self.angle_zero, self.geometry, self.known)

    def theta(self, plant: Plant) -> np.ndarray:
        """Declared parameters `[P]` in the plant's order."""
        return np.array([self.declared[name].value for name in plant.theta_names])

    def effect_vector(self, layout: Layout) -> np.ndarray:
        """Flat effect parameters `[E]`: everything off but this model's own effects."""
        out = layout.off()
        for e in self.effects:
            instance = layout.instances[layout.index(e.name, e.where)]
            given = {name: value.value for name, value in e.parameters.items()}
            out[instance.at] = [given.get(p.name, p.default) for p in instance.effect.parameters]
        return out


def text_of(model: ModelFile) -> str:
    """The TOML text of a model."""
    own: dict[str, Any] = {"angle_zero": model.angle_zero, "geometry": model.geometry}
    if model.known:
        own["known"] = model.known
    form = Form(model.task, model.model, model.declared, model.effects, own, model.provenance)
    return form.text(USE)


def write_model(path: str | Path, model: ModelFile) -> ModelFile:
    """Write `model.toml`, whole or not at all; returns the same with its path. Raises BadInput
    where it cannot.
    """
    write_bytes(path, text_of(model).encode())
    return replace(model, path=str(path))


def read_model(path: str | Path, effects: Sequence[Effect] | None = None) -> ModelFile:
    """Read and check a `model.toml`. effects: the catalogue that its effects are taken from (the
    task's where None).

    Raises BadInput that names the file, the key and the mend.
    """
    return model_of(config.read(path), str(path), effects)


def model_of(
    table: Mapping[str, Any], where: str, effects: Sequence[Effect] | None = None
) -> ModelFile:
    """The same from a table that was read already; `where` names it in errors."""
    form = read_form(table, where, OWN)
    for key in ("angle_zero", "geometry", "declared"):
        if key not in table:
            raise BadInput(f"{where}: key '{key}' is missing; {RENEW}")
    if form.task != "pendulum":
        raise BadInput(
            f"{where}: task = {form.task!r} has no models to mend in this version; known: pendulum"
        )
    geometry, known = numbers_at(where, table, "geometry"), numbers_at(where, table, "known")
    try:
        plant = make_plant(form.model, text_at(where, table, "angle_zero"), geometry, known)
    except BadInput as error:
        raise BadInput(f"{where}: {str(error).removeprefix('meta.toml: ')}") from None
    library = {e.name: e for e in effects or catalogue(form.task)}
    declared = _declared(where, form.declared, plant)
    added = tuple(_effect(where, i, e, plant, library) for i, e in enumerate(form.effects))
    return ModelFile(
        form.task,
        form.model,
        table["angle_zero"],
        geometry,
        declared,
        added,
        known,
        form.provenance,
        where,
        tuple(effects or ()),
    )


def _declared(where: str, given: Mapping[str, Value], plant: Plant) -> dict[str, Value]:
    for name in given:
        if name not in plant.theta_names:
            raise BadInput(
                f"{where}: unknown parameter 'declared.{name}'; the model has "
                f"{', '.join(plant.theta_names)}"
            )
    out = {}
    for name, unit, low, high in zip(
        plant.theta_names, plant.theta_units, plant.low, plant.high, strict=True
    ):
        if name not in given:
            raise BadInput(f"{where}: key 'declared.{name}' is missing; add it in {unit}")
        out[name] = value = of_unit(where, f"declared.{name}", given[name], unit)
        if not low <= value.value <= high:
            raise BadInput(
                f"{where}: declared.{name} = {value.value:g} {unit} is not within [{low:g}, "
                f"{high:g}]; mend it"
            )
    return out


def _effect(
    where: str, i: int, given: AddedEffect, plant: Plant, known: Mapping[str, Effect]
) -> AddedEffect:
    key = f"effects[{i}]"
    if given.name not in known:
        raise BadInput(
            f"{where}: {key}.name = {given.name!r} is not in the catalogue; "
            f"{config.suggest(given.name, known)}"
        )
    effect = known[given.name]
    places = plant.joints if effect.scope == "joint" else ("base",)
    if given.where not in places:
        raise BadInput(
            f"{where}: {key}.where = {given.where!r}; {given.name} acts at {' or '.join(places)}"
        )
    wanted = {p.name: p for p in effect.parameters}
    for name, value in given.parameters.items():
        if name not in wanted and value.value > FORMER.get(name, -np.inf):
            raise BadInput(
                f"{where}: unknown parameter '{key}.parameters.{name}'; {given.name} has "
                f"{', '.join(wanted)}"
            )
    values = {}
    for name, p in wanted.items():
        at = f"{key}.parameters.{name}"
        if name not in given.parameters:
            if p.optional:
                continue
            raise BadInput(f"{where}: key '{at}' is missing; add its value in {p.unit}")
        values[name] = value = of_unit(where, at, given.parameters[name], p.unit)
        if p.sign > 0 and value.value < 0:
            raise BadInput(
                f"{where}: {at} = {value.value:g} {p.unit} is negative, which this effect cannot "
                "be; mend it"
            )
    return replace(given, parameters=values)
