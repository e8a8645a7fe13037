"""The page of `adaptsim demo`: what was trained, how it adapted, what was measured, and where
everything lies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import output_folder, write_bytes
from adaptsim_jax.report import comparison, explore
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words
from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw
from adaptsim_jax.report.adaptation_page import rewards
from adaptsim_jax.report.explore import filled

# ---------------------------------------------------------------- figures
#
# The figures of the tour: what learning earned, and where methods ended.

SHADES = ("#0072B2", "#56B4E9", "#004d7a")
CURVES = ("adaptsim", "sysid_bayes", "sysid_point")


def learning_curves(metrics: Sequence[Sequence[Mapping]]) -> Figure:
    """Mean reward that is learned from, a line for each run's `metrics.jsonl`.

    It lies in [0, 1]. The task's own reward has no lower end, and a few hopeless starts would hide
    all the rest.
    """
    figure, (ax,) = look.new_figure(4.6, 2.9)
    for i, rows in enumerate(metrics):
        steps = [row["adaptation_steps"] / 1000 for row in rows]
        ax.plot(
            steps, [row["shaped"] for row in rows], color=SHADES[i % len(SHADES)], linewidth=1.5
        )
    look.style_axes(ax)
    ax.set_ylim(0, 1)
    ax.set_xlabel("adaptation steps in simulation (thousands)", fontsize=9)
    ax.set_ylabel("mean reward while learning", fontsize=9)
    return figure


def reward_map(chart: Any, target: Sequence[float], rows: Sequence[Mapping]) -> Figure:
    """The paper's figure 5: the best policy's parameters of each seed on the map of what could be
    earned.
    """
    params_of = {
        row["method"]: np.array(row["best_params"])[:, :2]
        for row in rows
        if row["method"] in CURVES
    }
    figure = draw.parameter_map(chart, target, params_of)
    figure.set_size_inches(4.6, 3.9)
    return figure


INK = {"adaptsim": "after", "sysid_bayes": "before", "sysid_point": "floor"}


def write_demo(tour: Any, out: Path) -> None:
    """Write `figures/*.png`, `comparison/table.md` and, last of all, `index.html` into `out`; see
    `demo_tour.DemoResult`.
    """
    pictures = drawn(tour)
    folder = output_folder(out / "figures")
    for name, figure in pictures.items():
        look.save(figure, folder / f"{name}.png")
    write_bytes(out / "comparison" / "table.md", comparison.table(tour.results).encode())
    page = render(tour, {name: look.svg(figure) for name, figure in pictures.items()}, out)
    write_bytes(out / "index.html", page.encode())


def drawn(tour: Any) -> Table:
    """The figures by name."""
    task = tour.adapted[0].trained.phase1.task
    target = np.asarray(task.space.values(task.settings[setting_of(tour)], setting_of(tour)))
    return {
        "learning": learning_curves([one.folder.read_metrics() for one in tour.adapted]),
        "map": reward_map(tour.reward_map, target[:2].tolist(), tour.results["rows"]),
        "push": tour.push.figure,
        "scoop": tour.scoop.figure,
    }


def setting_of(tour: Any) -> str:
    """The setting that the tour adapts to."""
    return tour.results["rows"][0]["setting"]


def render(tour: Any, pictures: Mapping[str, str], out: Path) -> str:
    """The page as text, to lie in `out`; `pictures` are SVG elements by name."""
    phase1 = tour.adapted[0].trained.phase1
    return filled(
        "demo.html.j2",
        setting=look.SETTINGS[setting_of(tour)],
        seeds=len(tour.adapted),
        sizes=phase1.config,
        steps=f"{phase1.config.trajectories * phase1.config.horizon:,}",
        parameters=parameter_rows(tour),
        rows=method_rows(tour.results),
        pictures=pictures,
        curves=rewards(tour.results),
        script=explore.script(),
        results=tour.results,
        push=contact_words(tour.push, out),
        scoop=contact_words(tour.scoop, out),
        diagnosis=diagnosis_words(tour.diagnosis),
        double=None if tour.double is None else diagnosis_words(tour.double),
        full=tour.double is not None,
        commands=tour.commands,
        versions=tour.results["versions"],
    )


def contact_words(contact: Any, out: Path) -> Table:
    """The push or the scoop: rewards before and after, trials spent, target and what was found, and
    the film's place.
    """
    params, target = contact.found["best"]["params"], contact.found["target"]["params"]
    return {
        "setting": look.setting(contact.found["target"]["name"]),
        "before": _reward(contact.before),
        "after": _reward(contact.after),
        "better": contact.after > contact.before,
        "trials": contact.trials,
        "learned": f"{contact.learned:,}",
        "start": contact.start + 1,
        "parameters": [(name, f"{target[name]:.3g}", f"{params[name]:.3g}") for name in params],
        "ends": contact.ends,
        "film": None if contact.film is None else str(contact.film.relative_to(out)),
    }


def parameter_rows(tour: Any) -> list[Table]:
    """Omega, the target, and what the first run's best policy was trained at."""
    first_run = tour.adapted[0]
    space = first_run.trained.phase1.task.space
    target = tour.results["settings"][setting_of(tour)]["params"]
    physical = np.asarray(space.physical(first_run.result.mean))
    return [
        {
            "name": p.name,
            "what": p.description,
            "range": f"{p.low:g} to {p.high:g} {fmt.unit_name(p.unit)}",
            "target": f"{target[i]:g}",
            "outside": not p.low <= target[i] <= p.high,
            "found": f"{physical[i]:.2f}",
        }
        for i, p in enumerate(space.parameters)
    ]


