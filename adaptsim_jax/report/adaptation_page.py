"""A page that shows an adaptation beside its baselines: one self-contained HTML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.report import comparison_explore, explore
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.templating import filled


def write_adaptation_page(results: Mapping[str, Any], path: Path) -> Path:
    """Write the page for `results` (of `compare`) to `path`, whole or not at all. Raises BadInput
    where it cannot.
    """
    write_bytes(path, render(results).encode())
    return path


def render(results: Mapping[str, Any]) -> str:
    """The page as text."""
    rows = results["rows"]
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    methods = list(dict.fromkeys(r["method"] for r in rows))
    cells = {(r["method"], r["setting"]): _cell(r) for r in rows}
    curves = comparison_explore.rewards(results)
    if "reward" not in results:
        words = _CURVES
    elif "trials_axis" in results:
        words = _DEPLOYED
    else:
        words = _PLAIN_CURVES
    caption = words.format(over=_OVER[look.one_seed(rows)])
    return filled(
        "adaptation.html.j2",
        results=results,
        headline=headline(
            rows,
            "Reward"
            if "reward" in results and "trials_axis" not in results
            else "Normalized reward",
        ),
        scale=_scale(results),
        best="best iteration" if "trials_axis" not in results else "after all target trials",
        over="one seed, no interval" if look.one_seed(rows) else "mean over seeds",
        settings=[(s, look.setting(s)) for s in settings],
        methods=[(m, look.label(m), look.colour(m)) for m in methods],
        cells=cells,
        curves=curves,
        caption=caption,
        script=explore.script(bool(curves)),
    )


_CURVES = (
    "Reward of the best distribution at each iteration: {over}. "
    "0 is one policy for all of Omega (UDR), 1 the best policy whose parameters lie in Omega."
)
_PLAIN_CURVES = (
    "Reward of the best distribution at each iteration (for methods without distributions: at each "
    "of their budgets of "
    "target trials): {over}."
)
_DEPLOYED = "Return of what is deployed after so many target trials: {over}."
_OVER = {
    False: "median over seeds, shaded between the quartiles",
    True: "one seed, nothing to shade",
}
_NORMALISED = (
    "0 is UDR, 1 the best policy of Omega. {beside} AdaptSim spends {starts} target rollouts an "
    "iteration, system identification "
    "one."
)
_BESIDE = {False: "Beside each mean its 95 % interval over seeds.", True: "One seed, no interval."}
_TARGETS = " Targets: WD is within Omega, the box of parameters that may be simulated; OOD are outside of it."


def headline(rows: list[Mapping[str, Any]], what: str = "Normalized reward") -> str:
    """One sentence: how AdaptSim did beside the better SysID baseline, in the settings where both
    ran.
    """
    by = {(r["method"], r["setting"]): r["mean"] for r in rows}
    told = []
    for setting in dict.fromkeys(r["setting"] for r in rows):
        ours = by.get(("adaptsim", setting))
        known = [by.get((m, setting), None) for m in ("sysid_bayes", "sysid_point")]
        known = [v for v in known if v is not None]
        if ours is None:
            continue
        if known:
            beside = f" (system identification {max(known):.2f})"
        else:
            beside = ""
        told.append(f"{look.setting(setting)} {ours:.2f}{beside}")
    if not told:
        return f"{what}s of the methods that ran"
    return f"{what} of AdaptSim: " + ", ".join(told)


def _scale(results: Mapping[str, Any]) -> str:
    beside = _BESIDE[look.one_seed(results["rows"])]
    if any(r["setting"] in look.SETTINGS for r in results["rows"]):
        beside += _TARGETS
    if "reward" in results:
        return f"{look.reward_of(results, long=True)}. {beside}"
    return _NORMALISED.format(beside=beside, starts=results["starts"])


def _cell(r: Mapping[str, Any]) -> dict[str, str]:
    def number(v):
        if v is None:
            return "fails"
        return f"{v:.2f}"

    if r["low"] == r["high"]:
        spread = ""
    else:
        spread = f"{number(r['low'])} to {number(r['high'])}"
    value = "" if r["mean"] is None else f"{r['mean']:.6g}"
    return {
        "mean": number(r["mean"]),
        "value": value,
        "spread": spread,
        "final": number(r["final_mean"]),
    }
