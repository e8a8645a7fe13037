"""Scooping in four engines behind one signature: ours in JAX (hydro), Drake, and a sphere cloud in
MJX and native MuJoCo.

`simulate(params [B, 4], commands [B, 3], initial [B, 2]) -> Trajectory`: commands are actions as
executed (pitch rad, rate rad/s, distance m), initial the place of the piece m. `state [B, T, 6]`
holds, in rows of 10 ms, the piece's x, y, z m and the tip's x, z m and pitch rad. Codes are
`scooping.MESSAGES`; states are finite whatever the code.
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
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.model import ScoopOptions, check_options

OURS = {
    "hydro": "adaptsim_jax.tasks.scooping.hydro:HYDRO",
    "drake": f"{__name__}.drake:ENGINE",
    "mjx": f"{__name__}.mujoco:MJX",
    "native": f"{__name__}.mujoco:NATIVE",
}
BACKENDS = Engines("scooping", OURS, ScoopOptions(), lambda name, options: check_options(options))
make_backend = BACKENDS.make


LOW_RELAXATION = 0.02
"""s: of the pair that is compared with hardly any dissipation, where contact is least a matter of
numerics.
"""
_LOW = {"relaxation": LOW_RELAXATION}
_FINER = {"resolution": 0.003}
SETTINGS: dict[str, Table] = {
    "hydro": {},
    "drake": {},
    "drake_finer_mesh": {"contact": _FINER},
    "drake_other_step": {"contact": {"dt": 0.005}},
    "hydro_low": {"numerics": _LOW},
    "drake_low": {"contact": _LOW},
    "drake_low_finer_mesh": {"contact": _LOW | _FINER},
    "native": {},
    "mjx": {},
}


def scooping_parity(samples: int = 32, seed: int = 0, progress: Report = silent) -> Table:
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

    found = engines_and_pairs(tuple(SETTINGS), run, row, _alike, progress)
    return {"schema": 1, "task": "scooping", "samples": samples, "seconds": model.SECONDS, **found}


def _backend(name: str) -> Callable:
    return make_backend(name.split("_")[0], **SETTINGS[name]).simulate


def _run(simulate: Callable, batch: tuple, name: str) -> EngineRun:
    def outcome(state):
        return model.outcome(state)[0]

    return timed_run(simulate, batch, outcome, compiles=not name.startswith("drake"))


def _row(run: EngineRun, shape: np.ndarray) -> Table:
    def share(rows):
        if rows.any():
            return float(run.outcome[rows].mean())
        return None

    shares = {model.SHAPES[g]: share(shape == g) for g in range(2)}
    success = {"success": float(run.outcome.mean()), "success_by_shape": shares}
    return success | speed_row(run, "trials", model.MESSAGES)


def _alike(a: EngineRun, b: EngineRun) -> Table:
    good = (a.code == model.FINE) & (b.code == model.FINE)
    count = int(good.sum())
    if not count:
        return {"compared": 0}
    from scipy.stats import binomtest

    alike = int((a.outcome == b.outcome)[good].sum())
    interval = binomtest(alike, count).proportion_ci(method="wilson")
    return {
        "compared": count,
        "alike": alike / count,
        "low": float(interval.low),
        "high": float(interval.high),
    }


def parity_lines(found: Table) -> list[str]:
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
