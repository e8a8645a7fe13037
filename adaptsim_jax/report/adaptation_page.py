"""A page that shows an adaptation beside its baselines: one self-contained HTML file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.report import explore
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import (
    Plot,
    View,
    axis,
    band,
    dots,
    explorer,
    figure,
    filled,
    line,
    numbers,
    shown,
)


def write_adaptation_page(results: Mapping, path: Path) -> Path:
    """Write the page for `results` (of `compare`) to `path`, whole or not at all. Raises BadInput
    where it cannot.
    """
    write_bytes(path, render(results).encode())
    return path


def render(results: Mapping) -> str:
    """The page as text."""
    rows = results["rows"]
    settings = look.distinct(rows, "setting")
    methods = look.distinct(rows, "method")
    cells = {(r["method"], r["setting"]): _cell(r) for r in rows}
    curves = rewards(results)
    if "reward" not in results:
        words = _CURVES
    elif "trials_axis" in results:
        words = _DEPLOYED
    else:
        words = _PLAIN_CURVES
    caption = words.format(over=_OVER[look.one_seed(rows)])
    returned = "reward" in results and "trials_axis" not in results
    return filled(
        "adaptation.html.j2",
        results=results,
        headline=headline(rows, "Reward" if returned else "Normalized reward"),
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
_INTERVAL = {
    False: "Beside each mean its 95 % interval over seeds.",
    True: "One seed, no interval.",
}
_TARGETS = (
    " Targets: WD is within Omega, the box of parameters that may be simulated; OOD are outside "
    "of it."
)


def headline(rows: list[Mapping], what: str = "Normalized reward") -> str:
    """One sentence: how AdaptSim did beside the better SysID baseline, in the settings where both
    ran.
    """
    by = {(r["method"], r["setting"]): r["mean"] for r in rows}
    parts = []
    for setting in look.distinct(rows, "setting"):
        ours = by.get(("adaptsim", setting))
        known = [by.get((m, setting), None) for m in ("sysid_bayes", "sysid_point")]
        known = [v for v in known if v is not None]
        if ours is None:
            continue
        if known:
            note = f" (system identification {max(known):.2f})"
        else:
            note = ""
        parts.append(f"{look.setting(setting)} {ours:.2f}{note}")
    if not parts:
        return f"{what}s of the methods that ran"
    return f"{what} of AdaptSim: " + ", ".join(parts)


def _scale(results: Mapping) -> str:
    note = _INTERVAL[look.one_seed(results["rows"])]
    if any(r["setting"] in look.SETTINGS for r in results["rows"]):
        note += _TARGETS
    if "reward" in results:
        return f"{look.reward_of(results, long=True)}. {note}"
    return _NORMALISED.format(beside=note, starts=results["starts"])


def two_digits(reward: float | None) -> str:
    """Write a reward, None for one of a policy that destabilised the target."""
    if reward is None:
        return "fails"
    return f"{reward:.2f}"


def _cell(r: Mapping) -> dict[str, str]:
    if r["low"] == r["high"]:
        spread = ""
    else:
        spread = f"{two_digits(r['low'])} to {two_digits(r['high'])}"
    value = "" if r["mean"] is None else f"{r['mean']:.6g}"
    return {
        "mean": two_digits(r["mean"]),
        "value": value,
        "spread": spread,
        "final": two_digits(r["final_mean"]),
    }


# ---------------------------------------------------------------- plots to explore, setting by
# setting


def rewards(results: Mapping) -> str:
    """Two plots for each setting, of the rows that have a curve over iterations; empty where none
    has.
    """
    rows = [r for r in results["rows"] if len(r["curve"]["median"]) > 1]
    settings = look.distinct(rows, "setting")
    bottom, what, over = look.lower_limit(results), look.reward_of(results), look.axis_of(results)
    views = {}
    for i, name in enumerate(settings):
        mine = [r for r in results["rows"] if r["setting"] == name]
        curved = [r for r in rows if r["setting"] == name]
        figures = [_curves(curved, bottom, what, over), _seeds(mine, bottom, over)]
        views[(i,)] = View(figures)
    height = 380 + 10 * max(0, len({r["method"] for r in rows}) - 5)  # more names in the legend
    plots = [
        Plot(f"reward over {over}", height),
        Plot("best reward of each seed, by method", height),
    ]
    if rows:
        return explorer({"setting": [look.setting(s) for s in settings]}, views, plots)
    return ""


def _curves(rows: Sequence[Mapping], bottom: float, what: str, over: str) -> Table:
    """Median over seeds with its quartiles, a line a method. No value is drawn where the policy
    destabilised the target.
    """
    data: list[Table] = []
    most = 0
    for r in rows:
        name, style = shown(look.label(r["method"])), look.style(r["method"])
        curve = r["curve"]
        x = r["trials"] if over != look.ITERATIONS else list(range(len(curve["median"])))
        most = max(most, x[-1])
        if len(r["per_seed"]) > 1:
            low, high = (look.finite_or(bottom - 10, curve[key]) for key in ("q25", "q75"))
            data += band(name, x, numbers(low), numbers(high), f"{style['color']}/18")
        dash = "dash" if style["linestyle"] == "--" else "solid"
        pen = {"color": style["color"], "width": 2.2, "dash": dash}
        middle = [None if v is None else round(v, 4) for v in curve["median"]]
        data.append(line(name, x, middle, pen, legendgroup=name, hovertemplate="%{y:.3f}"))
    ticks = {"dtick": 1} if most < 8 else {"nticks": 8}
    rewards = axis(what.replace(" (", "<br>("), range=[bottom, 1.08])
    across = axis(over, tickformat="d", **ticks)
    return figure(data, across, rewards, f"over {over}", hovermode="x unified")


def _seeds(rows: Sequence[Mapping], bottom: float, over: str) -> Table:
    """Best iteration, or what is deployed at last: every seed as a dot, and the mean with its 95 %
    interval where there are seeds to take one over.
    """
    data: list[Table] = []
    names = [shown(look.label(r["method"])) for r in rows]
    for r, name in zip(rows, names, strict=True):
        seeds = [(i, v) for i, v in enumerate(r["per_seed"]) if v is not None]
        values = [round(v, 4) for _, v in seeds]
        marker = {"color": look.colour(r["method"]), "size": 7, "opacity": 0.45}
        texts = {"text": [f"seed {i}" for i, _ in seeds], "hovertemplate": "%{x:.3f}, %{text}"}
        data.append(dots(name, values, [name] * len(seeds), marker, **texts))
        if r["mean"] is not None and len(r["per_seed"]) > 1:
            data.append(_mean(r, name))
    found = [v for r in rows for v in r["per_seed"] if v is not None]
    limits = {"range": [bottom, 1.08]} if found and min(found) < bottom else {}
    if over == look.ITERATIONS:
        best = "best-iteration reward"
    else:
        best = "normalized return of what is deployed at last"
    order = {"categoryorder": "array", "categoryarray": names[::-1]}
    methods = order | {"range": [-0.6, len(names) - 0.4]}
    title = "one seed" if look.one_seed(rows) else "every seed, and the mean"
    return figure(data, axis(best, **limits), methods, title)


def _mean(r: Mapping, name: str) -> Table:
    """The mean over seeds, with its interval where it has one."""
    colour, mean, interval = look.colour(r["method"]), r["mean"], {}
    if r["low"] is not None and r["high"] is not None:
        ends = {"array": [round(r["high"] - mean, 4)], "arrayminus": [round(mean - r["low"], 4)]}
        look_of = {"type": "data", "symmetric": False, "color": colour, "thickness": 2.2}
        interval = {"error_x": ends | look_of}
    marker = {"color": colour, "size": 10, "symbol": "diamond"}
    return dots(name, [round(mean, 4)], [name], marker, hovertemplate="%{x:.3f}, mean", **interval)
