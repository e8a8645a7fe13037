"""The schema of `report.json` (design, section 4): made, checked and read here. Imports no JAX.

Every key of the design must be there; further keys are free. The page shows these extensions where
it finds them; all but the last two are checked:

    error.intervals       {before: [low, high], after: [low, high]}        over `intervals_over`
    error.per_channel.c   + unit, noise_floor, intervals           for channel c
    error.per_trial[i]    {trial, before, after, per_channel: {c: {before, after}}}
    candidates[i].status  one of `STATUSES`
    not_established       [sentence]
    warnings, notes       [sentence]                                        of the audit and the
    reader. The terminal shows them too trials                {differ, leave_out, headline, each:
    [{trial, error, unexplained_torque, size, odd}]}    `quality.trial_words`
    numbers               [{name, unit, value, low, high, trials, logs, each, apart, like}] by
    trial and log (`diagnosis.numbers`)
    error.stretch_s            length of the stretches that errors are simulated over
    error.noise_floor_source   a few words: repeats, smoothing residual, declared sensor noise
    power                 [{name, where, size, unit, power, alone?, rival?}] share found of what was
    injected

`candidates[i].held_out_gain` is the share of the
held-out residual that the candidate removes. A number that does not exist is null. In `declared`, a
parameter that the data do not fix has `identifiable` false; the page shows no number for it.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput

SCHEMA = 1  # version of the format of diagnoses: readers refuse others

VERDICTS = (
    "explained",
    "explained_class",
    "partly_explained",
    "structured_unattributed",
    "within_noise",
    "data_fault",
)
NAMELESS = ("within_noise", "data_fault")
"""Verdicts that name no effect: an effect beside one of them would contradict it."""

STATUSES = ("accepted", "rejected", "look-alike")
ERROR_KEYS = (
    "metric",
    "unit",
    "before",
    "after",
    "noise_floor",
    "per_channel",
    "per_trial",
)


class ReportError(ValueError):
    """A report that does not keep the schema: a fault of the program that made it. Lists every
    problem.
    """


def new_report(
    task: str, model: str, verdict: str, message: str, data: Mapping[str, int], **found: Any
) -> Table:
    """A report with every key and nothing found, then `found` laid over it; `error` may be given in
    part.
    """
    error = {
        "metric": "rmse",
        "unit": "1",
        "before": None,
        "after": None,
        "noise_floor": None,
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


LEFT = ("structured_unattributed", "partly_explained")
"""Verdicts that say that more than noise is left."""


def verdict(named: bool, left: bool, alike: bool = False) -> str:
    """The kind of the verdict.

    Args:
        named: Whether anything is.
        left: Whether more than noise is left.
        alike: Whether something else does as well in the place of a name.
    """
    if left:
        if named:
            return "partly_explained"
        return "structured_unattributed"
    if not named:
        return "within_noise"
    if alike:
        return "explained_class"
    return "explained"


def verdict_of(effects: Sequence[Table], left: bool) -> str:
    """The verdict of the rows `effects` of a report."""
    return verdict(bool(effects), left, any(row.get("alternatives") for row in effects))


def with_effects(report: Table, effects: Sequence[Table], left: bool | None = None) -> None:
    """Put other rows into `effects` of a report, and the verdict that goes with them, in place.
    left: whether more than noise is left, as it was where None.
    """
    left = report["verdict"] in LEFT if left is None else left
    report |= {"effects": list(effects), "verdict": verdict_of(effects, left)}


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


def check(report: Mapping[str, Any]) -> Table:
    """The report in JSON's types. Raises ReportError with all that is wrong with it."""
    clean = jsonable(report)
    found = problems(clean)
    if found:
        raise ReportError("report.json: " + "; ".join(found))
    return clean


def read_report(path: str | Path) -> Table:
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
    found = sorted(_validator().iter_errors(report), key=lambda error: error.json_path)
    lines = [f"{_place(error)}: {_brief(error.message)}" for error in found]
    if isinstance(report, Mapping) and isinstance(report.get("effects"), list):
        lines += _contradictions(report.get("verdict"), report["effects"])
    return lines


NUMBER = {"type": ["number", "null"]}
SIZE = NUMBER | {"minimum": 0}
TEXT = {"type": "string", "pattern": r"\S"}
FLAG = {"type": "boolean"}
SENTENCES = {"type": "array", "items": {"type": "string"}}


def _record(required: Mapping[str, Any], optional: Mapping[str, Any] | None = None) -> Table:
    """The schema of a table with these keys; others are free."""
    properties = {**required, **(optional or {})}
    return {"type": "object", "required": list(required), "properties": properties}


def _list_of(item: Mapping[str, Any]) -> Table:
    return {"type": "array", "items": item}


