"""The real double pendulums: everything chosen and fitted on trials 00 to 03, then scored on the others, which nothing has seen.

    python -m experiments.closeloop_rigs ../shared/data/measured_double_pendulum --out DIR

Each rig's first four trials are diagnosed as any recording is. The declared model and what was named, or else the likeliest set
(which is no name), keep the parameters found there and simulate the other trials; only initial states are fitted to those.
Cross-check: the other rig's set, its parameters refitted on this rig's first four trials, scored on the same others.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptsim_jax.core import compile_flags, memory
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.sysid import Criteria, Recording, catalogue, read_recording
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.problem import Active, Problem, by_least_squares, initial_states, prepare
from adaptsim_jax.sysid.examine import Diagnosis, examine

CHOSEN_ON = ("trial_00", "trial_01", "trial_02", "trial_03")


@dataclass(frozen=True)
class Rig:
    """What the first four trials of a rig told, and the other trials cut like them."""

    name: str
    diagnosis: Diagnosis
    rest: Problem

    @property
    def likeliest(self) -> Fit:
        """What was named, or the likeliest set where nothing was."""
        d = self.diagnosis
        return d.found.final if d.verdict.named else d.leading or d.found.base


def split(recording: Recording) -> tuple[Recording, Recording]:
    """The trials to choose on and the others."""
    first = tuple(t for t in recording.trials if t.name in CHOSEN_ON)
    return recording.replace(trials=first), recording.replace(
        trials=tuple(t for t in recording.trials if t.name not in CHOSEN_ON)
    )


def judged(folder: Path) -> Rig:
    """One rig's first trials diagnosed, and its other trials in windows as long."""
    first, rest = split(read_recording(folder))
    effects = tuple(catalogue(first.task))
    checked = audit(first)
    first = usable(first, checked)
    say = lambda done, total, note: print(f"{folder.name}: {note}", flush=True)
    diagnosis = examine(first, checked, noise_floor(first, checked), effects, Criteria(), 0, say)
    times = np.asarray(diagnosis.problem.windows.times)
    duration = float(np.median(times[:, -1] - times[:, 0]))
    checked = audit(rest)
    rest = usable(rest, checked)
    return Rig(folder.name, diagnosis, prepare(rest, checked, noise_floor(rest, checked), effects, duration=duration))


def scored(rest: Problem, active: Active, theta: np.ndarray, eff: np.ndarray) -> dict[str, float]:
    """RMSE [rad] of the angles of each trial simulated by a model as it is, and of all."""
    windows = rest.windows
    fit = initial_states(rest, active, theta, eff, windows.start)
    weight = np.asarray(windows.weight)
    error = np.where(weight > 0, fit.residual / np.where(weight > 0, weight, 1.0), np.nan)
    rms = lambda rows: float(np.sqrt(np.nanmean(np.square(error[rows]))))
    trial, real = np.asarray(windows.trial), windows.real
    each = {t.name: rms(real & (trial == k)) for k, t in enumerate(rest.recording.trials)}
    return each | {"all": rms(real)}


def borrowed(rig: Rig, other: Rig) -> tuple[Active, np.ndarray, np.ndarray]:
    """The other rig's set with its parameters refitted on this rig's first trials."""
    problem, c = rig.diagnosis.problem, other.likeliest.candidate
    fit = by_least_squares(problem, c.active, rig.diagnosis.found.base.candidate.theta, c.eff, problem.windows.start)
    return c.active, fit.theta, fit.eff


def words(active: Active) -> str:
    return ", ".join(f"{e.replace('_', ' ')} at {w}" for e, w in active) or "nothing"


def result(rig: Rig, other: Rig) -> dict:
    """One rig's verdict on its first trials, and the errors on the others."""
    d = rig.diagnosis
    base, best = d.found.base.candidate, rig.likeliest.candidate
    return {
        "verdict": d.report["verdict"], "message": d.report["message"],
        "likeliest": words(rig.likeliest.active), "other_rigs": words(other.likeliest.active),
        "error_on_first": d.report["error"],
        "declared": scored(rig.rest, base.active, base.theta, base.eff),
        "with_likeliest": scored(rig.rest, best.active, best.theta, best.eff),
        "with_other_rigs": scored(rig.rest, *borrowed(rig, other)),
    }  # fmt: skip


def table(results: dict[str, dict]) -> str:
    lines = [
        "| rig | verdict on 00-03 | likeliest set there | declared | with the set | the other rig's set, refitted on 00-03 |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, r in results.items():
        cells = []
        for key in ("declared", "with_likeliest", "with_other_rigs"):
            each = [1e3 * v for k, v in r[key].items() if k != "all"]
            cells.append(f"{1e3 * r[key]['all']:.1f} mrad ({min(each):.1f}-{max(each):.1f})")
        lines.append(f"| {name} | `{r['verdict']}` | {r['likeliest']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, metavar="DIR", help="the folder that holds the rigs' folders")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    args = parser.parse_args()
    folders = sorted(f.parent for f in args.data.glob("*/meta.toml"))
    if len(folders) != 2:
        parser.error(f"{args.data} holds {len(folders)} folders with a meta.toml; it takes two rigs")
    memory.keep_freed()
    compile_flags.small_steps()  # as the command does
    one, two = map(judged, folders)
    results = {a.name: result(a, b) for a, b in ((one, two), (two, one))}
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "rigs.json").write_text(json.dumps(results, indent=1, default=float))
    print(table(results))


if __name__ == "__main__":
    main()
