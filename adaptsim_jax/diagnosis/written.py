"""What a diagnosis leaves on disk: the report before anything that may fail, each other file if it
can be written.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes, write_json
from adaptsim_jax.diagnosis.run import Page
from adaptsim_jax.diagnosis.schema import check

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
    """`report.json` of a search that goes on, which says so; where it cannot be written the search
    goes on without it.
    """
    told = {**report, "message": f"{UNFINISHED} {report['message']}", "unfinished": True}
    with suppress(Exception):  # whatever it is, minutes of search must not go with it
        write_json(folder / "report.json", check(told))


def write_all(
    folder: Path,
    report: dict[str, Any],
    evidence: dict[str, Any],
    page: Page,
    files: Mapping[str, Callable[[], str]],
) -> None:
    """Report and page first, then each of the files (name -> what makes its text), then the page
    again, which links them.

    A file that cannot be made or written is one line of the report's warnings, and no reason to
    lose the rest.
    """
    _page(folder, report, evidence, page)
    for name, text in files.items():
        try:
            write_bytes(folder / name, text().encode())
        except Exception as error:  # whatever it is, hours of search must not go with it
            _told(report, evidence, f"{name} could not be written: {_line(error)}")
    _page(folder, report, evidence, page)


def _page(folder: Path, report: dict[str, Any], evidence: dict[str, Any], page: Page) -> None:
    write_json(folder / "report.json", check(report))
    try:
        page(folder, check(report), evidence)
    except BadInput:
        raise
    except Exception as error:  # a drawing that fails leaves the numbers
        _told(report, evidence, f"report.html could not be written: {_line(error)}")
        write_json(folder / "report.json", check(report))


def _told(report: dict[str, Any], evidence: dict[str, Any], line: str) -> None:
    if line in report.setdefault("warnings", []):
        return
    report["warnings"].append(line)
    evidence.setdefault("audit", []).insert(0, {"severity": "warn", "where": "", "message": line})


def _line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BadInput):
        return text
    return f"{type(error).__name__}: {text}"
