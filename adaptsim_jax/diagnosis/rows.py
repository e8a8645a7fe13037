"""What short trials contribute to a report, whatever the task: sentences, numbers of effects,
errors by trial, tracks for its page.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.criteria import REPORT, Criteria
from adaptsim_jax.diagnosis.finding import Finding, Named
from adaptsim_jax.diagnosis.models import Model, by_fold, spread
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import Errors, Headline, Label, Scored, error_rows, words
from adaptsim_jax.diagnosis.report import named_words as of_any
from adaptsim_jax.diagnosis.testing import deviates
from adaptsim_jax.effects.base import Effect

LOGS = {"log_e": ("e", "Pa")}


@dataclass(frozen=True)
class Recorded:
    """What was recorded of T trials of at most R rows, C coordinates each.

    Args:
        trial, trials: As messages call one, and several.
        names: `[T]`.
        time, mask: `[T, R]` s, and 1 where a row was recorded.
        places: `[T, R, C]` m, of the axes `channels`.
        noise: m.
        judged: `[T, R]` or `[T, R, C]`: rows that errors are taken over, where not all are.
        others: Unit and noise of channels that are no lengths.
    """

    trial: str
    trials: str
    names: tuple[str, ...]
    time: np.ndarray
    places: np.ndarray
    mask: np.ndarray
    channels: tuple[str, ...]
    noise: float
    noise_source: str
    judged: np.ndarray | None = None
    others: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def rows(self) -> np.ndarray:
        """The rows that errors are taken over `[T, R, C]`."""
        rows = self.mask if self.judged is None else self.judged
        return np.broadcast_to(rows if rows.ndim > 2 else rows[..., None], self.places.shape)


def check_exclude(
    exclude: tuple[str, ...], effects: tuple[Effect, ...], trial: str
) -> tuple[Effect, ...]:
    """`effects` without those excluded, by effect (`coulomb`) or effect and place (`coulomb at
    elbow`). Raises BadInput where a name is none of them.
    """
    names = {e.name: e.name.partition(" at ")[0] for e in effects}
    known = {*names, *names.values()}
    for name in exclude:
        if name not in known:
            raise BadInput(
                f"--exclude: {name!r} is no effect of a {trial}; it has "
                f"{', '.join(sorted(set(names.values())))}"
            )
    return tuple(e for e in effects if not {e.name, names[e.name]} & set(exclude))


def over_floor(model: Model) -> float:
    """Left-out error over the noise floor, median over trials."""
    return float(np.median(np.sqrt(model.fit.held)))


def left_by_fit(problem: Problem, model: Model) -> float:
    """What the whole fit leaves over the noise floor, all trials together.

    A trial that alone shows something (where a patch ends) is predicted badly by the others though
    the model is right; a model that lacks something leaves more than noise where it was fitted,
    too.
    """
    return float(np.sqrt(model.fit.loss / problem.counts.sum()))


def label(c: Effect) -> Label:
    """How a report calls a candidate."""
    return Label(c.name, c.place)


def named_words(named: Sequence[Named], folds: str) -> str:
    """What is named and how it was tested, one sentence; folds: the trials in words."""
    return of_any(named, lambda c: words(c.name), folds)


def headline(recorded: Recorded, found: Finding, over: float, worst: float) -> Headline:
    """What declared trials leave, and what those leave that have what is named; over: left-out
    error over the noise floor, worst: of these or of all trials together.
    """

    def size(m):
        return f"{1e3 * recorded.noise * over_floor(m):.3g}"

    declared = (
        f"The declared {recorded.trial}, fitted, predicts left-out tracks to {size(found.null)} "
        f"mm, {over:.1f} times the noise floor."
    )
    mended = (
        f"{named_words(found.named, recorded.trials)} Left-out error {size(found.null)} to "
        f"{size(found.final)} mm, {over:.1f} times the noise floor."
    )
    if worst > REPORT.followed >= over:
        mended += (
            f" Some {recorded.trials} are not followed: all together the fit leaves {worst:.1f} "
            "times the noise floor."
        )
    more = ""
    if found.named or worst > REPORT.followed:
        more = _standing_out(recorded, found.final if found.named else found.null)
    return Headline(declared, mended, more)


def _standing_out(recorded: Recorded, model: Model) -> str:
    """A sentence on a few trials that are predicted far worse than the others."""
    error = np.sqrt(model.fit.held)
    outliers = np.flatnonzero(error > REPORT.outlying * np.median(error))
    if not 0 < len(outliers) <= len(error) / 4:
        return ""
    names, times = [recorded.names[k] for k in outliers], np.max(error[outliers]) / np.median(error)
    one = len(outliers) == 1
    trials = (recorded.trial if one else recorded.trials).capitalize()
    which = f"{trials} {', '.join(names)} {'stands' if one else 'stand'} out"
    asked = "is its track right?" if one else "are their tracks right?"
    return (
        f" {which} with up to {times:.0f} times the error of the others: {asked} --without "
        f"{','.join(names)}"
    )


def interval(problem: Problem, model: Model, name: str) -> tuple[float, float, float]:
    """Value of a quantity and its 90 % interval by the jackknife."""
    i = problem.index[name]
    times = deviates(len(by_fold(problem, model)))
    value, width = float(model.fit.values[i]), times * float(spread(problem, model)[i])
    return value, value - width, value + width


def effect_rows(problem: Problem, found: Finding) -> list[Table]:
    """What the rows of `effects` say of each name besides its test: numbers, physics, what shows
    it.
    """
    rows = []
    for n in found.named:
        e, numbers = n.candidate, {}
        for q in e.parameters:
            value, low, high = interval(problem, found.final, q.name)
            numbers[q.name] = {"value": value, "low": low, "high": high, "unit": q.unit}
        rows.append(
            {"parameters": numbers, "physics": e.physics, "shown_by": e.excitation, "same": e.same}
        )
    return rows


def same_rows(found: Finding, trial: str) -> list[str]:
    """A sentence for each pair of names that no trial tells apart."""
    return [
        f"{words(n.candidate.name)} or {words(s)}: no {trial} tells them apart, only "
        f"{n.candidate.separated_by}."
        for n in found.named
        for s in n.candidate.same
    ]


def error_table(recorded: Recorded, found: Finding, tracks: Mapping[str, np.ndarray]) -> Table:
    """Left-out errors before and after, by channel and by trial; tracks: `before` and `after` `[T,
    R, C]` m, of left-out trials.
    """
    size = {
        k: recorded.noise * np.sqrt(m.fit.held)
        for k, m in (("before", found.null), ("after", found.final))
    }

    def one(k, c):
        rows = recorded.rows[..., c]
        off = np.square(tracks[k][..., c] - recorded.places[..., c]) * rows
        return np.sqrt(off.sum(1) / np.maximum(rows.sum(1), 1))

    units = {n: ("m", recorded.noise) for n in recorded.channels} | dict(recorded.others)
    channels = {
        n: Errors(*units[n], {k: one(k, c) for k in size}) for c, n in enumerate(recorded.channels)
    }
    metric = f"median over left-out {recorded.trials} of the RMS error of a coordinate of the track"
    if recorded.others:
        metric += f", {', '.join(recorded.others)} by its noise for a length's"
    whole = Errors("m", recorded.noise, size)
    return error_rows(metric, recorded.noise_source, recorded.names, whole, channels)


def scored(found: Finding, alpha: float = Criteria.alpha) -> list[Scored]:
    """Every candidate, and what the first score test said of it. alpha: the test's level."""
    if found.named:
        chosen = "predicts left-out trials less well than what was chosen"
    else:
        chosen = "not among the best few that were fitted"
    rows = []
    for s in found.scores:
        p = min(1.0, s.p * len(found.scores))
        failed = f"does not pass the score test (p {p:.2g}), and was not fitted"
        rows.append(Scored(s.candidate, s.gain, p, failed if p >= alpha else chosen))
    return rows


