"""What a diagnosis leaves on disk: the report before anything that may fail, each other file if it
can be written.
"""

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes, write_json
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import Account, Headline, report_of, words
from adaptsim_jax.diagnosis.rows import LOGS, declared_rows, label, over_floor, scored
from adaptsim_jax.diagnosis.run import Page, Run, plain
from adaptsim_jax.diagnosis.schema import check
from adaptsim_jax.logs.pool import Data, paths_of

MODEL, NEXT, FAULTS = "model.toml", "next_experiment.csv", "faults.txt"
OF_OTHERS = (
    "leading.toml",
    "next_experiment.csv",
    "model.xml",
    "model.toml",
    "declared.xml",
    "report.json",
    FAULTS,
)
"""What an earlier run, perhaps of another kind, may have left in the folder."""
UNFINISHED = "Not finished: this is what the search had found when it was last written."


def cleared(folder: Path) -> Path:
    """The folder without what an earlier run left there."""
    for name in OF_OTHERS:
        (folder / name).unlink(missing_ok=True)
    return folder


def write_partial(folder: Path, make: Callable[[], Mapping[str, Any]]) -> None:
    """`report.json` of a search that goes on, which says so. Where it cannot be made or written the
    search goes on without it.
    """
    try:
        report = make()
        message = f"{UNFINISHED} {report['message']}"
        write_json(
            folder / "report.json", check({**report, "message": message, "unfinished": True})
        )
    except Exception as error:  # whatever it is, minutes of search must not go with it
        fault_line(folder, error)


def fault_line(folder: Path, error: Exception) -> str:
    """An error in one line. Of a fault of the program, which no input and no disk explains, the
    line says so, and the traceback is added to `faults.txt`.
    """
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BadInput):
        return error.coded
    if isinstance(error, OSError):
        return f"{type(error).__name__}: {text}"
    with suppress(OSError), open(folder / FAULTS, "a", encoding="utf-8") as file:
        file.writelines([*traceback.format_exception(error), "\n"])
    return f"{type(error).__name__}: {text}; a fault of the program, see {FAULTS}"


@contextmanager
def faults_into(folder: Path) -> Iterator[None]:
    """Add the traceback of a fault that ends the work inside to `faults.txt`; what was found so far
    stays beside it.
    """
    try:
        yield
    except (BadInput, OSError):
        raise
    except Exception as error:
        fault_line(folder, error)
        error.add_note(f"its traceback is in {folder / FAULTS}")
        raise


def write_all(
    folder: Path,
    report: Table,
    evidence: Table,
    page: Page,
    files: Mapping[str, Callable[[], str]],
    verify: Callable[[Path], Table] | None = None,
) -> None:
    """Report and page first, then each of the files (name -> what makes its text), then the page
    again, which links them. verify: runs the files of the folder beside the declared one, and
    gives by file where it is worse (`report["files"]`).

    A file that cannot be made or written is one line of the report's warnings, and no reason to
    lose the rest.
    """
    if (folder / FAULTS).exists():
        line = f"a partial report could not be written: a fault of the program, see {FAULTS}"
        _noted(report, evidence, line)
    _page(folder, report, evidence, page)
    for name, text in files.items():
        with _noting(folder, report, evidence, name):
            write_bytes(folder / name, text().encode())
    if verify is not None:
        try:
            report["files"] = verify(folder)
        except Exception as error:
            _noted(
                report,
                evidence,
                f"the files that were written were not run: {fault_line(folder, error)}",
            )
    _page(folder, report, evidence, page)


def _page(folder: Path, report: Table, evidence: Table, page: Page) -> None:
    with _noting(folder, report, evidence, "report.json"):
        write_json(folder / "report.json", check(report))
    with _noting(folder, report, evidence, "report.html"):
        page(folder, check(report), evidence)


@contextmanager
def _noting(folder: Path, report: Table, evidence: Table, name: str) -> Iterator[None]:
    """What a file that cannot be written costs: a warning, whatever it is. Hours of search, what
    is printed, and the other files must not go with it.
    """
    try:
        yield
    except Exception as error:
        _noted(report, evidence, f"{name} could not be written: {fault_line(folder, error)}")