def _table_of(value: Mapping[str, Any]) -> Table:
    """The schema of a table whose keys are names of the user's."""
    return {"type": "object", "additionalProperties": value}


def report_schema() -> Table:
    """The JSON Schema of a report, draft 2020-12 and the keyword `ordered` (`_is_ordered`)."""
    ends = {"type": ["array", "null"], "minItems": 2, "maxItems": 2, "ordered": True}
    intervals = {"intervals": {"type": ["object", "null"], "additionalProperties": ends}}
    value: Table = _record(
        {"value": NUMBER, "low": NUMBER, "high": NUMBER, "unit": {"type": "string"}}
    ) | {"ordered": True}
    pair = _record({"before": SIZE, "after": SIZE}, {"noise_floor": SIZE} | intervals)
    effect = {
        "name": TEXT,
        "where": TEXT,
        "parameters": _table_of(value),
        "alternatives": SENTENCES,
    }
    candidate = {"name": TEXT, "where": TEXT, "why": TEXT, "held_out_gain": NUMBER}
    candidate |= {"p_value": NUMBER | {"minimum": 0, "maximum": 1}, "accepted": FLAG}
    declared = value | {
        "required": [*value["required"], "identifiable"],
        "properties": value["properties"] | {"identifiable": FLAG},
    }
    error = dict.fromkeys(ERROR_KEYS[:2], TEXT) | dict.fromkeys(ERROR_KEYS[2:5], SIZE)
    error |= {"per_channel": _table_of(pair), "per_trial": _list_of(pair)}
    part = {"of": TEXT, "value": NUMBER, "low": NUMBER, "high": NUMBER}
    like = {"name": TEXT, "correlation": NUMBER | {"minimum": -1, "maximum": 1}}
    number = {"name": TEXT, "unit": {"type": "string"}, "value": NUMBER, "low": NUMBER}
    number |= {"high": NUMBER, "trials": SIZE, "logs": SIZE, "apart": SENTENCES}
    number |= {"each": _list_of(_record(part)), "like": _list_of(_record(like))}
    counted = {"anyOf": [{"type": "array"}, SIZE]}
    required = {
        "schema": {"const": SCHEMA},
        "task": TEXT,
        "model": TEXT,
        "data": _record({"trials": SIZE, "samples": SIZE, "held_out_trials": counted}),
        "verdict": {"enum": list(VERDICTS)},
        "message": TEXT,
        "effects": _list_of(_record(effect)),
        "error": _record(error, intervals),
        "candidates": _list_of(_record(candidate, {"status": {"enum": list(STATUSES)}})),
        "declared": _record({"before": _table_of(declared), "after": _table_of(declared)}),
        "next_experiment": {},
    }
    further = dict.fromkeys(("not_established", "warnings", "notes"), SENTENCES)
    return _record(required, further | {"numbers": _list_of(_record(number))})


@functools.cache
def _validator() -> Any:
    # a tenth of a second, which a command that reads no report does not spend
    from jsonschema import Draft202012Validator, validators

    return validators.extend(Draft202012Validator, {"ordered": _is_ordered})(report_schema())


def _is_ordered(_validator: Any, _wanted: bool, ends: Any, _schema: Any) -> Iterator[Any]:
    """JSON Schema's keyword for intervals, as [low, high] or as a table: the ends in order."""
    from jsonschema import ValidationError

    if isinstance(ends, Mapping):
        ends = [ends.get("low"), ends.get("high")]
    whole = isinstance(ends, list) and len(ends) == 2
    if whole and all(isinstance(end, (int, float)) for end in ends) and ends[0] > ends[1]:
        yield ValidationError(f"the interval [{ends[0]:g}, {ends[1]:g}] is upside down")


def _place(error: Any) -> str:
    """Where in the report an error is, as `effects[0].name`."""
    return error.json_path.removeprefix("$").removeprefix(".") or "the report"


def _brief(message: str) -> str:
    """A message of the validator, which quotes the whole value, short enough for a line."""
    if len(message) <= 160:
        return message
    return f"{message[:80]} ... {message[-80:]}"


def _contradictions(verdict: Any, effects: list) -> list[str]:
    """Effects beside a verdict that names none, and the reverse."""
    if verdict in NAMELESS and effects:
        return [f"effects: the verdict {verdict} names no effect, yet {len(effects)} are listed"]
    if verdict in ("explained", "explained_class", "partly_explained") and not effects:
        return [f"effects: the verdict {verdict} names an effect, yet none is listed"]
    rows = [effect for effect in effects if isinstance(effect, Mapping)]
    if verdict == "explained_class" and not any(row.get("alternatives") for row in rows):
        return ["effects: the verdict explained_class names the alternatives, yet none are listed"]
    return []