def declared_rows(
    problem: Problem, model: Model, logs: Mapping[str, tuple[str, str]] = LOGS
) -> Table:
    """Declared quantities as fitted. logs: name and unit of what is fitted as a logarithm to the
    base of ten.
    """
    out = {}
    for name in problem.declared:
        q, (value, low, high) = (
            problem.quantities[problem.index[name]],
            interval(problem, model, name),
        )
        known = high - low < 0.3 * (q.high - q.low)
        unit, key = q.unit, name
        if name in logs:
            value, low, high = (
                10.0 ** float(np.clip(z, q.low, q.high)) for z in (value, low, high)
            )
            key, unit = logs[name]
        out[key] = {
            "value": value,
            "low": low,
            "high": high,
            "unit": unit,
            "identifiable": bool(known),
        }
    return out


def held_out(recorded: Recorded, tracks: Mapping[str, np.ndarray], mended: bool) -> list[Table]:
    """Each trial over time, measured and simulated while left out, for the page."""
    out = []
    for i, name in enumerate(recorded.names):
        k = recorded.mask[i] > 0

        def channels(z, i=i, k=k):
            return {n: z[i][k, c] for c, n in enumerate(recorded.channels)}

        units = {n: unit for n, (unit, _) in recorded.others.items()}
        after = channels(tracks["after"]) if mended else None
        out.append(
            {
                "trial": name,
                "unit": "m",
                "units": units,
                "time": recorded.time[i][k],
                "measured": channels(recorded.places),
                "before": channels(tracks["before"]),
                "after": after,
            }
        )
    return out


def plane_tracks(
    recorded: Recorded,
    tracks: Mapping[str, np.ndarray],
    mended: bool,
    axes: tuple[int, int] = (0, 1),
) -> Table:
    """Tracks `[n, 2]` m of all trials in a plane of two coordinates, for the page."""

    def cut(z):
        return [z[i][recorded.mask[i] > 0][:, list(axes)] for i in range(len(recorded.names))]

    return {
        "measured": cut(recorded.places),
        "before": cut(tracks["before"]),
        "after": cut(tracks["after"]) if mended else None,
    }
