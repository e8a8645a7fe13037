"""The scoop on film, and its figures: spatula and piece from the side.

What is shown are the poses of the hydroelastic engine; MuJoCo lends its camera only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.report.film import Moment, Scene, Stage, camera, captioned, light
from adaptsim_jax.tasks.scooping import model

FRAMES = 50  # of a trial, at 20 a second: 0.4 times real time
BACK, AHEAD, DOWN, UP = 0.125, 0.075, -0.0125, 0.1  # m of the view around the tip, 16 by 9
FOOD, STEEL, TABLE = "#0072B2", "#b5512f", "#a89f8f"
SIZE = (640, 360)  # pixels
ITERATION = (0.35, 0.5, 1.0)  # s, that a figure shows of an iteration's trial
STRIP = (0.1, 0.3, 0.4, 0.5, 0.7, 1.0)  # s, of a film strip


@dataclass(frozen=True)
class ScoopClip:
    """One trial: `piece [T, 3]` and `tip [T, 3]`, each x, z m and angle rad (nose down), over
    `model.SECONDS`; `params [4]`. Whether the piece lay on the spatula at the end. A line of text.
    """

    piece: Any
    tip: Any
    params: Any
    success: bool
    text: str


def moments(clip: ScoopClip) -> list[Moment]:
    """Evenly over the trial; the last says how it ended."""
    last = len(clip.piece) - 1
    rows = np.round(np.linspace(0, last, FRAMES)).astype(int)
    return [Moment(int(r), model.SECONDS * r / last, verdict(clip, r)) for r in rows]


def verdict(clip: ScoopClip, row: int) -> str:
    """The clip's text, with how it ended once it has."""
    if row < len(clip.piece) - 1:
        return str(clip.text)
    return f"{clip.text}: {ending(clip)}"


def ending(clip: ScoopClip) -> str:
    """Where the piece lay at the end."""
    if clip.success:
        return "on the spatula"
    return "not on the spatula"


def outlines(clip: ScoopClip, row: int) -> dict[str, np.ndarray]:
    """`[N, 2]` m, the outlines of blade, neck and piece in the plane of the motion."""
    tip, piece = np.asarray(clip.tip)[row], np.asarray(clip.piece)[row]
    blade = _box(model.BLADE_HALF) + model.BLADE_CENTRE
    neck = _turned(_box(model.NECK_HALF), model.NECK_RISE) + model.NECK_CENTRE
    return {
        "blade": _turned(blade, tip[2]) + tip[:2],
        "neck": _turned(neck, tip[2]) + tip[:2],
        "piece": _turned(piece_outline(clip.params), piece[2]) + piece[:2],
    }


def piece_outline(params: Any) -> np.ndarray:
    """`[N, 2]` m about the centre, of the piece of `params [4]`."""
    half = np.array([model.RADIUS, float(params[3]) / 2])
    if int(params[2]) == model.ELLIPSOID:
        angle = np.linspace(0.0, 2 * np.pi, 60)
        return np.stack([np.cos(angle), np.sin(angle)], 1) * half
    return _box(half)


