"""The engines of the push against each other: where the same bottles end, pair by pair, and how fast each computes."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models import pushing
from adaptsim_jax.models.backends.pushing import make_backend
from adaptsim_jax.models.pushing import PAPER, PushOptions
from adaptsim_jax.progress import Report, silent

CEILING_STEP = 0.0025
"""s: the step of the second Drake, next to its usual 2 ms; what two settings of one engine differ by is the ceiling."""
PLANAR_BATCH = 4096
ENGINES = ("native", "mjx", "planar", "drake", "drake_other_step")


class Run(NamedTuple):
    """Final places `[B, 2]` m, codes `[B]`, and seconds: the first call (compiling), and a push of a warm call."""

    place: np.ndarray
    code: np.ndarray
    first: float
    each: float
    cpu_each: float


def pushing_parity(
    *, samples: int = 32, seed: int = 0, options: PushOptions = PAPER, progress: Report = silent
) -> dict[str, Any]:
    """Final positions of `samples` random pushes in every engine that is installed.

    `engines` has a row each: speed, codes, or why it did not run; `pairs` the differences of final positions over the pushes
    that went well in both: median, p90, p99 and max, mm.
    """
    batch = pushing.draw(seed, samples)
    runs, engines = {}, []
    for done, name in enumerate(ENGINES):
        progress(done, len(ENGINES), name)
        try:
            runs[name] = run = _run(_backend(name, options), batch, name)
        except BadInput as error:
            engines.append({"engine": name, "ran": False, "why": str(error)})
            continue
        engines.append({"engine": name, "ran": True, **_row(run)})
    pairs = [{"pair": [a, b], **_apart(runs[a], runs[b])} for a, b in itertools.combinations(runs, 2)]
    return {
        "schema": 1,
        "task": "pushing",
        "samples": samples,
        "seconds": options.duration,
        "friction": options.friction,
        "cores": os.cpu_count(),
        "engines": engines,
        "pairs": pairs,
    }


def _backend(name: str, options: PushOptions):
    if name != "drake_other_step":
        return make_backend(name, options).simulate
    from adaptsim_jax.models.backends.pushing_drake import DrakeContact

    return make_backend("drake", options, contact=DrakeContact(dt=CEILING_STEP)).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> Run:
    """Drake compiles nothing, so its first call is its only one; the planar model is timed on a batch worth its while."""
    out, first, cpu = _timed(simulate, batch)
    count = len(batch[0])
    if name.startswith("drake"):
        return Run(out.state[:, -1, :2], out.code, 0.0, first / count, cpu / count)
    if name == "planar":
        wide = tuple(np.resize(a, (PLANAR_BATCH, a.shape[1])) for a in batch)
        _timed(simulate, wide)
        seconds, cpu = _timed(simulate, wide)[1:]
        return Run(out.state[:, -1, :2], out.code, first, seconds / PLANAR_BATCH, cpu / PLANAR_BATCH)
    out, seconds, cpu = _timed(simulate, batch)
    return Run(np.asarray(out.state)[:, -1, :2], out.code, first, seconds / count, cpu / count)


def _timed(simulate: Callable, batch: tuple) -> tuple[Any, float, float]:
    begin, cpu = time.perf_counter(), time.process_time()
    out = simulate(*batch)
    np.asarray(out.state)
    return out, time.perf_counter() - begin, time.process_time() - cpu


def _row(run: Run) -> dict[str, Any]:
    codes = {pushing.MESSAGES[c]: int((run.code == c).sum()) for c in pushing.MESSAGES if c and (run.code == c).any()}
    return {
        "pushes_per_second": 1 / run.each,
        "pushes_per_cpu_second": 1 / max(run.cpu_each, 1e-9),
        "first_call_s": run.first,
        "went_wrong": codes,
    }


def _apart(a: Run, b: Run) -> dict[str, Any]:
    good = (a.code == pushing.FINE) & (b.code == pushing.FINE)
    if not good.any():
        return {"compared": 0}
    apart = 1e3 * np.linalg.norm(a.place - b.place, axis=1)[good]
    names = ("median_mm", "p90_mm", "p99_mm", "max_mm")
    return {
        "compared": int(good.sum()),
        **dict(zip(names, map(float, np.percentile(apart, [50, 90, 99, 100])), strict=True)),
    }
