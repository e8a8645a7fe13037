"""Power of `diagnose` against the size of what is hidden: a figure and a table of the power suite's finished cases.

    for seed in 17400 17402 17404; do
        python -m experiments.closeloop_suites --suite power --count 13 --seed $seed --out DIR
    done
    python -m experiments.closeloop_power DIR --figure docs/results/figures/closeloop_power.png

Each seed is one rig with one effect at thirteen sizes, in multiples of the size that just matters. The figure: the share named rightly
with its 95 % Wilson interval, and below it what was said of each recording.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path

from matplotlib.figure import Figure

from adaptsim_jax.report.figures import GRID, INK, MUTED, save
from experiments.closeloop_scores import NOTHING, share
from tests.generators.suites import POWER_MULTIPLES

SAID = {  # what was said of a recording: marker and colour
    "right": ("o", "#0072B2"),
    "right, another beside it": ("D", "#56B4E9"),
    "refused": ("s", "#E69F00"),
    "nothing found": (".", MUTED),
    "wrong name": ("X", "#D55E00"),
}


def said(record: dict) -> str:
    """One of `SAID`. An effect that the declared parameters absorb is right where nothing is named."""
    if record["hits"][0]:
        return "right, another beside it" if record["wrong"] else "right"
    if record["wrong"]:
        return "wrong name"
    return "nothing found" if record["verdict"] in NOTHING else "refused"


def size_of(record: dict) -> float:
    """The size aimed at, in multiples of what just matters (from the case's name)."""
    return float(record["name"].rsplit("_", 1)[1])


def sizes(records: list[dict]) -> list[float]:
    """The sizes that were run."""
    return [m for m in POWER_MULTIPLES if any(size_of(r) == m for r in records)]


def table(records: list[dict]) -> str:
    """What was said, by size."""
    lines = [f"| times what just matters | {' | '.join(SAID)} | named rightly (Wilson 95 %) |"]
    lines.append("| --- " * (len(SAID) + 2) + "|")
    for size in sizes(records):
        rs = [r for r in records if size_of(r) == size]
        right = share(rs, lambda r: said(r) == "right")
        counts = " | ".join(str(sum(said(r) == kind for r in rs)) for kind in SAID)
        low, high = 100 * right["low"], 100 * right["high"]
        lines.append(f"| {size:g} | {counts} | {right['hits']}/{right['of']} ({low:.0f}-{high:.0f} %) |")
    return "\n".join(lines) + "\n"


def figure(records: list[dict]) -> Figure:
    """The curve above, the recordings below it, a row for each effect and joint."""
    rows: dict[str, list[dict]] = defaultdict(list)
    for r in records:
        rows["{} {}".format(*r["hidden"][0]).replace("_", " ")].append(r)
    fig = Figure(figsize=(7.5, 3.0 + 0.24 * len(rows)), layout="constrained")
    curve, grid = fig.subplots(2, 1, sharex=True, height_ratios=(2.2, 0.24 * len(rows)))
    run = sizes(records)
    at = range(len(run))
    shares = [share([r for r in records if size_of(r) == m], lambda r: said(r) == "right") for m in run]
    curve.fill_between(at, [s["low"] for s in shares], [s["high"] for s in shares], color="#0072B2", alpha=0.18, lw=0)
    curve.plot(at, [s["share"] for s in shares], color="#0072B2", marker="o")
    curve.set(ylim=(0, 1.02), ylabel="named rightly")
    curve.set_title(f"What is named, by size ({len(rows)} rigs, 95 % interval)", loc="left", fontsize=10, color=INK)
    for y, of in enumerate(rows.values()):
        for r in of:
            marker, colour = SAID[said(r)]
            grid.plot(run.index(size_of(r)), y, marker, color=colour, ms=7, ls="none")
    grid.set_yticks(range(len(rows)), list(rows), fontsize=8)
    grid.invert_yaxis()
    grid.set_xticks(at, [f"{m:g}" for m in run])
    grid.set_xlabel("size, in multiples of what just matters")
    for kind, (marker, colour) in SAID.items():
        grid.plot([], [], marker, color=colour, ls="none", ms=7, label=kind)
    fig.legend(
        *grid.get_legend_handles_labels(), loc="outside lower center", ncols=len(SAID), fontsize=8, frameon=False
    )
    for ax in (curve, grid):
        ax.grid(color=GRID, lw=0.7)
        ax.spines[["top", "right"]].set_visible(False)
    return fig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="DIR", help="the folder of the power suite")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    args = parser.parse_args()
    files = sorted((args.out / "cases").glob("power_*.json"))
    if not files:
        parser.error(f"{args.out}/cases has no finished case of the power suite")
    records = [json.loads(f.read_text()) for f in files]
    print(table(records))
    if args.figure:
        save(figure(records), args.figure)


if __name__ == "__main__":
    main()
