"""Backends against each other on the same random samples: differences of the final state."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import jax
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.pendulum.engines import registry as pendulum
from adaptsim_jax.tasks.pendulum.engines import scene as pendulum_scene

REFERENCE = "native"


def parity(
    task: str, *, samples: int = 32, steps: int = 500, seed: int = 0, progress: Report = silent
) -> dict[str, Any]:
    """The backends of `task` against each other: `pendulum_parity`, `pushing_parity` or
    `scooping_parity`. steps: of the pendulum.
    """
    if task == "pushing":
        from adaptsim_jax.tasks.pushing.engines.parity import pushing_parity

        return pushing_parity(samples=samples, seed=seed, progress=progress)
    if task == "scooping":
        from adaptsim_jax.tasks.scooping.engines.parity import scooping_parity

        return scooping_parity(samples=samples, seed=seed, progress=progress)
    if task != "pendulum":
        raise BadInput(
            f"unknown task '{task}'; there are backends of pendulum, pushing and scooping"
        )
    return pendulum_parity(samples, steps, seed, progress)


def pendulum_parity(
    samples: int, steps: int, seed: int, progress: Report = silent
) -> dict[str, Any]:
    """Final states of every backend against native MuJoCo, after `steps` steps of 1 ms, in double
    precision.

    Returns `{task, samples, seconds, reference, rows}`; a row has the median and largest difference
    over samples of angles (rad) and velocities (rad/s), how many samples diverged, or why it did
    not run.
    """
    inputs = pendulum_scene.draw(seed, samples, steps)
    rows, reference = [], None
    order = (REFERENCE, *(name for name in pendulum.BACKENDS if name != REFERENCE))
    for done, name in enumerate(order):
        progress(done, len(order), name)
        try:
            # MJX prints on its first import that optional parts are absent
            with jax.enable_x64(True), contextlib.redirect_stdout(io.StringIO()):
                end = np.asarray(pendulum.make_backend(name).simulate(*inputs).state)[:, -1]
        except BadInput as error:
            rows.append({"backend": name, "ran": False, "why": str(error)})
            continue
        reference = end if reference is None else reference
        rows.append({"backend": name, "ran": True, **_differences(end, reference)})
    return {
        "schema": 1,
        "task": "pendulum",
        "samples": samples,
        "seconds": steps * 1e-3,
        "reference": REFERENCE,
        "rows": rows,
    }


def _differences(end: np.ndarray, reference: np.ndarray) -> dict[str, Any]:
    finite = np.isfinite(end).all(1) & np.isfinite(reference).all(1)
    gap = np.abs(end - reference)[finite]
    if not len(gap):
        return {"diverged": len(end)}
    sizes = {"angle": gap[:, :2].max(1), "velocity": gap[:, 2:].max(1)}
    numbers = {
        f"{k}_{f.__name__}": float(f(v)) for k, v in sizes.items() for f in (np.median, np.max)
    }
    return {"diverged": int((~finite).sum()), **numbers}
