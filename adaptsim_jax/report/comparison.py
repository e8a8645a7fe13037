"""What `adaptsim compare` leaves in its folder: results.json, table.md and report.html, whose plots
are to be explored.
"""

from collections.abc import Mapping
from pathlib import Path

from adaptsim_jax.core.files import output_folder, write_bytes, write_json
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.adaptation_page import two_digits, write_adaptation_page


def write_comparison(results: Mapping, out: str | Path) -> list[Path]:
    """Write all of it into `out` (made if need be); returns the paths. Raises BadInput where it
    cannot be written.
    """
    out = output_folder(Path(out))
    write_json(out / "results.json", results)
    write_bytes(out / "table.md", table(results).encode())
    page = write_adaptation_page(results, out / "report.html")
    return [out / "results.json", out / "table.md", page]


def table(results: Mapping) -> str:
    """Table 1 in Markdown: for each method and setting the mean over seeds of the best iteration,
    and what else counts.
    """
    rows = results["rows"]
    settings = look.distinct(rows, "setting")
    methods = look.distinct(rows, "method")
    cells = {(r["method"], r["setting"]): r for r in rows}
    head = [look.setting(s) for s in settings]

    def across(cell):
        return _grid(head, methods, cell, settings, cells)

    by_trials = _by_trials(results, across) if "trials_axis" in results else None
    parts = [
        f"{look.reward_of(results, long=True)}, {look.seeds(results['seeds'])}, "
        f"{results['iterations']} iterations, {results['starts']} initial distributions.",
        *(by_trials or (_of_one(across) if look.one_seed(rows) else _over_seeds(across))),
        *_fresh(rows, across),
        *_discrepancies(rows, across),
        *_failures(rows),
        f"Target rollouts for one target: {_trials(rows, methods)}.",
    ]
    if results["command"]:
        parts.append(f"Command: `{results['command']}`")
    return "\n\n".join(parts) + "\n"


def _over_seeds(across) -> list[str]:
    return [
        "Mean over seeds of the best iteration [95 % interval of the mean]:",
        across(lambda r: _spread(r, "mean", "low", "high")),
        "Median [quartiles] of the best iteration:",
        across(lambda r: _spread(r, "median", "q25", "q75")),
        "Mean over seeds at the last iteration, and in brackets the best mean of any one "
        "iteration:",
        across(lambda r: f"{two_digits(r['final_mean'])} ({two_digits(r['best_iteration_mean'])})"),
    ]


def _by_trials(results: Mapping, across) -> list[str]:
    """What is deployed at last, in each target, and in each target what was deployed after fewer
    trials.
    """
    rows, one = results["rows"], look.one_seed(results["rows"])
    spent = max(r["trials"][-1] for r in rows)  # of more trials nothing is known
    budgets = [b for b in rows[0]["at"] if int(b) <= spent]
    note = " (one seed, no interval)" if one else ", mean over seeds [95 % interval]"
    parts = [
        f"What is deployed after all trials{note}:",
        across(lambda r: two_digits(r["mean"]) if one else _spread(r, "mean", "low", "high")),
        "The return itself, mean over seeds:" if not one else "The return itself:",
        across(_returns),
    ]
    for setting in look.distinct(rows, "setting"):
        mine = [r for r in rows if r["setting"] == setting]

        def cell(at):
            if at is None:
                return ""
            return two_digits(at["mean"])

        cells = {(r["method"], b): cell(r["at"][b]) for r in mine for b in budgets}
        methods = [r["method"] for r in mine]
        parts += [
            f"{look.setting(setting)}, by target trials{'' if one else ' (mean over seeds)'}:",
            _grid(budgets, methods, lambda text: text, budgets, cells),
        ]
    return parts


def _of_one(across) -> list[str]:
    return [
        "Best iteration (one seed, no interval):",
        across(lambda r: two_digits(r["mean"])),
        "Last iteration (one seed):",
        across(lambda r: two_digits(r["final_mean"])),
    ]


def _spread(r: Mapping, *keys: str) -> str:
    """The number and what it is within; of one seed among rows of several, the number alone."""
    middle, low, high = (two_digits(r[key]) for key in keys)
    if look.one_seed([r]):
        return f"{middle} (one seed)"
    return f"{middle} [{low}, {high}]"


def _grid(head, methods, cell, settings, cells) -> str:
    lines = ["| method | " + " | ".join(head) + " |", "| --- |" + " --- |" * len(head)]
    for m in methods:
        texts = [cell(cells[m, s]) if (m, s) in cells else "-" for s in settings]
        if any(t != "-" for t in texts):
            lines.append(f"| {look.label(m)} | " + " | ".join(texts) + " |")
    return "\n".join(lines)


def _trials(rows, methods) -> str:
    counts = {m: next(r["target_trials"] for r in rows if r["method"] == m) for m in methods}
    return ", ".join(f"{look.label(m)} {n}" for m, n in counts.items() if n is not None)


def _returns(r: Mapping) -> str:
    values = r["returns"]
    if None in values:
        return "fails"
    return f"{sum(values) / len(values):.4g}"


def _discrepancies(rows, across) -> list[str]:
    if not any("discrepancy" in r for r in rows):
        return []
    return [
        "Dynamics discrepancy at the best policy (rad, absolute differences of both joints "
        "summed over the 12 observed points; median over seeds):",
        across(_discrepancy),
    ]


def _fresh(rows, across) -> list[str]:
    """What policies earn in contexts that did not choose them; nothing where there are none."""
    if not any("fresh" in r for r in rows):
        return []

    def best(r):
        if "fresh" not in r:
            return "-"
        mean, low, high = (two_digits(r["fresh"][key]) for key in ("mean", "low", "high"))
        if look.one_seed([r]):
            return mean
        return f"{mean} [{low}, {high}]"

    return [
        "The policies of the best iteration in fresh contexts, by which none was chosen [95 % "
        "interval of the mean over seeds]:",
        across(best),
        "Those of the last iteration, of all starts, in fresh contexts:",
        across(lambda r: two_digits(r["fresh"]["final_mean"]) if "fresh" in r else "-"),
    ]


def _failures(rows) -> list[str]:
    """How many trials failed, of those made, the scored ones included; nothing where that is not
    counted.
    """
    counted = [r for r in rows if "made" in r]
    failed, made = (sum(r[key] for r in counted) for key in ("failed", "made"))
    if made:
        return [f"Trials that failed (reward 0): {failed} of {made}."]
    return []


def _discrepancy(r: Mapping) -> str:
    if "discrepancy" in r:
        return two_digits(r["discrepancy"]["median"])
    return "-"
