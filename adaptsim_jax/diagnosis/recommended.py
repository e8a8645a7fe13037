"""Whether a file that a diagnosis wrote simulates its recording at least as well as the declared
one, at every joint, and better than what needs no model.

Effects and values are judged by stretches, or by torques along the motion. A user takes the file to
simulate. So each file is run as `adaptsim replay` runs it, over some stretches and from starts that
are fitted roughly, beside the declared one, before it is recommended.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.criteria import REPORT

WHOLE_TRIALS = "whole trials"


@dataclass(frozen=True)
class FileReplay:
    """A file over a recording: error [W, n] rad or m by stretch and joint, and nothing [W, n]: what
    is left without a model.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    error: np.ndarray
    nothing: np.ndarray


def joint_errors(
    run: Callable[[Path | None, float], FileReplay],
    files: Sequence[Path],
    spans: Mapping[str, float],
) -> dict[str, list[Table]]:
    """By file what it leaves at each joint, the worst beside the declared file first: rows of
    joint, over (of what), before (the declared file), after, nothing (what needs no model), unit,
    and whether it is worse.

    Args:
        run: simulates a file (None: the declared one) over stretches of so many seconds.
        spans: s by name, 0 for whole trials.
    """
    out: dict[str, list[Table]] = {file.name: [] for file in files}
    for over, span in spans.items():
        before = run(None, span)
        for file in files:
            try:
                after = run(file, span)
            except BadInput:  # a file of another kind, which nothing here simulates
                continue
            out[file.name] += [{"over": over} | row for row in _compared(before, after)]
    for rows in out.values():
        rows.sort(key=lambda row: -row["after"] / max(row["before"], 1e-300))
    return out


def _compared(before: FileReplay, after: FileReplay) -> list[Table]:
    def size(error):
        return np.sqrt(np.mean(np.square(np.minimum(error, REPORT.ran_away)), 0))

    one, two, nothing = size(before.error), size(after.error), size(before.nothing)
    return [
        {
            "joint": name,
            "before": float(one[j]),
            "after": float(two[j]),
            "nothing": float(nothing[j]),
            "unit": before.units[j],
            "worse": bool(two[j] > REPORT.slack * one[j]),
        }
        for j, name in enumerate(before.joints)
    ]
