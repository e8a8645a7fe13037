"""The mended model of a diagnosis, as it goes to `model.toml`."""

from typing import Any

import numpy as np

from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.mechanisms.model_file import AddedEffect, ModelFile, Value
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.problem import Problem


def fitted_model(problem: Problem, model: Fit, provenance: dict[str, Any] | None = None) -> ModelFile:
    """A fitted model, with its effects if it has any, as `model.toml` will hold it."""
    recording, plant, layout = problem.recording, problem.plant, problem.model.layout
    c = model.candidate
    spread = dict(zip(c.names, np.sqrt(np.diag(c.refit.covariance)), strict=True))

    def number(name: str, value: float, unit: str) -> Value:
        half = NINETY * float(spread.get(name, 0.0))
        return Value(float(value), float(value) - half, float(value) + half, unit, name in spread)

    declared = {n: number(n, x, u) for n, x, u in zip(plant.theta_names, c.theta, plant.theta_units, strict=True)}
    effects = []
    for name, where in c.active:
        instance = layout.instances[layout.index(name, where)]
        numbers = zip(instance.effect.parameters, c.eff[instance.at], strict=True)
        effects.append(
            AddedEffect(name, where, {p.name: number(f"{name}/{where}/{p.name}", x, p.unit) for p, x in numbers})
        )
    known = {k: float(v) for k, v in recording.known.items()}
    geometry = {k: float(v) for k, v in recording.geometry.items()}
    clock = {}
    if problem.phases(c.active):
        clock = {t.name: float(s) for t, s in zip(recording.trials, problem.windows.clock, strict=False)}
    return ModelFile(
        recording.task, recording.model, recording.angle_zero, geometry, declared, tuple(effects), known, c.names,
        c.refit.covariance, dict(provenance or {}), trial_clock=clock, library=layout.effects,
    )  # fmt: skip
