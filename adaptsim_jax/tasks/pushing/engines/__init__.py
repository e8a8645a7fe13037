"""The bottle push in four engines behind one signature: native MuJoCo, MJX, Drake, and the planar
model.

`simulate(params [B, 4], commands [B, 2], initial [B, 2]) -> Trajectory`: commands are actions
(speed m/s, angle rad), initial the bottle's place m, and `state [B, T, 13]` the bottle's pose and
velocity in rows (`scene.STATE`). Codes are `pushing.MESSAGES`; states are finite whatever the code.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.engine import (
    EngineRun,
    Engines,
    Parity,
    engine_lines,
    engines_and_pairs,
    pair_lines,
    speed_row,
    timed_run,
)
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.model import PAPER, PushOptions, check_options

OURS = {
    "native": f"{__name__}.mujoco:NATIVE",
    "mjx": f"{__name__}.mujoco:MJX",
    "planar": f"{__name__}.scene:PLANAR",
    "drake": f"{__name__}.drake:ENGINE",
}
BACKENDS = Engines("pushing", OURS, PAPER, lambda name, options: check_options(options))
make_backend = BACKENDS.make


CEILING_STEP = 0.0025
"""s: the step of the second Drake, next to its usual 2 ms; what two settings of one engine differ
by is the ceiling.
"""
PLANAR_BATCH = 4096
ENGINES = ("native", "mjx", "planar", "drake", "drake_other_step")


def pushing_parity(
    samples: int = 32, seed: int = 0, progress: Report = silent, options: PushOptions = PAPER
) -> Table:
    """Final positions of `samples` random pushes in every engine that is installed.

    `engines` has a row each: speed, codes, or why it did not run; `pairs` the differences of final
    positions over the pushes that went well in both: median, p90, p99 and max, mm.
    """
    batch = pushing.draw(seed, samples)
    found = engines_and_pairs(
        ENGINES, lambda name: _run(_backend(name, options), batch, name), _row, _distances, progress
    )
    about = {"samples": samples, "seconds": options.duration, "friction": options.friction}
    return {"schema": 1, "task": "pushing", **about, **found}


def _backend(name: str, options: PushOptions):
    if name != "drake_other_step":
        return make_backend(name, options).simulate
    return make_backend("drake", options, contact={"dt": CEILING_STEP}).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> EngineRun:
    """Drake compiles nothing; the planar model is timed on a batch worth its while."""
    wide = PLANAR_BATCH if name == "planar" else 0
    return timed_run(
        simulate,
        batch,
        lambda state: state[:, -1, :2],
        compiles=not name.startswith("drake"),
        wide=wide,
    )


def _row(run: EngineRun) -> Table:
    return speed_row(run, "pushes", pushing.MESSAGES)


def _distances(a: EngineRun, b: EngineRun) -> Table:
    good = (a.code == pushing.FINE) & (b.code == pushing.FINE)
    if not good.any():
        return {"compared": 0}
    distance = 1e3 * np.linalg.norm(a.outcome - b.outcome, axis=1)[good]
    names = ("median_mm", "p90_mm", "p99_mm", "max_mm")
    return {
        "compared": int(good.sum()),
        **dict(zip(names, map(float, np.percentile(distance, [50, 90, 99, 100])), strict=True)),
    }


def parity_lines(found: Table) -> list[str]:
    """The results of `pushing_parity` for a person."""
    keys = ("median_mm", "p90_mm", "p99_mm", "max_mm")

    def sizes(row):
        return " ".join(f"{row[key]:8.3f}" for key in keys)

    def speeds(row):
        each = f"{row['pushes_per_second']:10.1f} {row['pushes_per_cpu_second']:13.1f}"
        return f"{each} {row['first_call_s']:9.1f} s"

    head = f"{'median':>8} {'p90':>8} {'p99':>8} {'max':>8}"
    return [
        f"pushing: {found['samples']} random pushes of {found['seconds']:g} s, friction "
        f"{found['friction']};",
        "distance between final positions of the bottle, mm",
        "",
        *pair_lines(found, 28, head, "push", sizes),
        "",
        "drake - drake_other_step is the ceiling: one engine at steps of 2 and 2.5 ms",
        "",
        f"{'engine':18} {'pushes/s':>10} {'pushes/CPU s':>13} {'first call':>11}",
        *engine_lines(found, speeds),
    ]


PARITY = Parity(pushing_parity, parity_lines)
