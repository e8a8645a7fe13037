"""The one report of a diagnosis, whatever was diagnosed: from a finding, and what its judge
contributes.

A judge (simulated stretches, the torque along the motion, short trials, a simulator) says how
candidates are called, what a row of an effect has, and how large errors are. Verdict, message, rows
and tables are made here.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import REPORT
from adaptsim_jax.diagnosis.finding import Finding, Named
from adaptsim_jax.diagnosis.schema import new_report, verdict_of, with_effects
from adaptsim_jax.diagnosis.testing import typical_interval


class Label(NamedTuple):
    """How a report calls a candidate: its name, and where it acts."""

    name: str
    where: str

    @property
    def words(self) -> str:
        """Name and place in a sentence."""
        return f"{words(self.name)} at {self.where}"

    @property
    def alternative(self) -> str:
        """As `alternatives` lists it."""
        return f"{self.name}@{self.where}"


class Scored(NamedTuple):
    """A row of `candidates`: share of the error that it takes off, p, and why it is not named
    where neither a look-alike nor a fit says so.
    """

    candidate: Any
    gain: float
    p: float
    why: str


@dataclass(frozen=True)
class Headline:
    """Sentences of the message.

    Args:
        declared: What the declared model leaves.
        mended: The same, with what is named.
        more: What follows.
        enough, none: Where nothing is named, and no more than noise is left, or more.
    """

    declared: str
    mended: str
    more: str = ""
    enough: str = "Nothing need be added."
    none: str = "No effect of the catalogue holds out."


@dataclass(frozen=True)
class Account:
    """What a judge contributes to the report of a finding.

    Args:
        task, model: Their names in the report.
        data: Counts of `trials`, `samples` and `held_out_trials`.
        label: How a candidate is called.
        effects: Of each name `parameters`, `physics` and keys of the judge's own; `same`, where
            there is one, lists what no such recording tells apart from it.
        scores: Of all candidates, as the table lists them.
        headline: Sentences of the message.
        left: Whether more than noise is left.
        error: The table of errors before and after.
        declared: Rows of the declared quantities of a model.
        more: Further keys of the report.
    """

    task: str
    model: str
    data: Mapping[str, int]
    label: Callable[[Any], Label]
    effects: Sequence[Mapping[str, Any]]
    scores: Sequence[Scored]
    headline: Headline
    left: bool
    error: Mapping[str, Any]
    declared: Callable[[Any], Table]
    more: Mapping[str, Any] = field(default_factory=dict)


def report_of(found: Finding, account: Account) -> Table:
    """The report (`diagnosis.schema`)."""
    effects = [
        effect_row(n, account.label, own)
        for n, own in zip(found.named, account.effects, strict=True)
    ]
    verdict = verdict_of(effects, account.left)
    text = message(found, account)
    candidates = candidate_rows(found, account.label, account.scores)
    before, after = account.declared(found.null), account.declared(found.final)
    return new_report(
        account.task,
        account.model,
        verdict,
        text,
        account.data,
        effects=effects,
        error=account.error,
        candidates=candidates,
        declared={"before": before, "after": after},
        **account.more,
    )


def message(found: Finding, account: Account) -> str:
    """What was found, in a few sentences."""
    headline = account.headline
    if found.named:
        return f"{headline.mended}{headline.more}"
    return (
        f"{headline.declared} {headline.none if account.left else headline.enough}".rstrip()
        + headline.more
    )


def words(name: str) -> str:
    """An effect's name, with its place or without, as people write it."""
    return name.partition("@")[0].replace("_", " ")


