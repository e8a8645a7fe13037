"""What `adaptsim close` shows: returns before and after, as a table and on a page."""

from collections.abc import Mapping

from adaptsim_jax.report.explore import filled
from adaptsim_jax.report.figures import distinct, label


def cells(results: Mapping) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Collect by target and method `(simulator, return)`: mean over seeds, with the range of
    them.
    """
    rows = results["rows"]
    out = []
    for target in distinct(rows, "target"):
        for method in distinct(rows, "method"):
            matching = [r for r in rows if r["target"] == target and r["method"] == method]
            out.append(
                (target, label(method), [(r["simulator"], _return_text(r)) for r in matching])
            )
    return out


def _return_text(row: Mapping) -> str:
    low, high = min(row["returns"]), max(row["returns"])
    if len(row["returns"]) == 1:
        return f"{row['mean']:.4g}"
    return f"{row['mean']:.4g} ({low:.4g} to {high:.4g})"


def verdicts(results: Mapping) -> list[str]:
    """A sentence by target and method: which simulator's policy returns more, and whether the
    ranges of seeds are apart.
    """
    out = []
    for target in distinct(results["rows"], "target"):
        for method in distinct(results["rows"], "method"):
            by_simulator = {
                r["simulator"]: r
                for r in results["rows"]
                if (r["target"], r["method"]) == (target, method)
            }
            if results["found"] and len(by_simulator) == 2:
                out.append(f"{target}, {label(method)}: {_comparison(**by_simulator)}.")
    return out


def _comparison(declared: Mapping, mended: Mapping) -> str:
    gain = mended["mean"] - declared["mean"]
    low, high = (mended, declared) if gain < 0.0 else (declared, mended)
    if len(low["returns"]) == 1:
        confidence = "one seed cannot tell this from luck"
    elif max(low["returns"]) < min(high["returns"]):
        confidence = "in every seed"
    else:
        confidence = "the seeds' ranges overlap"
    word = "more" if gain > 0.0 else "LESS"
    return f"the mended simulator's policy returns {abs(gain):.3g} {word} ({confidence})"


def named(results: Mapping) -> str:
    """What the diagnosis named, and where."""
    return "; ".join(f"{e['physics']}, at {e['where']}" for e in results["diagnosis"]["effects"])


def table(results: Mapping) -> str:
    """For a terminal: what was found, then a line for each target, method and simulator."""
    lines = [named(results) or results["diagnosis"]["message"], ""]
    lines.append(
        f"returns after at most {results['trials']} target trials, mean over seeds (range):"
    )
    for target, method, values in cells(results):
        shown = ", ".join(f"{simulator} {value}" for simulator, value in values)
        lines.append(f"  {target}, {method}: {shown}")
    lines += verdicts(results)
    if not results["found"]:
        lines.append("Nothing was found, so that both simulators are one.")
    return "\n".join(lines)


def page(results: Mapping) -> str:
    """The page as text."""
    return filled(
        "closed.html.j2",
        found=results,
        cells=cells(results),
        named=named(results),
        verdicts=verdicts(results),
    )
