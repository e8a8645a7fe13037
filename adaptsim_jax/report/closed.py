"""What `adaptsim close` shows: returns before and after, as a table and on a page."""

from collections.abc import Mapping

from adaptsim_jax.report.explore import filled
from adaptsim_jax.report.figures import distinct, label


def cells(found: Mapping) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """By target and method `(simulator, return)`: mean over seeds, with the range of them."""
    rows = found["rows"]
    out = []
    for target in distinct(rows, "target"):
        for method in distinct(rows, "method"):
            some = [r for r in rows if r["target"] == target and r["method"] == method]
            out.append((target, label(method), [(r["simulator"], _written(r)) for r in some]))
    return out


def _written(row: Mapping) -> str:
    low, high = min(row["returns"]), max(row["returns"])
    if len(row["returns"]) == 1:
        return f"{row['mean']:.4g}"
    return f"{row['mean']:.4g} ({low:.4g} to {high:.4g})"


def verdicts(found: Mapping) -> list[str]:
    """A sentence by target and method: which simulator's policy returns more, and whether the
    ranges of seeds are apart.
    """
    out = []
    for target in distinct(found["rows"], "target"):
        for method in distinct(found["rows"], "method"):
            both = {
                r["simulator"]: r
                for r in found["rows"]
                if (r["target"], r["method"]) == (target, method)
            }
            if found["found"] and len(both) == 2:
                out.append(f"{target}, {label(method)}: {_compared(**both)}.")
    return out


def _compared(declared: Mapping, mended: Mapping) -> str:
    more = mended["mean"] - declared["mean"]
    low, high = (mended, declared) if more < 0.0 else (declared, mended)
    if len(low["returns"]) == 1:
        sure = "one seed cannot tell this from luck"
    elif max(low["returns"]) < min(high["returns"]):
        sure = "in every seed"
    else:
        sure = "the seeds' ranges overlap"
    word = "more" if more > 0.0 else "LESS"
    return f"the mended simulator's policy returns {abs(more):.3g} {word} ({sure})"


def named(found: Mapping) -> str:
    """What the diagnosis named, and where."""
    return "; ".join(f"{e['physics']}, at {e['where']}" for e in found["diagnosis"]["effects"])


def table(found: Mapping) -> str:
    """For a terminal: what was found, then a line for each target, method and simulator."""
    lines = [named(found) or found["diagnosis"]["message"], ""]
    lines.append(f"returns after at most {found['trials']} target trials, mean over seeds (range):")
    for target, method, each in cells(found):
        shown = ", ".join(f"{simulator} {value}" for simulator, value in each)
        lines.append(f"  {target}, {method}: {shown}")
    lines += verdicts(found)
    if not found["found"]:
        lines.append("Nothing was found, so that both simulators are one.")
    return "\n".join(lines)


def page(found: Mapping) -> str:
    """The page as text."""
    return filled(
        "closed.html.j2",
        found=found,
        cells=cells(found),
        named=named(found),
        verdicts=verdicts(found),
    )
