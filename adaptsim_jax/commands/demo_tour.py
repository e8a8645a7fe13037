"""The tour of `adaptsim demo`: a pendulum adapted beside baselines, a push and a scoop before and after, a recording diagnosed, one
page.

Small sizes of the real thing: nothing here computes what the other commands do not. A tour that was stopped is taken up
again by the same call, from the checkpoints of its runs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from adaptsim_jax.commands.demo_config import SHORT, DemoConfig, commands
from adaptsim_jax.commands.demo_contact import Before, push_part, scoop_part
from adaptsim_jax.commands.demo_diagnosis import Diagnosed, double_part, hinge_part
from adaptsim_jax.commands.demo_pendulum import Adapted, pendulum_part
from adaptsim_jax.core.beside import beside
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Report
from adaptsim_jax.core.progress_parts import Parts, silent


class Rest(NamedTuple):
    """What the tour found beside the pendulum; double: the report on the second sample, where it was asked for."""

    push: Before
    scoop: Before
    diagnosis: Diagnosed
    double: dict[str, Any] | None


class Tour(NamedTuple):
    """What the tour found: adapted pendulum runs, the comparison (as results.json), the reward map, and all the rest."""

    adapted: list[Adapted]
    results: dict[str, Any]
    reward_map: Any
    rest: Rest
    commands: dict[str, str]


def demo(
    out: str | Path, seed: int = 0, progress: Parts = silent, config: DemoConfig = SHORT, apart: bool = False
) -> Tour:
    """Run the tour into the folder `out`; returns what it found after writing `out/index.html`.

    apart: the pendulum in this process, all else in one beside it, for two cores. Raises BadInput where `out` cannot be written or
    holds runs of other sizes.
    """
    from adaptsim_jax.report.demo_page import write_demo

    out = output_folder(out)
    say = _parts(progress)
    if apart:
        with beside(rest_of_tour, out, seed, config, told=progress) as other:
            pendulum = pendulum_part(out, seed, config, say)
            rest = other.result()
    else:
        pendulum = pendulum_part(out, seed, config, say)
        rest = rest_of_tour(out, seed, config, progress)
    progress("page", 0, 1)
    tour = Tour(*pendulum, rest, commands(out, seed, config))
    write_demo(tour, out)
    progress("page", 1, 1)
    return tour


def rest_of_tour(out: Path, seed: int, config: DemoConfig, progress: Parts) -> Rest:
    """Push, scoop and diagnosis, one after the other."""
    say = _parts(progress)
    push = push_part(out, seed, config.push, config.films, say("push"))
    scoop = scoop_part(out, seed, config.scoop, config.films, say("scoop"))
    diagnosis = hinge_part(out, say("diagnosis"))
    return Rest(push, scoop, diagnosis, double_part(out, seed, say("double")) if config.double else None)


def _parts(progress: Parts) -> Callable[[str], Report]:
    def part(name: str) -> Report:
        return lambda done, total, note="": progress(name, done, total, note)

    return part
