"""Measured trials of a task diagnosed: read, judged, written; and what a report says of tracks that
a camera saw.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis import rows
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.problem import Candidate, Problem
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.schema import new_report, verdict_of
from adaptsim_jax.diagnosis.written import cleared, finished
from adaptsim_jax.mend.model_toml import Form


@dataclass(frozen=True)
class Diagnose:
    """The diagnosis of a task's trials. trial: as messages call one; recording: the type of what
    `read(folder)` gives, with candidates `effects(recording)`; judged: `(recording, effects,
    criteria, progress, folder) -> (report, the arrays behind its page, what to try next, the
    model.toml, further files by name)`; columns: of the actions that are to be tried next.
    """

    trial: str
    recording: type
    read: Callable[[Any], Any]
    effects: Callable[[Any], tuple[Candidate, ...]]
    assess: Callable[..., tuple[dict, dict, dict | None, Form, Mapping[str, Callable[[], str]]]]
    criteria: Criteria
    columns: tuple[str, ...] = ()

    def __call__(
        self,
        data: Any,
        *,
        out: str | Path | None = None,
        criteria: Criteria | None = None,
        exclude: tuple[str, ...] = (),
        progress: Callable[[float, float, str], None] | None = None,
        page: Page | None = None,
        named: str = "DATA",
        asked: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """The report on a folder of trials (or on a recording of them); with `out` it is written
        there, with `model.toml`, and with `next_experiment.csv` where names cannot be told apart.
        exclude: effects that are not considered; named, asked: what a recording came of, and what
        of `command_of` it was read with. Raises BadInput.
        """
        began, given = time.monotonic(), isinstance(data, self.recording)
        recorded = data if given else self.read(data)
        effects = rows.check_exclude(exclude, self.effects(recorded), self.trial)
        folder = None if out is None else cleared(output_folder(out))
        report, evidence, plan, model, more = self.assess(
            recorded, effects, criteria or self.criteria, progress, folder
        )
        run = Run(
            command_of(named if given else data, out=out, exclude=exclude, **(asked or {})), began
        )
        return finished(report, evidence, run, plan, folder, model, self.columns, page, more)


def reported(
    task: str,
    model: str,
    observed: rows.Recorded,
    problem: Problem,
    found: Finding,
    tracks: Mapping[str, np.ndarray],
    criteria: Criteria,
    notes: list[str],
    axes: tuple[int, int] = (0, 1),
    **more: Any,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report on tracks, with the keys `more`, and the arrays behind its page. tracks: `before`
    and `after` `[T, R, C]` m of left-out trials, shown in a plane of two axes.
    """
    over, worst, mended = (
        rows.over_floor(found.final),
        worst_left(problem, found),
        bool(found.named),
    )
    both = {"before": found.null, "after": found.final}
    effects = [rows.effect_row(problem, found, n) for n in found.named]
    report = new_report(
        task,
        model,
        verdict_of(effects, worst > criteria.explained),
        rows.message(observed, found, over, worst),
        {
            "trials": len(observed.names),
            "samples": int(observed.mask.sum()),
            "held_out_trials": len(observed.names),
        },
        effects=effects,
        error=rows.error_table(observed, found, tracks),
        candidates=rows.candidate_rows(found),
        declared={k: rows.declared_rows(problem, m) for k, m in both.items()},
        not_established=rows.same_rows(found, observed.trial),
        notes=notes,
        **more,
    )
    return report, {
        "audit": noted(notes),
        "held_out": rows.held_out(observed, tracks, mended),
        "tracks": rows.plane_tracks(observed, tracks, mended, axes),
    }


def worst_left(problem: Problem, found: Finding) -> float:
    """What the final model leaves over the noise floor, of left-out trials or of all, whichever is
    more.
    """
    return max(rows.over_floor(found.final), rows.left_by_fit(problem, found.final))


def noted(notes: list[str]) -> list[dict[str, str]]:
    """Notes as rows of a page's audit."""
    return [{"severity": "info", "where": "", "message": note} for note in notes]
