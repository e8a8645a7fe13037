"""The schema of `report.json` (design, section 4): made, checked and read here. Imports no JAX.

Every key of the design must be there; further keys are free. The page shows these extensions where
it finds them; all but the last two are checked:

    error.intervals       {before: [low, high], after: [low, high]}        over held-out trials
    error.per_channel.c   + unit, noise_floor, ceiling, intervals           for channel c
    error.per_trial[i]    {trial, before, after, per_channel: {c: {before, after}}}
    candidates[i].status  one of `STATUSES`
    not_established       [sentence]
    warnings, notes       [sentence]                                        of the audit and the
    reader; the terminal shows them too trials                {differ, leave_out, headline, each:
    [{trial, error, unexplained_torque, size, odd}]}    `quality.trial_words` task_reward
    {before, after, oracle}                           in [0, 1]
    error.stretch_s            length of the stretches that errors are simulated over
    error.noise_floor_source   a few words: repeats, smoothing residual, declared sensor noise
    power                 [{name, where, size, unit, power}]                share found of what was
    injected

`error.ceiling` is in `error.unit`, as its neighbours are: the held-out error of the declared model
with smooth forces of any shape added (`sysid.evaluate.flexible`; `error.ceiling_groups` says what
they follow). It names nothing and has many parameters to learn, so a named effect may do better;
one that does much worse has left something out. `candidates[i].held_out_gain` is the share of the
held-out residual that the candidate removes. A number that does not exist is null. In `declared`, a
parameter that the data do not fix has `identifiable` false; the page shows no number for it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput

SCHEMA = 1
PARAMETER_LEVEL, ERROR_LEVEL = 0.90, 0.95
"""Coverage of the intervals of parameters (effects and declared), and of the error over held-out
trials.
"""

VERDICTS = (
    "explained",
    "explained_class",
    "partly_explained",
    "confounded_with_declared",
    "structured_unattributed",
    "within_noise",
    "underpowered",
    "data_fault",
)
NAMELESS = ("within_noise", "underpowered", "data_fault")
"""Verdicts that name no effect: an effect beside one of them would contradict it."""

STATUSES = ("accepted", "rejected", "confounded", "look-alike")
ERROR_KEYS = (
    "metric",
    "unit",
    "before",
    "after",
    "noise_floor",
    "ceiling",
    "per_channel",
    "per_trial",
)


class ReportError(ValueError):
    """A report that does not keep the schema: a fault of the program that made it. Lists every
    problem.
    """


def new_report(
    task: str, model: str, verdict: str, message: str, data: Mapping[str, int], **found: Any
) -> dict[str, Any]:
    """A report with every key and nothing found, then `found` laid over it; `error` may be given in
    part.
    """
    error = {
        "metric": "rmse",
        "unit": "1",
        "before": None,
        "after": None,
        "noise_floor": None,
        "ceiling": None,
    }
    error |= {"per_channel": {}, "per_trial": []} | dict(found.pop("error", None) or {})
    report = {
        "schema": SCHEMA,
        "task": task,
        "model": model,
        "data": dict(data),
        "verdict": verdict,
    }
    report |= {"message": message, "effects": [], "error": error, "candidates": []}
    return report | {"declared": {"before": {}, "after": {}}, "next_experiment": None} | found


def jsonable(value: Any) -> Any:
    """`value` in JSON's own types: arrays to lists, NumPy numbers to Python's, NaN and infinities
    to null.
    """
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (float, np.floating)):
        if math.isfinite(value):
            return float(value)
        return None
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    raise TypeError(f"a report holds JSON values, not {type(value).__name__}")


def check(report: Mapping[str, Any]) -> dict[str, Any]:
    """The report in JSON's types. Raises ReportError with all that is wrong with it."""
    clean = jsonable(report)
    found = problems(clean)
    if found:
        raise ReportError("report.json: " + "; ".join(found))
    return clean


def read_report(path: str | Path) -> dict[str, Any]:
    """A checked report from a file, for programs that read reports. Raises BadInput where it is
    missing, torn or of another schema.
    """
    try:
        return check(json.loads(Path(path).read_text(encoding="utf-8")))
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be read ({error.strerror}); name a report of `adaptsim diagnose`"
        ) from error
    except (ReportError, ValueError) as error:
        raise BadInput(
            f"{path}: not a whole report ({error}); run `adaptsim diagnose` again"
        ) from error


