"""What was said of recordings that hide one effect, by what they hide: a figure and its counts, from the table of all cases.

    python -m experiments.closeloop_confusion docs/results/closeloop_cases.csv --figure docs/results/figures/closeloop_confusion.png

Rows are hidden effects, both joints together. On the diagonal: the right name at the right joint, or a class that holds it. Beside
it: the wrong names that were given (a right name's wrong companion counts in both), refusals, and nothing found.
"""

import argparse
import csv
from collections import Counter
from pathlib import Path

from matplotlib.figure import Figure

from adaptsim_jax.report.figures import INK, MUTED, save
from experiments.closeloop_scores import NOTHING

REFUSED, UNSEEN = "refused", "nothing found"


def said(row: dict[str, str]) -> list[str]:
    """The columns that a recording counts in."""
    hidden, where = row["hidden"].split("@")
    classes = [part.split("|") for part in row["said"].split(" + ") if part]
    wrong = [names[0] for names in classes if row["hidden"] not in names]
    columns = [hidden] if int(row["right"]) else []
    if not int(row["right"]) and not wrong:
        columns = [UNSEEN if row["verdict"] in NOTHING else REFUSED]
    if int(row["wrong"]):
        columns += [n.split("@")[0] if n.split("@")[0] != hidden else f"{hidden}, not at {where}" for n in wrong]
    return columns


def counted(path: Path) -> tuple[list[str], list[str], Counter]:
    """Hidden effects, what was said, and how often, of the single suites' cases as they are."""
    with path.open() as file:
        rows = [r for r in csv.DictReader(file) if r["case"].startswith("single_") and not r["variant"]]
    pairs = Counter((r["hidden"].split("@")[0], column) for r in rows for column in said(r))
    hidden = sorted({r["hidden"].split("@")[0] for r in rows})
    others = sorted({column for _, column in pairs} - set(hidden) - {REFUSED, UNSEEN})
    return hidden, [*hidden, *others, REFUSED, UNSEEN], pairs


def figure(hidden: list[str], columns: list[str], pairs: Counter) -> Figure:
    fig = Figure(figsize=(1.6 + 0.42 * len(columns), 1.8 + 0.34 * len(hidden)), layout="constrained")
    ax = fig.subplots()
    totals = {h: sum(n for (row, _), n in pairs.items() if row == h) for h in hidden}
    ax.imshow([[pairs[h, c] / totals[h] for c in columns] for h in hidden], cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for y, h in enumerate(hidden):
        for x, c in enumerate(columns):
            if n := pairs[h, c]:
                dark = n / totals[h] > 0.5
                ax.text(x, y, str(n), ha="center", va="center", fontsize=8, color="white" if dark else INK)
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(hidden)), [h.replace("_", " ") for h in hidden], fontsize=8)
    ax.set_xlabel("said", color=INK)
    ax.set_ylabel("hidden", color=INK)
    ax.axvline(len(columns) - 2.5, color=MUTED, lw=0.8)
    ax.set_title("One hidden effect: what was said of it", loc="left", fontsize=10, color=INK)
    return fig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, metavar="CSV", help="the table of cases")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    args = parser.parse_args()
    hidden, columns, pairs = counted(args.cases)
    print("| hidden | said |\n| --- | --- |")
    for h in hidden:
        told = [(c, pairs[h, c]) for c in columns if pairs[h, c]]
        print(f"| {h} | {', '.join(f'{c} {n}' for c, n in sorted(told, key=lambda t: -t[1]))} |")
    right = sum(pairs[h, h] for h in hidden)
    print(f"\n{right} of {sum(pairs.values())} on the diagonal")
    if args.figure:
        save(figure(hidden, columns, pairs), args.figure)


if __name__ == "__main__":
    main()
