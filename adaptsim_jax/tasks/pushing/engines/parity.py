"""The engines of the push against each other: where the same bottles end, pair by pair, and how
fast each computes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.engine_runs import Run, engines_and_pairs, speed_row, timed_run
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines.registry import make_backend
from adaptsim_jax.tasks.pushing.model import PAPER, PushOptions

CEILING_STEP = 0.0025
"""s: the step of the second Drake, next to its usual 2 ms; what two settings of one engine differ
by is the ceiling.
"""
PLANAR_BATCH = 4096
ENGINES = ("native", "mjx", "planar", "drake", "drake_other_step")


def pushing_parity(
    *, samples: int = 32, seed: int = 0, options: PushOptions = PAPER, progress: Report = silent
) -> dict[str, Any]:
    """Final positions of `samples` random pushes in every engine that is installed.

    `engines` has a row each: speed, codes, or why it did not run; `pairs` the differences of final
    positions over the pushes that went well in both: median, p90, p99 and max, mm.
    """
    batch = pushing.draw(seed, samples)
    found = engines_and_pairs(
        ENGINES, lambda name: _run(_backend(name, options), batch, name), _row, _apart, progress
    )
    about = {"samples": samples, "seconds": options.duration, "friction": options.friction}
    return {"schema": 1, "task": "pushing", **about, **found}


def _backend(name: str, options: PushOptions):
    if name != "drake_other_step":
        return make_backend(name, options).simulate
    from adaptsim_jax.tasks.pushing.engines.drake import DrakeContact

    return make_backend("drake", options, contact=DrakeContact(dt=CEILING_STEP)).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> Run:
    """Drake compiles nothing; the planar model is timed on a batch worth its while."""
    wide = PLANAR_BATCH if name == "planar" else 0
    return timed_run(
        simulate,
        batch,
        lambda state: state[:, -1, :2],
        compiles=not name.startswith("drake"),
        wide=wide,
    )


def _row(run: Run) -> dict[str, Any]:
    return speed_row(run, "pushes", pushing.MESSAGES)


def _apart(a: Run, b: Run) -> dict[str, Any]:
    good = (a.code == pushing.FINE) & (b.code == pushing.FINE)
    if not good.any():
        return {"compared": 0}
    apart = 1e3 * np.linalg.norm(a.outcome - b.outcome, axis=1)[good]
    names = ("median_mm", "p90_mm", "p99_mm", "max_mm")
    return {
        "compared": int(good.sum()),
        **dict(zip(names, map(float, np.percentile(apart, [50, 90, 99, 100])), strict=True)),
    }
