"""The tour of `adaptsim demo`: a pendulum adapted beside baselines, a push and a scoop before and
after, a recording diagnosed, one page.

Small sizes of the real thing: nothing here computes what the other commands do not. A tour that was
stopped is taken up again by the same call, from the checkpoints of its runs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from adaptsim_jax.commands.demo_config import HINGE, PENDULUM, SHORT, DemoConfig, commands
from adaptsim_jax.commands.demo_parts import Adapted, Before, Pendulum, contact_part, pendulum_part
from adaptsim_jax.commands.diagnose import diagnose
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.parallel import worker_process
from adaptsim_jax.core.progress import Parts, Report, silent_parts
from adaptsim_jax.report.diagnosis import write_diagnosis


class Diagnosed(NamedTuple):
    """report: as report.json; held_out: measured and simulated angles of a trial, as the page of a
    diagnosis is given them.
    """

    report: dict[str, Any]
    held_out: list[dict[str, Any]]


class DemoResult(NamedTuple):
    """What the tour found: adapted pendulum runs, their comparison (as results.json) and reward
    map, the push, the scoop, the diagnosis, where it was asked for the report on the second sample,
    and what to type for the same.
    """

    adapted: list[Adapted]
    results: dict[str, Any]
    reward_map: Any
    push: Before
    scoop: Before
    diagnosis: Diagnosed
    double: dict[str, Any] | None
    commands: dict[str, str]


def demo(
    out: str | Path,
    seed: int = 0,
    progress: Parts = silent_parts,
    config: DemoConfig = SHORT,
    two_processes: bool = False,
) -> DemoResult:
    """Run the tour into the folder `out`; returns what it found after writing `out/index.html`.

    apart: the push and the scoop in a process beside this one, for two cores. Raises BadInput where
    `out` cannot be written or holds runs of other sizes.
    """
    from adaptsim_jax.report.demo_page import write_demo

    out = output_folder(out)
    if two_processes:
        with worker_process(contact_parts, out, seed, config, report=progress) as other:
            first = own_parts(out, seed, config, progress)
            push, scoop = other.result()
    else:
        first = own_parts(out, seed, config, progress)
        push, scoop = contact_parts(out, seed, config, progress)
    pendulum, diagnosis, double = first
    progress("page", 0, 1)
    tour = DemoResult(*pendulum, push, scoop, diagnosis, double, commands(out, seed, config))
    write_demo(tour, out)
    progress("page", 1, 1)
    return tour


def own_parts(
    out: Path, seed: int, config: DemoConfig, progress: Parts
) -> tuple[Pendulum, Diagnosed, Any]:
    """The pendulum and what is diagnosed."""
    report_of = _named(progress)
    pendulum = pendulum_part(out, seed, config, report_of)
    hinge = diagnosed(HINGE, out / "diagnosis", report_of("diagnosis"))
    return (
        pendulum,
        hinge,
        diagnosed(PENDULUM, out / "double", report_of("double")).report if config.double else None,
    )


def diagnosed(data: Path, out: Path, report: Report) -> Diagnosed:
    """Diagnose a sample into the folder `out`."""
    shown: dict[str, Any] = {}

    def page(folder: Path, found: dict[str, Any], evidence: dict[str, Any]) -> None:
        write_diagnosis(folder, found, evidence)
        shown.update(evidence)

    report(0, 1, "reading")
    found = diagnose(data, out=output_folder(out), progress=report, page=page)
    report(1, 1, f"verdict: {found['verdict'].replace('_', ' ')}")
    return Diagnosed(found, list(shown.get("held_out") or [])[:1])


def contact_parts(
    out: Path, seed: int, config: DemoConfig, progress: Parts
) -> tuple[Before, Before]:
    """The push and the scoop."""
    report_of = _named(progress)
    push = contact_part(out, "push", "pushing", seed, config.push, config.films, report_of("push"))
    scoop = contact_part(
        out, "scoop", "scooping", seed, config.scoop, config.films, report_of("scoop")
    )
    return push, scoop


def _named(progress: Parts) -> Callable[[str], Report]:
    def part(name: str) -> Report:
        return lambda done, total, note="": progress(name, done, total, note)

    return part
