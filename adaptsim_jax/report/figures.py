"""The look that the figures of the comparison share: colours that colour-blind readers tell apart,
labels, saving.
"""

import io
import re
from collections.abc import Iterable
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptsim_jax.core.config import read
from adaptsim_jax.core.files import write_bytes

METHODS = read(Path(__file__).with_name("methods.toml"))
"""Method -> colour and label, in the order in which they are listed."""
MARKERS = {"adaptsim": "o", "sysid_bayes": "s", "sysid_point": "^", "gradient": "D"}
SETTINGS = {"wd": "WD"} | {f"ood-{i}": f"OOD-{i}" for i in range(1, 5)}
INK, MUTED, GRID = "#20262e", "#5d6875", "#dde2e8"
REWARD = "normalized reward (0 UDR, 1 best in Ω)"
ITERATIONS = "iterations"


def reward_of(results, long: bool = False) -> str:
    """What the rewards of `results` are: in the task's own unit, or normalised as the
    pendulum's.
    """
    if "trials_axis" in results and not long:
        return "normalized return (0 UDR, 1 oracle or best in Ω)"
    if "reward" in results:
        if long:
            return f"Reward ({results['reward']}; oracle: {results['oracle']})"
        return "reward"
    if long:
        return "Normalized reward (0 UDR, 1 best in Omega, not clipped)"
    return REWARD


def axis_of(results) -> str:
    """What rewards are drawn over."""
    if "trials_axis" in results:
        return "target trials"
    return ITERATIONS


def lower_limit(results) -> float:
    """Where axes of rewards begin: normalised ones go below 0, a task's own do not."""
    if "reward" in results and "trials_axis" not in results:
        return -0.02
    return -0.4


def finite_or(worst: float, values) -> list[float]:
    """Rewards, `worst` for those of a policy that destabilised the target (None)."""
    return [worst if v is None else v for v in values]


def distinct(rows, key: str) -> list[str]:
    """What stands under `key` in these rows, in the order in which it comes."""
    return list(dict.fromkeys(row[key] for row in rows))


def one_seed(rows) -> bool:
    """Whether no row of a comparison is of more than one seed, so that there is nothing to give an
    interval of.
    """
    return all(len(r["per_seed"]) < 2 for r in rows)


def seeds(count: int) -> str:
    return f"{count} seed" + "s" * (count != 1)


def setting(name: str) -> str:
    return SETTINGS.get(name, name)


def colour(method: str) -> str:
    if method in METHODS:
        return METHODS[method][0]
    return MUTED


def in_order(methods: Iterable[str]) -> list[str]:
    """Ours as they are listed, then those of other packages by name."""
    known = list(METHODS)
    return sorted(methods, key=lambda m: (known.index(m) if m in known else len(known), m))


def label(method: str) -> str:
    if method in METHODS:
        return METHODS[method][1]
    return method


def style(method: str) -> dict:
    """Line style: state-only variants are dashed, and so is the bound that has the oracle's
    colour.
    """
    dashed = method.endswith("_state") or method == "best_in_omega"
    return {"color": colour(method), "linestyle": "--" if dashed else "-"}


def marker(method: str) -> str:
    return MARKERS.get(method.removesuffix("_state"), "o")


def style_axes(ax: Axes) -> None:
    """Light grid, no frame at the top and right, small ticks."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(MUTED)
    ax.grid(True, color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(colors=MUTED, labelcolor=INK, labelsize=8)


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options
) -> tuple[Figure, list[Axes]]:
    """A figure of `width x height` inches without any global state, and its axes in reading
    order.
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(axes.ravel())


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG of 200 dots per inch, whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200, facecolor="white")
    write_bytes(path, buffer.getvalue())
    return path


def svg(figure: Figure) -> str:
    """The figure as an SVG element that shrinks with its place and grows to the figure's own width,
    96 px an inch.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", facecolor="white")
    text = buffer.getvalue()
    width = figure.get_size_inches()[0] * 96
    # wide ones scroll on a phone
    if width > 600:
        min_width = min(width, 640.0)
    else:
        min_width = 0.0
    style = f"width: 100%; height: auto; max-width: {width:.0f}px; min-width: {min_width:.0f}px"
    size = re.compile(
        r'<svg ([^>]*?)\bheight="[^"]*"([^>]*?)\bwidth="[^"]*"|<svg '
        r'([^>]*?)\bwidth="[^"]*"([^>]*?)\bheight="[^"]*"'
    )

    def inner(m):
        return f'<svg style="{style}" ' + " ".join(g for g in m.groups() if g)

    return size.sub(inner, text[text.index("<svg") :], count=1)
