"""The engines of scooping against each other: how often the same trials end alike, pair by pair, and how fast each computes.

Outcomes are success or failure, and Drake does not agree with itself at another mesh or step: that is the ceiling for anyone.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models.backends import scooping as backend
from adaptsim_jax.models.backends.scooping_drake import DrakeContact
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.progress import Report, silent

LOW_RELAXATION = 0.02
"""s: of the pair that is compared with hardly any dissipation, where contact is least a matter of numerics."""
ENGINES = ("hydro", "drake", "drake_finer_mesh", "drake_other_step", "hydro_low", "drake_low")
_SETTINGS: dict[str, dict[str, Any]] = {
    "hydro": {"numerics": Numerics()},
    "drake": {"contact": DrakeContact()},
    "drake_finer_mesh": {"contact": DrakeContact(resolution=0.003)},
    "drake_other_step": {"contact": DrakeContact(dt=0.005)},
    "hydro_low": {"numerics": replace(Numerics(), relaxation=LOW_RELAXATION)},
    "drake_low": {"contact": DrakeContact(relaxation=LOW_RELAXATION)},
}


class Run(NamedTuple):
    """success `[B]`, codes `[B]`, and seconds: the first call (compiling), and a trial of a warm call by wall and by CPU."""

    success: np.ndarray
    code: np.ndarray
    first: float
    each: float
    cpu_each: float


def scooping_parity(*, samples: int = 32, seed: int = 0, progress: Report = silent) -> dict[str, Any]:
    """Success or failure of `samples` random trials in every engine that is installed.

    `engines` has a row each: success by shape, speed, codes, or why it did not run; `pairs` the share of trials that ended
    alike in both, of those that went well, with a 95 % interval (Wilson).
    """
    params, actions = model.draw(seed, samples)
    batch = (params, actions, np.zeros((samples, 2)))
    runs, engines = {}, []
    for done, name in enumerate(ENGINES):
        progress(done, len(ENGINES), name)
        try:
            runs[name] = run = _run(_backend(name), batch, name)
        except BadInput as error:
            engines.append({"engine": name, "ran": False, "why": str(error)})
            continue
        engines.append({"engine": name, "ran": True, **_row(run, params[:, 2])})
    pairs = [{"pair": [a, b], **_alike(runs[a], runs[b])} for a, b in itertools.combinations(runs, 2)]
    return {
        "schema": 1,
        "task": "scooping",
        "samples": samples,
        "seconds": model.SECONDS,
        "cores": os.cpu_count(),
        "engines": engines,
        "pairs": pairs,
    }


def _backend(name: str) -> Callable:
    return backend.make_backend(name.split("_")[0], **_SETTINGS[name]).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> Run:
    """Drake compiles nothing, so its first call is its only one."""
    out, first, cpu = _timed(simulate, batch)
    count = len(batch[0])
    if name.startswith("drake"):
        return Run(backend.outcome(out.state)[0], out.code, 0.0, first / count, cpu / count)
    out, seconds, cpu = _timed(simulate, batch)
    return Run(backend.outcome(out.state)[0], out.code, first, seconds / count, cpu / count)


def _timed(simulate: Callable, batch: tuple) -> tuple[Any, float, float]:
    begin, cpu = time.perf_counter(), time.process_time()
    out = simulate(*batch)
    return out, time.perf_counter() - begin, time.process_time() - cpu


def _row(run: Run, shape: np.ndarray) -> dict[str, Any]:
    codes = {model.MESSAGES[c]: int((run.code == c).sum()) for c in model.MESSAGES if c and (run.code == c).any()}
    share = lambda rows: float(run.success[rows].mean()) if rows.any() else None
    return {
        "success": float(run.success.mean()),
        "success_by_shape": {model.SHAPES[g]: share(shape == g) for g in range(2)},
        "trials_per_second": 1 / run.each,
        "trials_per_cpu_second": 1 / max(run.cpu_each, 1e-9),
        "first_call_s": run.first,
        "went_wrong": codes,
    }


def _alike(a: Run, b: Run) -> dict[str, Any]:
    good = (a.code == model.FINE) & (b.code == model.FINE)
    count = int(good.sum())
    if not count:
        return {"compared": 0}
    share = float((a.success == b.success)[good].mean())
    low, high = wilson(share, count)
    return {"compared": count, "alike": share, "low": low, "high": high}


def wilson(share: float, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share of `count` trials."""
    z = 1.96
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return float(middle - half), float(middle + half)