def _box(half: Any) -> np.ndarray:
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Nose down by `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, -s], [s, c]])


def draw_scoop(ax: Any, clip: ScoopClip, row: int) -> None:
    """The scene from the side into matplotlib's `ax`, about the tip, over marks each 2 cm."""
    from matplotlib.patches import Polygon

    middle = float(np.asarray(clip.tip)[row, 0])
    ax.set_xlim(middle - BACK, middle + AHEAD)
    ax.set_ylim(DOWN, UP)
    ax.set_aspect("equal")
    ax.set_facecolor("#f6f3ee")
    ax.spines[:].set_visible(False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.axhspan(DOWN, 0.0, color="#e4ddd0", zorder=0)
    ax.axhline(0.0, color=TABLE, linewidth=1.2, zorder=1)
    for mark in np.arange(np.floor((middle - BACK) / 0.02) * 0.02, middle + AHEAD, 0.02):
        ax.plot([mark, mark], [-0.003, 0.0], color=TABLE, linewidth=1.0, zorder=1)
    shapes = outlines(clip, row)
    for name, colour, alpha in (("neck", STEEL, 1.0), ("blade", STEEL, 1.0), ("piece", FOOD, 0.55)):
        look = {"facecolor": colour, "edgecolor": colour, "alpha": alpha}
        ax.add_patch(Polygon(shapes[name], linewidth=1.0, zorder=2, **look))


def drawing(clip: ScoopClip) -> Callable[[Moment], Any]:
    """The spatula from the side, the view going with it."""

    def draw(moment: Moment) -> Any:
        figure = captioned(moment, 0.025, 0.975, 0.925)
        draw_scoop(figure.add_axes((0.0, 0.0, 1.0, 1.0)), clip, moment.row)
        return figure

    return draw


def stage(clip: ScoopClip) -> Stage:
    """Spatula and piece over a table; the camera goes with the tip."""
    import mujoco

    made = mujoco.MjModel.from_xml_string(scene_xml(clip.params))
    light(made, 0.45, 0.3)

    def place(data: Any, row: int) -> None:
        for body, (x, z, angle) in enumerate((clip.piece[row], clip.tip[row])):
            data.mocap_pos[body] = x, 0.0, z
            data.mocap_quat[body] = np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0

    def view(row: int) -> Any:
        x, z = clip.tip[row, :2]
        return camera(112.0, -16.0, 0.24, (x - 0.03, 0.0, 0.5 * z + 0.022))

    return Stage(made, place, view)


def scene_xml(params: Any) -> str:
    """MJCF of table, spatula and piece, the latter two moved by hand; nothing touches anything."""
    r, half = model.RADIUS, float(params[3]) / 2
    shape = int(params[2])
    size = f"{r} {half}" if shape == model.CYLINDER else f"{r} {r} {half}"
    (bx, bz), (hx, hz) = model.BLADE_CENTRE, model.BLADE_HALF
    (nx, nz), (kx, kz) = model.NECK_CENTRE, model.NECK_HALF
    c, s = np.cos(model.NECK_RISE / 2), np.sin(model.NECK_RISE / 2)
    look = 'contype="0" conaffinity="0"'
    grip = f"{nx - 0.10} 0 {nz + 0.06} {nx - 0.008} 0 {nz + 0.006}"
    return f"""<mujoco><visual><global offwidth="{SIZE[0]}" offheight="{SIZE[1]}"/><map znear="0.02"/>
<quality shadowsize="4096"/></visual>
<asset><texture name="t" type="2d" builtin="checker" rgb1="0.93 0.90 0.85" rgb2="0.89 0.85 0.79" width="200" height="200"/>
<texture name="sky" type="skybox" builtin="gradient" rgb1="0.95 0.96 0.98" rgb2="0.7 0.76 0.85" width="64" height="64"/>
<material name="table" texture="t" texrepeat="25 25" texuniform="true"/></asset>
<worldbody><light pos="0 -0.5 1" dir="0.2 0.4 -1" directional="true" diffuse="0.45 0.45 0.45" specular="0 0 0"/>
<geom type="plane" size="1 1 0.01" material="table" {look}/>
<body name="piece" mocap="true"><geom type="{model.SHAPES[shape]}" size="{size}" rgba="0.05 0.45 0.70 1" {look}/></body>
<body name="tip" mocap="true">
<geom type="box" size="{hx} {model.BLADE_HALF_WIDTH} {hz}" pos="{bx} 0 {bz}" rgba="0.71 0.32 0.18 1" {look}/>
<geom type="box" size="{kx} {model.NECK_HALF_WIDTH} {kz}" pos="{nx} 0 {nz}" quat="{c} 0 {s} 0" rgba="0.71 0.32 0.18 1" {look}/>
<geom type="capsule" fromto="{grip}" size="0.006" rgba="0.35 0.33 0.31 1" {look}/></body>
</worldbody></mujoco>"""  # noqa: E501


SCENE = Scene(
    home=f"{__name__}:SCENE",
    name="scoop",
    clip=ScoopClip,
    size=SIZE,
    hold=14,
    fps=lambda clips: 20.0,
    moments=moments,
    drawing=drawing,
    side="the side",
    stage=stage,
)


def scoops_over_iterations(
    clips: Sequence[ScoopClip],
    heads: Sequence[str],
    rewards: Sequence[float],
    params: np.ndarray,
    axes: Sequence[Any],
    *,
    target: Sequence[float] | None = None,
) -> Any:
    """As the paper's figure: a column for each iteration shown, its trial from top to bottom, and
    the parameters over all iterations.

    Args:
        clips, heads, rewards: Of the iterations shown.
        params: `[I + 1, D]` physical; axes: `report.figures_comparison.Axis` of each.
    """
    from matplotlib.figure import Figure

    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_comparison import parameters_over_iterations

    columns, rows = len(clips), len(ITERATION)
    figure = Figure(
        figsize=(1.75 * columns + 2.9, max(1.08 * rows + 0.5, 3.6)), layout="constrained"
    )
    frames: Any = figure.subfigures(1, 2, width_ratios=[1.75 * columns + 0.3, 2.45])
    plots = frames[0].subplots(rows, columns, squeeze=False)
    for c, clip in enumerate(clips):
        for r, moment in enumerate(ITERATION):
            draw_scoop(plots[r, c], clip, _row_at(clip, moment))
        plots[0, c].set_title(heads[c], fontsize=8, color=look.INK, pad=3)
        reward = f"reward {rewards[c]:.2f}"
        plots[-1, c].set_xlabel(reward, fontsize=7.5, color=look.MUTED, labelpad=2)
    for r, moment in enumerate(ITERATION):
        plots[r, 0].set_ylabel(f"{moment:g} s", fontsize=8, color=look.MUTED)
    parameters_over_iterations(frames[1], np.arange(len(params)), params, axes, target)
    return figure


def film_strips(clips: Sequence[ScoopClip], names: Sequence[str]) -> Any:
    """A trial a row, left to right in time."""
    from adaptsim_jax.report import figures as look

    columns = len(STRIP)
    figure, axes = look.new_figure(1.6 * columns + 0.4, 2.6, len(clips), columns)
    for r, (clip, name) in enumerate(zip(clips, names, strict=True)):
        strip = axes[r * columns : (r + 1) * columns]
        for ax, moment in zip(strip, STRIP, strict=True):
            draw_scoop(ax, clip, _row_at(clip, moment))
            if r == 0:
                ax.set_title(f"{moment:.1f} s", fontsize=8.5, color=look.MUTED, pad=3)
        strip[0].set_ylabel(name, fontsize=9.5, color=look.INK)
        strip[-1].set_xlabel(ending(clip), fontsize=8.5, color=look.INK, labelpad=3)
    return figure


def _row_at(clip: ScoopClip, seconds: float) -> int:
    return round((len(clip.piece) - 1) * seconds / model.SECONDS)