def method_rows(results: Mapping) -> list[Table]:
    """The comparison table, a row a method."""
    return [
        {
            "method": row["method"],
            "name": look.label(row["method"]).replace("\n", " "),
            "ink": INK.get(row["method"], "ink"),
            "best": _reward(row["mean"]),
            "seeds": ", ".join(_reward(value) for value in row["per_seed"]),
            "bound": row["method"] in ("udr", "best_in_omega"),
            "final": _reward(row["final_mean"]),
            "trials": fmt.DASH if row["target_trials"] is None else str(row["target_trials"]),
            "apart": f"{row['discrepancy']['median']:.2f}" if "discrepancy" in row else fmt.DASH,
        }
        for row in results["rows"]
    ]


def _reward(value: float | None) -> str:
    if value is None:
        return "fails"
    return fmt.fixed(value, 2)


def diagnosis_words(report: Mapping) -> Table:
    """The diagnosis in a few words: verdict, headline, message, error before and after."""
    error = report["error"]
    mended = bool(report["effects"])
    after = error["after"] if mended else None
    return {
        "verdict": words.VERDICTS[report["verdict"]],
        "headline": words.headline(report),
        "message": report["message"],
        "metric": error["metric"],
        "before": fmt.quantity(error["before"], error["unit"]),
        "after": None if after is None else fmt.quantity(after, error["unit"]),
        "floor": fmt.quantity(error["noise_floor"], error["unit"]),
        "change": words.improvement(error)["change"] if mended else None,
    }


def summary(tour: Any, out: Path) -> list[tuple[str, str]]:
    """`(what, words)` for the terminal: results first, then where things lie."""
    rows = {row["method"]: row for row in tour.results["rows"]}
    texts = diagnosis_words(tour.diagnosis)
    if texts["after"] is None:
        error = texts["before"]
    else:
        error = f"{texts['before']} -> {texts['after']}"
    rewards = [
        f"{look.label(name)} {_reward(rows[name]['mean'])}" for name in CURVES if name in rows
    ]

    def changed(contact):
        return (
            f"reward {_reward(contact.before)} before adaptation, "
            f"{_reward(contact.after)} after, of 1"
        )

    return [
        (
            f"pendulum in {look.SETTINGS[setting_of(tour)]}",
            f"reward {', '.join(rewards)} (0: UDR, 1: best in Omega)",
        ),
        ("push", changed(tour.push)),
        ("scoop", changed(tour.scoop)),
        ("diagnosed", f"{texts['headline']} Error on left-out trials {error}"),
        ("all on one page", str(out / "index.html")),
        ("trained runs", str(out / "runs")),
        ("diagnosis", str(out / "diagnosis" / "report.html")),
        ("numbers", f"{out / 'comparison' / 'results.json'}, {out / 'diagnosis' / 'report.json'}"),
        ("mended model", str(out / "diagnosis" / "model.xml")),
    ]
