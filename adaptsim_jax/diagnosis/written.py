"""What a diagnosis leaves on disk: the report before anything that may fail, each other file if it
can be written.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes, write_json
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.rows import LOGS, candidate_rows, declared_rows, over_floor, words
from adaptsim_jax.diagnosis.run import Page, Run, plain
from adaptsim_jax.diagnosis.schema import check, new_report
from adaptsim_jax.mend.model_toml import Form

MODEL, NEXT = "model.toml", "next_experiment.csv"
OF_OTHERS = (
    "leading.toml",
    "next_experiment.csv",
    "model.xml",
    "model.toml",
    "declared.xml",
    "report.json",
)
"""What an earlier run, perhaps of another kind, may have left in the folder."""
UNFINISHED = "Not finished: this is what the search had found when it was last written."


def cleared(folder: Path) -> Path:
    """The folder without what an earlier run left there."""
    for name in OF_OTHERS:
        (folder / name).unlink(missing_ok=True)
    return folder


def write_partial(folder: Path, report: Mapping[str, Any]) -> None:
    """`report.json` of a search that goes on, which says so. Where it cannot be written the search
    goes on without it.
    """
    partial = {**report, "message": f"{UNFINISHED} {report['message']}", "unfinished": True}
    with suppress(Exception):  # whatever it is, minutes of search must not go with it
        write_json(folder / "report.json", check(partial))


def write_all(
    folder: Path,
    report: dict[str, Any],
    evidence: dict[str, Any],
    page: Page,
    files: Mapping[str, Callable[[], str]],
    verify: Callable[[Path], dict[str, Any]] | None = None,
) -> None:
    """Report and page first, then each of the files (name -> what makes its text), then the page
    again, which links them. verify: runs the files of the folder beside the declared one, and
    gives by file where it is worse (`report["files"]`).

    A file that cannot be made or written is one line of the report's warnings, and no reason to
    lose the rest.
    """
    _page(folder, report, evidence, page)
    for name, text in files.items():
        try:
            write_bytes(folder / name, text().encode())
        except Exception as error:  # whatever it is, hours of search must not go with it
            _noted(report, evidence, f"{name} could not be written: {_line(error)}")
    if verify is not None:
        try:
            report["files"] = verify(folder)
        except Exception as error:
            _noted(report, evidence, f"the files that were written were not run: {_line(error)}")
    _page(folder, report, evidence, page)


def _page(folder: Path, report: dict[str, Any], evidence: dict[str, Any], page: Page) -> None:
    write_json(folder / "report.json", check(report))
    try:
        page(folder, check(report), evidence)
    except BadInput:
        raise
    except Exception as error:  # a drawing that fails leaves the numbers
        _noted(report, evidence, f"report.html could not be written: {_line(error)}")
        write_json(folder / "report.json", check(report))


def _noted(report: dict[str, Any], evidence: dict[str, Any], line: str) -> None:
    if line in report.setdefault("warnings", []):
        return
    report["warnings"].append(line)
    evidence.setdefault("audit", []).insert(0, {"severity": "warn", "where": "", "message": line})


def _line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BadInput):
        return text
    return f"{type(error).__name__}: {text}"


def keeping(
    folder: Path | None,
    task: str,
    model: str,
    problem: Problem,
    logs: Mapping[str, tuple[str, str]] = LOGS,
) -> Callable[[Finding], None]:
    """What leaves a readable report on disk as a search goes; nothing without a folder. logs: as of
    `declared_rows`.
    """
    count = len(dict.fromkeys(problem.trials))
    data = {"trials": count, "samples": int(problem.counts.sum()), "held_out_trials": count}

    def keep(found: Finding) -> None:
        final = found.final
        values = [
            f"{words(e.name)} "
            f"({', '.join(f'{q} {final.fit.values[problem.index[q]]:.3g}' for q in e.quantities)})"
            for e in final.added
        ]
        held = f"Left-out error {over_floor(found.null):.3g} times the noise as declared"
        if values:
            progress = f", {over_floor(final):.3g} with {', '.join(values)}, not yet judged"
        else:
            progress = ""
        assert folder is not None
        write_partial(
            folder,
            new_report(
                task,
                model,
                "structured_unattributed",
                f"{held}{progress}.",
                data,
                error={
                    "metric": "left-out error over the noise",
                    "before": over_floor(found.null),
                    "after": over_floor(final),
                },
                candidates=candidate_rows(found),
                declared={
                    k: declared_rows(problem, m, logs)
                    for k, m in (("before", found.null), ("after", final))
                },
            ),
        )

    if folder is None:
        return lambda found: None
    return keep


def finished(
    report: dict[str, Any],
    evidence: dict[str, Any],
    run: Run,
    plan: Mapping[str, Any] | None,
    folder: Path | None,
    model: Form,
    columns: tuple[str, ...],
    page: Page | None,
    more: Mapping[str, Callable[[], str]] = MappingProxyType({}),
) -> dict[str, Any]:
    """The checked report; where there is a folder, it, its page, `model.toml` and
    `next_experiment.csv` with `columns` are written, and the files `more` (name -> what makes its
    text).
    """
    if plan is not None:
        report["next_experiment"] = {k: plan[k] for k in ("message", "separates")} | (
            {"csv": NEXT} if plan["rows"] else {}
        )
    report["run"] = evidence["run"] = run.as_dict()
    report = check(report)
    if folder is not None:
        files = {MODEL: model.text, **more}
        if plan is not None and plan["rows"]:
            table = [
                ",".join([str(i), *(f"{x:.6f}" for x in row)])
                for i, row in enumerate(plan["rows"], 1)
            ]
            text = "\n".join([",".join(("trial", *columns)), *table, ""])
            files[NEXT] = partial(str, text)
        write_all(cleared(folder), report, evidence, page or plain, files)
    return report
