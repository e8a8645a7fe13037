"""The engines of scooping against each other: how often the same trials end alike, pair by pair,
and how fast each computes.

Outcomes are success or failure, and Drake does not agree with itself at another mesh or step: that
is the ceiling for anyone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.engine import (
    EngineRun,
    Parity,
    engine_lines,
    engines_and_pairs,
    pair_lines,
    speed_row,
    timed_run,
)
from adaptsim_jax.tasks.scooping import interface, model
from adaptsim_jax.tasks.scooping.engines import make_backend
from adaptsim_jax.tasks.scooping.engines.drake import ScoopContact
from adaptsim_jax.tasks.scooping.hydro import Numerics

LOW_RELAXATION = 0.02
"""s: of the pair that is compared with hardly any dissipation, where contact is least a matter of
numerics.
"""
ENGINES = (
    "hydro",
    "drake",
    "drake_finer_mesh",
    "drake_other_step",
    "hydro_low",
    "drake_low",
    "drake_low_finer_mesh",
    "native",
    "mjx",
)
_SETTINGS: dict[str, dict[str, Any]] = {
    "hydro": {"numerics": Numerics()},
    "drake": {"contact": ScoopContact()},
    "drake_finer_mesh": {"contact": ScoopContact(resolution=0.003)},
    "drake_other_step": {"contact": ScoopContact(dt=0.005)},
    "hydro_low": {"numerics": replace(Numerics(), relaxation=LOW_RELAXATION)},
    "drake_low": {"contact": ScoopContact(relaxation=LOW_RELAXATION)},
    "drake_low_finer_mesh": {"contact": ScoopContact(relaxation=LOW_RELAXATION, resolution=0.003)},
    "native": {},
    "mjx": {},
}


def scooping_parity(samples: int = 32, seed: int = 0, progress: Report = silent) -> dict[str, Any]:
    """Success or failure of `samples` random trials in every engine that is installed.

    `engines` has a row each: success by shape, speed, codes, or why it did not run; `pairs` the
    share of trials that ended alike in both, of those that went well, with a 95 % interval
    (Wilson).
    """
    params, actions = model.draw(seed, samples)
    batch = (params, actions, np.zeros((samples, 2)))

    def run(name):
        return _run(_backend(name), batch, name)

    def row(run):
        return _row(run, params[:, 2])

    found = engines_and_pairs(ENGINES, run, row, _alike, progress)
    return {"schema": 1, "task": "scooping", "samples": samples, "seconds": model.SECONDS, **found}


def _backend(name: str) -> Callable:
    return make_backend(name.split("_")[0], **_SETTINGS[name]).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> EngineRun:
    def outcome(state):
        return interface.outcome(state)[0]

    return timed_run(simulate, batch, outcome, compiles=not name.startswith("drake"))


def _row(run: EngineRun, shape: np.ndarray) -> dict[str, Any]:
    def share(rows):
        if rows.any():
            return float(run.outcome[rows].mean())
        return None

    shares = {model.SHAPES[g]: share(shape == g) for g in range(2)}
    success = {"success": float(run.outcome.mean()), "success_by_shape": shares}
    return success | speed_row(run, "trials", model.MESSAGES)


def _alike(a: EngineRun, b: EngineRun) -> dict[str, Any]:
    good = (a.code == model.FINE) & (b.code == model.FINE)
    count = int(good.sum())
    if not count:
        return {"compared": 0}
    alike = int((a.outcome == b.outcome)[good].sum())
    interval = binomtest(alike, count).proportion_ci(method="wilson")
    return {
        "compared": count,
        "alike": alike / count,
        "low": float(interval.low),
        "high": float(interval.high),
    }


def parity_lines(found: dict[str, Any]) -> list[str]:
    """The results of `scooping_parity` for a person."""

    def interval(row):
        return f"{row['alike']:6.3f} {row['low']:6.3f} - {row['high']:5.3f}"

    def numbers(row):
        shares = row["success_by_shape"].values()
        shapes = " ".join(f"{'-' if v is None else f'{v:.3f}':>9}" for v in shares)
        speeds = f"{row['trials_per_second']:9.1f} {row['trials_per_cpu_second']:9.1f}"
        return f"{row['success']:8.3f} {shapes} {speeds} {row['first_call_s']:9.1f} s"

    return [
        f"scooping: {found['samples']} random trials of {found['seconds']:g} s; share that ended "
        "alike, with 95 % intervals",
        "",
        *pair_lines(found, 36, f"{'alike':>6} {'interval':>14}", "trial", interval),
        "",
        "drake with itself at another mesh or step is the ceiling; low: hardly any dissipation",
        "",
        f"{'engine':18} {'success':>8} {'ellipsoid':>9} {'cylinder':>9} {'trials/s':>9} "
        f"{'per CPU s':>9} {'first call':>11}",
        *engine_lines(found, numbers),
    ]


PARITY = Parity(scooping_parity, parity_lines)