def _noted(report: Table, evidence: Table, line: str) -> None:
    if line in report.setdefault("warnings", []):
        return
    report["warnings"].append(line)
    evidence.setdefault("audit", []).insert(0, {"severity": "warn", "where": "", "message": line})


@dataclass(frozen=True)
class DiagnosisRequest:
    """What a diagnosis was asked of.

    Args:
        data, model: The recording, one log or several, and its model file, None: as its
            meta.toml says.
        folder: None: nothing is written.
        without: Trials that are left out.
        run: How it was called, and when.
    """

    data: Data
    model: str | Path | None
    folder: Path | None
    without: tuple[str, ...]
    run: Run

    @property
    def made(self) -> Table:
        """How a file was made, as it says."""
        return {"data": ", ".join(map(str, paths_of(self.data))), **self.run.as_dict()}


@dataclass(frozen=True)
class Answer:
    """What a search says, and the files that hold it.

    Args:
        report: By `diagnosis.schema`.
        evidence: The arrays behind its page.
        files: What makes the text of each file, by name.
        verify: Runs the files that were written (`write_all`).
        numbers: Each number by trial and log (`diagnosis.numbers`).
    """

    report: Table
    evidence: Table
    files: Mapping[str, Callable[[], str]]
    verify: Callable[[Path], Table] | None
    numbers: Sequence[Table] = ()


@dataclass(frozen=True)
class Output:
    """Where a diagnosis is written, and with what.

    Args:
        folder: None: nothing is written.
        page: Writes the report and its page; a plain `report.json` where None.
        files: What makes the text of each further file, by name.
        verify: Runs the files that were written (`write_all`).
    """

    folder: Path | None
    page: Page | None = None
    files: Mapping[str, Callable[[], str]] = field(default_factory=dict)
    verify: Callable[[Path], Table] | None = None


def finished(report: Table, evidence: Table, run: Run, output: Output) -> Table:
    """The checked report with how it was run; where there is a folder, all of it is written."""
    report["run"] = evidence["run"] = run.as_dict()
    report = check(report)
    if output.folder is not None:
        page = output.page or plain
        write_all(output.folder, report, evidence, page, output.files, output.verify)
    return check(report)


def planned(
    report: Table, plan: Mapping[str, Any] | None, columns: Sequence[str]
) -> dict[str, Callable[[], str]]:
    """Put a plan of trials into a report as its next experiment, in place; the file that holds its
    rows, if it has any, with `columns`.
    """
    if plan is None:
        return {}
    report["next_experiment"] = {k: plan[k] for k in ("message", "separates")}
    if not plan["rows"]:
        return {}
    report["next_experiment"]["csv"] = NEXT
    table = [",".join(("trial", *columns))]
    for i, row in enumerate(plan["rows"], 1):
        table.append(",".join([str(i), *(f"{x:.6f}" for x in row)]))
    return {NEXT: partial(str, "\n".join([*table, ""]))}


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
    if folder is None:
        return lambda found: None
    count = len(dict.fromkeys(problem.trials))
    data = {"trials": count, "samples": int(problem.counts.sum()), "held_out_trials": count}

    def keep(found: Finding) -> None:
        write_partial(folder, lambda: report_of(found, _partial_account(found)))

    def _partial_account(found: Finding) -> Account:
        final = found.final
        values = []
        for e in final.added:
            numbers = [f"{q} {final.fit.values[problem.index[q]]:.3g}" for q in e.names]
            values.append(f"{words(e.name)} ({', '.join(numbers)})")
        text = f"Left-out error {over_floor(found.null):.3g} times the noise as declared"
        if values:
            text += f", {over_floor(final):.3g} with {', '.join(values)}, not yet judged"
        return Account(
            task,
            model,
            data,
            label,
            [],
            scored(found),
            Headline(f"{text}.", "", none=""),
            True,
            {
                "metric": "left-out error over the noise",
                "before": over_floor(found.null),
                "after": over_floor(final),
            },
            lambda m: declared_rows(problem, m, logs),
        )

    return keep