def problems(report: Any) -> list[str]:
    """What is wrong with a report of JSON types, each `key: why`; empty where it keeps the
    schema.
    """
    if not isinstance(report, Mapping):
        return [f"the report is a {type(report).__name__}, not a table"]
    found = _Problems()
    found.equal(report, "schema", SCHEMA)
    for key in ("task", "model", "message"):
        found.text(report, key)
    found.one_of(report, "verdict", VERDICTS)
    _check_data(found, found.table(report, "data"))
    _check_effects(found, report)
    _check_error(found, found.table(report, "error"))
    _check_candidates(found, report)
    _check_declared(found, found.table(report, "declared"))
    if "next_experiment" not in report:
        found.add("next_experiment", "missing")
    _check_extensions(found, report)
    return found.lines


class _Problems:
    """Collects `key: why` while it looks things up, so that one pass reports everything."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, where: str, why: str) -> None:
        self.lines.append(f"{where}: {why}")

    def equal(self, table: Mapping, key: str, wanted: Any) -> None:
        if table.get(key) != wanted:
            self.add(key, f"must be {wanted!r}, is {table.get(key)!r}")

    def text(self, table: Mapping, key: str, where: str = "") -> None:
        if not isinstance(table.get(key), str) or not table[key].strip():
            self.add(where + key, "a text is wanted")

    def one_of(self, table: Mapping, key: str, allowed: Sequence[str], where: str = "") -> None:
        if table.get(key) not in allowed:
            self.add(where + key, f"one of {', '.join(allowed)} is wanted, not {table.get(key)!r}")

    def table(self, table: Mapping, key: str, where: str = "") -> Mapping:
        return self._typed(table, key, Mapping, "a table", {}, where)

    def rows(self, table: Mapping, key: str, where: str = "") -> list[Mapping]:
        rows = self._typed(table, key, list, "a list", [], where)
        if not all(isinstance(row, Mapping) for row in rows):
            self.add(where + key, "a list of tables is wanted")
        return [row for row in rows if isinstance(row, Mapping)]

    def _typed(
        self, table: Mapping, key: str, kind: type, name: str, default: Any, where: str
    ) -> Any:
        value = table.get(key)
        if isinstance(value, kind):
            return value
        self.add(where + key, f"{name} is wanted" + ("" if key in table else ", it is missing"))
        return default

    def number(
        self, table: Mapping, key: str, where: str, low: float = -math.inf, high: float = math.inf
    ) -> None:
        value = table.get(key)
        if key not in table:
            self.add(where + key, "missing (null where it does not exist)")
        elif value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            self.add(where + key, f"a number or null is wanted, not {value!r}")
        elif value is not None and not low <= value <= high:
            self.add(where + key, f"{value:g} lies outside [{low:g}, {high:g}]")

    def interval(self, table: Mapping, where: str) -> None:
        """A value with `low`, `high` and `unit`; the ends in order."""
        for key in ("value", "low", "high"):
            self.number(table, key, where)
        if not isinstance(table.get("unit"), str):
            self.add(where + "unit", "a text is wanted")
        self.ordered((table.get("low"), table.get("high")), where + "low")

    def ordered(self, ends: Any, where: str) -> None:
        if not isinstance(ends, (list, tuple)) or len(ends) != 2:
            self.add(where, "an interval [low, high] is wanted")
        elif all(isinstance(end, (int, float)) for end in ends) and ends[0] > ends[1]:
            self.add(where, f"the interval [{ends[0]:g}, {ends[1]:g}] is upside down")


def _check_data(found: _Problems, data: Mapping) -> None:
    for key in ("trials", "samples"):
        found.number(data, key, "data.", low=0)
    held_out = data.get("held_out_trials")
    if not isinstance(held_out, list):
        found.number(data, "held_out_trials", "data.", low=0)


def _check_effects(found: _Problems, report: Mapping) -> None:
    effects, verdict = found.rows(report, "effects"), report.get("verdict")
    for index, effect in enumerate(effects):
        where = f"effects[{index}]."
        found.text(effect, "name", where)
        found.text(effect, "where", where)
        for name, parameter in found.table(effect, "parameters", where).items():
            if isinstance(parameter, Mapping):
                found.interval(parameter, f"{where}parameters.{name}.")
            else:
                found.add(f"{where}parameters.{name}", "a table is wanted")
        alternatives = effect.get("alternatives")
        if not isinstance(alternatives, list) or not all(
            isinstance(name, str) for name in alternatives
        ):
            found.add(
                where + "alternatives", "a list of names is wanted (empty where it stands alone)"
            )
    if verdict in NAMELESS and effects:
        found.add(
            "effects", f"the verdict {verdict} names no effect, yet {len(effects)} are listed"
        )
    if verdict in ("explained", "explained_class", "partly_explained") and not effects:
        found.add("effects", f"the verdict {verdict} names an effect, yet none is listed")
    if verdict == "explained_class" and not any(effect.get("alternatives") for effect in effects):
        found.add(
            "effects", "the verdict explained_class names the alternatives, yet none are listed"
        )


def _check_error(found: _Problems, error: Mapping) -> None:
    for key in ERROR_KEYS[:2]:
        found.text(error, key, "error.")
    for key in ERROR_KEYS[2:6]:
        found.number(error, key, "error.", low=0)
    for name, channel in found.table(error, "per_channel", "error.").items():
        _check_pair(found, channel, f"error.per_channel.{name}.")
    for index, trial in enumerate(found.rows(error, "per_trial", "error.")):
        _check_pair(found, trial, f"error.per_trial[{index}].")
    _check_intervals(found, error, "error.")


def _check_pair(found: _Problems, pair: Any, where: str) -> None:
    if not isinstance(pair, Mapping):
        found.add(where[:-1], "a table with before and after is wanted")
        return
    for key in ("before", "after"):
        found.number(pair, key, where, low=0)
    for key in ("noise_floor", "ceiling"):
        if key in pair:
            found.number(pair, key, where, low=0)
    _check_intervals(found, pair, where)


def _check_intervals(found: _Problems, table: Mapping, where: str) -> None:
    intervals = table.get("intervals")
    if intervals is None:
        return
    if not isinstance(intervals, Mapping):
        found.add(where + "intervals", "a table with before and after is wanted")
        return
    for key, ends in intervals.items():
        if ends is not None:
            found.ordered(ends, f"{where}intervals.{key}")


def _check_candidates(found: _Problems, report: Mapping) -> None:
    for index, candidate in enumerate(found.rows(report, "candidates")):
        where = f"candidates[{index}]."
        for key in ("name", "where", "why"):
            found.text(candidate, key, where)
        found.number(candidate, "held_out_gain", where)
        found.number(candidate, "p_value", where, 0.0, 1.0)
        if not isinstance(candidate.get("accepted"), bool):
            found.add(where + "accepted", "true or false is wanted")
        if "status" in candidate:
            found.one_of(candidate, "status", STATUSES, where)


def _check_declared(found: _Problems, declared: Mapping) -> None:
    for stage in ("before", "after"):
        for name, parameter in found.table(declared, stage, "declared.").items():
            where = f"declared.{stage}.{name}."
            if not isinstance(parameter, Mapping):
                found.add(where[:-1], "a table is wanted")
                continue
            found.interval(parameter, where)
            if not isinstance(parameter.get("identifiable"), bool):
                found.add(where + "identifiable", "true or false is wanted")


def _check_extensions(found: _Problems, report: Mapping) -> None:
    for key in ("not_established", "warnings", "notes"):
        sentences = report.get(key, [])
        if not isinstance(sentences, list) or not all(isinstance(line, str) for line in sentences):
            found.add(key, "a list of sentences is wanted")
    reward = report.get("task_reward")
    if reward is not None and not isinstance(reward, Mapping):
        found.add("task_reward", "a table with before and after is wanted")
    elif reward is not None:
        for key in ("before", "after"):
            found.number(reward, key, "task_reward.")