def sentence(text: str) -> str:
    """With a capital letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def named_words(named: Sequence[Named], called: Callable[[Any], str], folds: str = "") -> str:
    """What is named and how it was tested, one sentence. called: a candidate in words; folds: what
    was left out, in words.
    """
    unit = f" {folds}" if folds else ""
    each = []
    for n in named:
        test = n.test
        each.append(
            f"{called(n.candidate)} holds out in {test.better} of {test.folds}{unit} "
            f"(takes {100 * test.gain:.0f} % off the squared error beside all others, "
            f"p {test.p:.2g})"
        )
    return sentence("; ".join(each))


def effect_row(n: Named, label: Callable[[Any], Label], own: Mapping[str, Any]) -> Table:
    """A row of `effects`: what is named, its numbers, and how it was tested."""
    rest = {k: v for k, v in own.items() if k != "same"}
    alternatives = [label(a).alternative for a in n.alternatives]
    return {
        **label(n.candidate)._asdict(),
        **rest,
        "alternatives": [*alternatives, *own.get("same", ())],
        "held_out_gain": n.test.gain,
        "p_value": n.test.p,
        "better": n.test.better,
        "folds": n.test.folds,
        "size_over_scatter": min(n.steady, 1e3),
    }


def candidate_rows(
    found: Finding, label: Callable[[Any], Label], scores: Sequence[Scored]
) -> list[Table]:
    """Every candidate that was scored, and what became of it."""
    fate: dict[Hashable, tuple[str, str]] = {
        label(c): ("rejected", why) for c, why in found.refused()
    }
    fate |= {label(a): ("look-alike", "does as well") for n in found.named for a in n.alternatives}
    fate |= {label(n.candidate): ("accepted", "named") for n in found.named}
    rows = []
    for candidate, gain, p, otherwise in scores:
        called = label(candidate)
        status, why = fate.get(called, ("rejected", otherwise))
        rows.append(
            {
                **called._asdict(),
                "held_out_gain": float(np.clip(gain, -1.0, 1.0)),
                "p_value": float(min(1.0, p)),
                "accepted": status == "accepted",
                "status": status,
                "why": why,
            }
        )
    return rows


class Errors(NamedTuple):
    """Errors of left-out trials or stretches: unit, noise floor, and `before` and `after` `[W]` or
    `[W, n]`.
    """

    unit: str
    floor: float
    both: Mapping[str, np.ndarray]


def error_rows(
    metric: str,
    source: str,
    names: Sequence[str],
    whole: Errors,
    channels: Mapping[str, Errors],
    trial: np.ndarray | None = None,
    over: tuple[str, np.ndarray] | None = None,
) -> Table:
    """The table `error`: medians over all, by channel, and by trial.

    Args:
        metric, source: What the errors are, and where their noise floor comes from, in words.
        names: Of the trials, or of parts of them.
        whole: Errors over all channels.
        channels: Errors of each.
        trial: `[W]`, of which of `names` each error is; None: one of each.
        over: What the intervals are over, where not over these trials (`interval_units`).
    """
    trial = np.arange(len(names)) if trial is None else trial

    def medians(errors: Errors, at: Any = slice(None)) -> dict[str, float]:
        return {k: float(np.median(v[at])) for k, v in errors.both.items()}

    def of_trial(name: str, mine: np.ndarray) -> Table:
        each = {c: medians(errors, mine) for c, errors in channels.items()}
        return {"trial": name, **medians(whole, mine), "per_channel": each}

    per_channel = {
        c: {"unit": errors.unit, **medians(errors), "noise_floor": errors.floor}
        for c, errors in channels.items()
    }
    per_trial = [of_trial(name, trial == k) for k, name in enumerate(names) if np.any(trial == k)]
    over_words, unit = over or interval_units(trial, trial)
    intervals = {k: typical_interval(v, unit) for k, v in whole.both.items()}
    return {
        "metric": metric,
        "unit": whole.unit,
        **medians(whole),
        "noise_floor": whole.floor,
        "per_channel": per_channel,
        "per_trial": per_trial,
        "noise_floor_source": source,
        "intervals": intervals,
        "intervals_over": over_words,
    }


def interval_units(part: np.ndarray, trial: np.ndarray) -> tuple[str, np.ndarray]:
    """What the interval of an error is over, in words, and of which of these each error is [W]:
    trials, or of few trials their parts, which say nothing of another trial.
    """
    trials, parts = len(np.unique(trial)), len(np.unique(part))
    if trials >= REPORT.min_trials or parts == trials:
        return f"{trials} trials", trial
    of = "one trial" if trials == 1 else f"{trials} trials"
    return f"{parts} parts of {of}", part


def page_tracks(
    names: Sequence[str],
    units: Mapping[str, str],
    trial: np.ndarray,
    time: np.ndarray,
    shown: Mapping[str, np.ndarray],
    most: int | None = None,
) -> list[Table]:
    """Each trial's stretches one after the other, for the page.

    Args:
        names: Of the trials.
        units: Of the channels, by name.
        trial, time: `[W]` of each stretch, and `[W, R]` s.
        shown: By key `[W, R, C]`, NaN where nothing was measured.
        most: Stretches of a trial that are shown.
    """

    def ended(z: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Stretches as one row, each with a last number of its own."""
        return np.concatenate([z, last[:, None]], 1).ravel()

    out = []
    for t, name in enumerate(names):
        mine = np.flatnonzero(trial == t)[:most]
        if not len(mine):
            continue
        gap = np.full(len(mine), np.nan)
        tracks = {
            key: {c: ended(z[mine, :, k], gap) for k, c in enumerate(units)}
            for key, z in shown.items()
        }
        clock = ended(time[mine], time[mine, -1])
        row = {"trial": name, "units": dict(units), "time": clock, **tracks}
        out.append(row | {"after": tracks.get("after")})
    return out


def withhold_names(report: Table, why: str, left: bool) -> None:
    """Put a report's names among what is not established, since its model predicts nothing, in
    place.

    Args:
        why: A sentence that says so.
        left: Whether more than noise is left.
    """
    report["message"] = f"{why} {report['message']}"
    if not report["effects"]:
        return
    doubt = "better than a model that predicts nothing"
    doubted = [f"{words(row['name'])} at {row['where']}: {doubt}" for row in report["effects"]]
    report["not_established"] = [*report["not_established"], *doubted]
    with_effects(report, [], left)
    for row in report["candidates"]:
        if row["accepted"]:
            row |= {"accepted": False, "status": "rejected", "why": doubt}


def remarks(notes: Sequence[str]) -> list[dict[str, str]]:
    """Notes as rows of a page's audit."""
    return [{"severity": "info", "where": "", "message": note} for note in notes]
