"""The report of a diagnosis: `report.json`, one self-contained `report.html`, a few lines for the
terminal.

    write_diagnosis(out, report, evidence)
    print_summary(report, console, out)

`report` keeps `diagnosis.schema`. `evidence` holds NumPy arrays for the figures; every key may be
missing:

    held_out         [{trial, time [T] s, measured {channel: [T]}, before {...}, after {...} or
                     None, units {channel: unit}}], NaN where windows join. The first trial is
                     shown, the others fold out
    tracks           {measured [[T, 2] m], before [...], after [...] or None} of trials on a table,
    seen from above torque           [{joint, unit, time [n] s, measured, file, fitted [n]}] along
    the measured motion friction         [{joint, unit, speed [n], missing [n], modelled [n]}] what
    resists, against speed
    audit            [{severity, where, message}]
    run              {command, version, seed, seconds}
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from adaptsim_jax.core.files import output_folder, write_bytes, write_json
from adaptsim_jax.diagnosis import schema
from adaptsim_jax.diagnosis.criteria import REPORT
from adaptsim_jax.report import diagnosis_explore, explore
from adaptsim_jax.report import diagnosis_figures as figures
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_rows as rows_of
from adaptsim_jax.report import diagnosis_words as words

MOST_LINES = 6
"""Warnings, and notes, that the terminal shows."""
MOST_CANDIDATES = 8
"""Rows of candidates that the page shows at first."""
MOST_NUMBERS = 12
"""Rows of numbers by trial and log, likewise."""

GOES_TO = {
    "pendulum": "adaptsim replay, diagnose and env.toml",
    "mechanism": "adaptsim replay",
    "pushing": "adaptsim train pushing --model",
    "scooping": "people: no command takes it yet",
    "toss": "people: no command takes it yet",
}
"""Where a mended model of a task may go, in words."""


def write_diagnosis(out: Path, report: dict, evidence: dict) -> None:
    """Write `report.json` and `report.html` into `out`, whole or not at all.

    Write `model.toml` and the next experiment's CSV first: the page links the files that it finds
    in `out`. Raises schema.ReportError where the report does not keep the schema (and writes
    nothing then), BadInput where `out` cannot be written.
    """
    out = output_folder(out)
    clean = schema.check(report)
    write_json(out / "report.json", clean)
    write_bytes(out / "report.html", render(clean, evidence, out).encode())


def render(report: dict[str, Any], evidence: Mapping, out: Path | None = None) -> str:
    """The page as text, from a checked report. `out` is looked at for the files to link."""
    mended = bool(report["effects"])
    error = report["error"] if mended else _declared_only(report["error"])
    traces, left_out = diagnosis_explore.held_out(evidence.get("held_out") or [], error)
    above = diagnosis_explore.tracks(evidence.get("tracks") or {})
    page = {
        "report": report,
        "verdict": words.VERDICTS[report["verdict"]],
        "headline": words.headline(report),
        "todo": words.todo(report),
        "mended": mended,
        "error": error,
        "data": _data_words(report["data"]),
        "measures": report.get("yardsticks") or {},
        "measure_names": rows_of.NAMES,
        "judged": rows_of.why_judge(report),
        "as_filed": (report.get("yardsticks") or {}).get("as_filed", False),
        "torque_figures": figures.torque_figures(evidence),
        "friction_figures": figures.friction_figures(evidence),
        "effects": rows_of.effect_rows(report),
        "improvement": words.improvement(error),
        "errors": _error_rows(error),
        "error_figures": _error_figures(error),
        "above": above,
        "numbers": rows_of.number_rows(report),
        "pooled": any(row["logs"] is not None for row in report.get("numbers") or []),
        "most_numbers": MOST_NUMBERS,
        "differ": rows_of.by_error(report.get("trials") or {}),
        "above_from": figures.view_side(evidence.get("tracks") or {}),
        "traces": traces,
        "trials_left_out": left_out,
        "power": report.get("power") or [],
        "candidates": sorted(report["candidates"], key=lambda row: not row["accepted"]),
        "status": partial(words.status, report=report),
        "most_candidates": MOST_CANDIDATES,
        "one_by_one": bool(report.get("fit_coordinates")),
        "declared": rows_of.declared_rows(report),
        "not_established": words.not_established(report),
        "next": _next_experiment(report, out),
        "audit": rows_of.audit_rows(evidence),
        "audit_first": report["verdict"] == "data_fault",
        "run": evidence.get("run") or {},
        "files": _links(out),
        "model_goes_to": GOES_TO.get(report["task"], GOES_TO["pendulum"]),
        "levels": {"parameter": REPORT.parameter_level, "error": REPORT.error_level},
        "script": explore.script(bool(traces or above)),
    }
    return explore.filled("diagnosis.html.j2", **page)


def _data_words(data: Mapping) -> str:
    held = data["held_out_trials"]
    held = len(held) if isinstance(held, list) else held
    parts = [fmt.count(data["trials"], "trial"), fmt.count(data["samples"], "sample")]
    if held:
        whole = int(held) == data["trials"]
        parts.insert(1, "each held out in turn" if whole else f"{int(held)} held out")
    return ", ".join(parts)


def _declared_only(error: Mapping) -> dict[str, Any]:
    """Without an effect nothing was mended: whatever stands under `after` is the declared model
    once more.
    """
    channels = {name: {**pair, "after": None} for name, pair in error["per_channel"].items()}
    trials = [{**trial, "after": None} for trial in error["per_trial"]]
    for trial in trials:
        trial["per_channel"] = {
            c: {**p, "after": None} for c, p in (trial.get("per_channel") or {}).items()
        }
    return {**error, "after": None, "per_channel": channels, "per_trial": trials}


def _error_rows(error: Mapping) -> list[dict[str, Any]]:
    rows = [{"name": f"overall ({error['metric']})", "unit": error["unit"], "pair": error}]
    for channel, pair in error["per_channel"].items():
        rows.append(
            {
                "name": channel,
                "unit": pair.get("unit") or figures.channel_unit(channel),
                "pair": pair,
            }
        )
    for row in rows:
        pair, unit = row["pair"], row["unit"]
        like = max(pair.get("before") or 0.0, pair.get("after") or 0.0)
        for stage in ("before", "after"):
            low, high = (pair.get("intervals") or {}).get(stage) or (None, None)
            row[stage] = fmt.between(pair.get(stage), low, high, unit, like)
        row["floor"] = fmt.quantity(pair.get("noise_floor"), unit, like=like)
        row["change"] = words.improvement(pair)["change"] or fmt.DASH
    return [row for row in rows if row["pair"].get("before") is not None]


def _error_figures(error: Mapping) -> list[str]:
    pictures = []
    for index, row in enumerate(_error_rows(error)):
        dots = figures.trial_dots(error, None if index == 0 else row["name"])
        one = row["pair"].get("after") is None
        like = error["before"] if row["unit"] == error["unit"] else None
        paint = figures.error_pair(
            "overall" if index == 0 else row["name"], row["unit"], row["pair"], dots, like
        )
        label = f"error of {row['name']}: declared {row['before']}, mended {row['after']}"
        pictures.append(figures.draw(paint, 1.4 if one else 1.75, label))
    return pictures


def _next_experiment(report: Mapping, out: Path | None) -> dict[str, Any]:
    name = _csv_name(report)
    there = bool(name) and (out is None or (out / str(name)).exists())
    return {"words": words.next_words(report), "csv": name, "linked": there}


def _links(out: Path | None) -> list[str]:
    names = ("model.xml", "model.toml", "leading.toml", "report.json")
    return [
        name
        for name in names
        if name == "report.json" or (out is not None and (out / name).exists())
    ]


def print_summary(report: dict, console: Console, out: Path | None = None) -> None:
    """The verdict, what was found, the error before and after, what to do next, and where the files
    are.
    """
    report = schema.check(report)
    colour = {"good": "green", "calm": "cyan", "open": "yellow", "bad": "red"}[
        words.VERDICTS[report["verdict"]]["tone"]
    ]
    console.print(
        Text(report["verdict"], style=f"bold {colour}"), Text(words.headline(report), style="bold")
    )
    console.print(Padding(Text(report["message"]), (0, 0, 1, 2)))
    table = Table.grid(padding=(0, 2))
    for name, value in _summary_rows(report):
        table.add_row(Text(name, style="dim"), Text(value))
    console.print(Padding(table, (0, 0, 0, 2)))
    for name in (
        "report.html",
        "report.json",
        "model.xml",
        "model.toml",
        "leading.toml",
        _csv_name(report),
    ):
        if out is not None and name and (Path(out) / name).exists():
            console.print(Text(f"  {Path(out) / name}", style="dim"), soft_wrap=True)


def _summary_rows(report: Mapping) -> list[tuple[str, str]]:
    rows = [("data", _data_words(report["data"]))]
    for key, word in (("warnings", "warning"), ("notes", "note")):
        lines = report.get(key) or []
        rows += [(word, line) for line in lines[:MOST_LINES]]
        if len(lines) > MOST_LINES:
            rows.append((word, f"and {len(lines) - MOST_LINES} more, see report.html"))
    for effect in rows_of.effect_rows(report):
        values = [f"{row['name']} = {row['value']}" for row in effect["parameters"]]
        rows.append(
            ("effect", f"{effect['title']}: {', '.join(values)}" if values else effect["title"])
        )
    if report["effects"]:
        error = report["error"]
    else:
        error = _declared_only(report["error"])
    for row in _error_rows(error):
        if row["pair"].get("after") is not None:
            after = f" -> {row['after']} ({row['change']})"
        else:
            after = ""
        if row["floor"] != fmt.DASH:
            floor = f", noise floor {row['floor']}"
        else:
            floor = ""
        rows.append(("held-out error", f"{row['name']}: {row['before']}{after}{floor}"))
    rows.append(("next", words.next_words(report) or words.todo(report)))
    return rows


def _csv_name(report: Mapping) -> str | None:
    given = report.get("next_experiment")
    if isinstance(given, Mapping):
        return given.get("csv")
    return None
