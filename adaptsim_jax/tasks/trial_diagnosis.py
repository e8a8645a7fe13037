"""Measured trials of a task diagnosed: read, judged, written; and what a report says of tracks that
a camera saw.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis import rows
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding, Named
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import Account, remarks, report_of
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.written import MODEL, Output, cleared, finished, planned
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.mend.model_toml import Form, Value, added_effects
from adaptsim_jax.tasks.trial_record import TrialKind, TrialRecording


@dataclass(frozen=True)
class Diagnose:
    """The diagnosis of a task's trials. trial: as messages call one; recording: the type of what
    `read(folder)` gives, with candidates `effects(recording)`; judged: `(recording, effects,
    criteria, progress, folder) -> (report, the arrays behind its page, what to try next, the
    model.toml, further files by name)`; columns: of the actions that are to be tried next.
    """

    trial: str
    recording: type
    read: Callable
    effects: Callable[[Any], tuple[Effect, ...]]
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
        asked: Mapping[str, Any] | None = None,
    ) -> Table:
        """The report on a folder of trials, or on a recording of them.

        With `out` it is written there, with `model.toml`, and with `next_experiment.csv` where
        names cannot be separated. exclude: effects that are not considered; asked: of a recording,
        what of `command_of` it was read with. Raises BadInput.
        """
        began, given = time.monotonic(), isinstance(data, self.recording)
        recorded = data if given else self.read(data)
        effects = rows.check_exclude(exclude, self.effects(recorded), self.trial)
        folder = None if out is None else cleared(output_folder(out))
        report, evidence, plan, model, more = self.assess(
            recorded, effects, criteria or self.criteria, progress, folder
        )
        read = {"data": "DATA"} if given else {"data": data}
        command = command_of(out=out, exclude=exclude, **(read | dict(asked or {})))
        files = {MODEL: model.text, **more, **planned(report, plan, self.columns)}
        return finished(report, evidence, Run(command, began), Output(folder, page, files))


@dataclass(frozen=True)
class TracksFound:
    """A search over tracks that a camera saw, and what it was given.

    Args:
        task, model: their names in the report.
        recorded: the tracks.
        problem, found: what was searched, and what was found.
        tracks: `before` and `after` `[T, R, C]` m of left-out trials.
        notes: of the recording.
    """

    task: str
    model: str
    recorded: rows.Recorded
    problem: Problem
    found: Finding
    tracks: Mapping[str, np.ndarray]
    notes: list[str]

    @property
    def worst(self) -> float:
        """What the final model leaves over the noise floor, of left-out trials or of all, whichever
        is more.
        """
        over = rows.over_floor(self.found.final)
        return max(over, rows.left_by_fit(self.problem, self.found.final))


def reported(
    made: TracksFound, criteria: Criteria, axes: tuple[int, int] = (0, 1), **more: Any
) -> tuple[Table, Table]:
    """The report on tracks, with the keys `more`, and the arrays behind its page, which shows a
    plane of two axes.
    """
    recorded, found, mended = made.recorded, made.found, bool(made.found.named)
    over, worst = rows.over_floor(found.final), made.worst
    count = len(recorded.names)
    account = Account(
        made.task,
        made.model,
        {"trials": count, "samples": int(recorded.mask.sum()), "held_out_trials": count},
        rows.label,
        rows.effect_rows(made.problem, found),
        rows.scored(found),
        rows.headline(recorded, found, over, worst),
        worst > criteria.explained,
        rows.error_table(recorded, found, made.tracks),
        lambda model: rows.declared_rows(made.problem, model),
        {
            "not_established": rows.same_rows(found, recorded.trial),
            "notes": made.notes,
            **more,
        },
    )
    return report_of(found, account), {
        "audit": remarks(made.notes),
        "held_out": rows.held_out(recorded, made.tracks, mended),
        "tracks": rows.plane_tracks(recorded, made.tracks, mended, axes),
    }


def observed_rows(
    recording: TrialRecording, kind: TrialKind, known: np.ndarray, **others: tuple[str, float]
) -> rows.Recorded:
    """A recording as reports show it.

    known: `[T, R]` or `[T, R, C]`, what errors are taken over. others: Unit and noise of channels
    that are no lengths. Its `places` and `channels` are the task's.
    """
    r: Any = recording
    noise = (r.noise, r.noise_source, known, others)
    return rows.Recorded(
        kind.trial, kind.trials, r.names, r.time, r.places, r.mask, r.channels, *noise
    )


def mended_form(
    problem: Problem,
    found: Finding,
    about: tuple[str, str],
    declared: Callable[[dict[str, float]], dict[str, Value]],
    own: Table,
) -> Form:
    """`model.toml`: declared parameters as fitted, and what each named effect adds.

    about: Task and model, in words. declared: The parameters, of the fitted values by name; own:
    keys of this task alone.
    """
    value = {q.name: float(found.final.fit.values[i]) for i, q in enumerate(problem.quantities)}
    effects = added_effects([n.candidate for n in found.named], value)
    return Form(*about, declared(value), effects, own)


@dataclass(frozen=True)
class NextTrials:
    """What decides which trials tell two effects apart.

    Args:
        separation: Noises between the tracks of two models from which a trial tells them apart: of
            two tracks of one model the camera's noise alone makes 2.
        count: Trials that are asked for, since one of them may fail.
    """

    separation: float = 3.0
    count: int = 3


NEXT = NextTrials()


def look_alikes(found: Finding) -> list[tuple[Named, Effect, Any]]:
    """Each named effect with each of its look-alikes, and the model that has this in its place."""
    return [
        (named, other, model)
        for named in found.named
        for other, model in zip(named.alternatives, named.models, strict=True)
    ]


def next_trials(
    pair: tuple[Named, Effect, Any],
    score: np.ndarray,
    actions: np.ndarray,
    kind: TrialKind,
    sizes: tuple[str, str],
) -> Table:
    """The trials of a grid that tell a named effect and a look-alike apart.

    Args:
        pair: Of `look_alikes`.
        score: `[G]` noises between the tracks of both.
        actions: `[G, A]`, as they are written.
        kind: How messages call trials.
        sizes: How far tracks differ at most, in words, where no trial tells and where one does.

    Returns:
        message, separates (names), and rows of the best actions, none where no trial tells.
    """
    names = [pair[0].candidate.name, pair[1].name]
    words = " and ".join(name.replace("_", " ") for name in names)
    if score.max() < NEXT.separation:
        rows = []
        message = (
            f"No {kind.trial} within the bounds tells {words} apart: {sizes[0]} at most. Measure "
            "one of them by itself."
        )
    else:
        rows = [tuple(map(float, actions[i])) for i in np.argsort(-score)[: NEXT.count]]
        message = (
            f"{kind.trials.capitalize()} whose tracks differ most, by up to {sizes[1]}, between "
            f"{words}."
        )
    return {"message": message, "separates": names, "rows": rows}
