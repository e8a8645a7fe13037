"""A film of scoops: rendered by MuJoCo off screen, or drawn from the side where no OpenGL works.

What is shown are the poses of the hydroelastic engine; MuJoCo lends its camera only.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.push_video import canvas_of, filmed
from adaptsim_jax.tasks.scooping import model

FPS, FRAMES, HOLD = (
    20.0,
    50,
    14,
)  # 0.4 times real time; frames of a trial, and how many its end stays
BACK, AHEAD, DOWN, UP = 0.125, 0.075, -0.0125, 0.1  # m of the view around the tip, 16 by 9
FOOD, STEEL, TABLE = "#0072B2", "#b5512f", "#a89f8f"


@dataclass(frozen=True)
class ScoopClip:
    """One trial: `piece [T, 3]` and `tip [T, 3]`, each x, z m and angle rad (nose down), over
    `scooping.SECONDS`; `params [4]`; whether the piece lay on the spatula at the end; a line of
    text.
    """

    piece: Any
    tip: Any
    params: Any
    success: bool
    text: str


def write_scoop_video(clips: Sequence[ScoopClip], folder: Path) -> tuple[Path, str]:
    """`(path, how)`: the film in `folder`, and a line that says what drew it. mp4 with the extra
    `[video]`, else gif.
    """
    return filmed(
        "adaptsim_jax.report.scoop_render", clips, folder / "scoop", drawn_frames, "the side", FPS
    )


def shown(clips: Sequence[ScoopClip]) -> Iterator[tuple[ScoopClip, int, float, int]]:
    """The clip, row and time s of each picture, and for how many frames it stays."""
    for clip in clips:
        rows = np.round(np.linspace(0, len(clip.piece) - 1, FRAMES)).astype(int)
        for row in rows:
            last = row == rows[-1]
            yield clip, int(row), model.SECONDS * row / (len(clip.piece) - 1), HOLD if last else 1


def verdict(clip: ScoopClip, row: int) -> str:
    """The clip's text, with how it ended once it has."""
    if row < len(clip.piece) - 1:
        ended = ""
    elif clip.success:
        ended = ": on the spatula"
    else:
        ended = ": not on the spatula"
    return f"{clip.text}{ended}"


def outlines(clip: ScoopClip, row: int) -> dict[str, np.ndarray]:
    """`[N, 2]` m, the outlines of blade, neck and piece in the plane of the motion."""
    tip, piece = np.asarray(clip.tip)[row], np.asarray(clip.piece)[row]

    def box(half):
        return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half

    blade = box(model.BLADE_HALF) + model.BLADE_CENTRE
    neck = _turned(box(model.NECK_HALF), model.NECK_RISE) + model.NECK_CENTRE
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
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Nose down by `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, -s], [s, c]])


def draw_scoop(ax: Any, clip: ScoopClip, row: int) -> None:
    """The scene from the side into matplotlib's `ax`, about the tip."""
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
    for mark in np.arange(
        np.floor((middle - BACK) / 0.02) * 0.02, middle + AHEAD, 0.02
    ):  # the table's centimetres
        ax.plot([mark, mark], [-0.003, 0.0], color=TABLE, linewidth=1.0, zorder=1)
    shapes = outlines(clip, row)
    for name, colour in (("neck", STEEL), ("blade", STEEL), ("piece", FOOD)):
        alpha = 0.55 if name == "piece" else 1.0
        ax.add_patch(
            Polygon(
                shapes[name],
                facecolor=colour,
                edgecolor=colour,
                alpha=alpha,
                linewidth=1.0,
                zorder=2,
            )
        )


def drawn_frames(clips: Sequence[ScoopClip]) -> Iterator[np.ndarray]:
    """`[360, 640, 3]` uint8 frames: the spatula from the side, the view going with it over a table
    with marks each 2 cm.
    """
    from matplotlib.figure import Figure

    for clip, row, time, times in shown(clips):
        figure = Figure(figsize=(6.4, 3.6), dpi=100, facecolor="white")
        draw_scoop(figure.add_axes((0.0, 0.0, 1.0, 1.0)), clip, row)
        figure.text(0.025, 0.925, verdict(clip, row), fontsize=11, color=look.INK)
        figure.text(0.975, 0.925, f"{time:.2f} s", fontsize=11, color=look.MUTED, ha="right")
        yield from [canvas_of(figure)()] * times
