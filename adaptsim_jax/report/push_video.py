"""A film of pushes: rendered by MuJoCo off screen, or drawn from above and from the side where no
OpenGL works.

MuJoCo chooses its OpenGL when it is imported, and a driver that does not fit may end the process.
It is therefore asked in a process of its own (`push_render`), once for each kind of OpenGL that may
be there.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_pushing as draw
from adaptsim_jax.report.video_file import best_suffix, write_video

EVERY, FPS, HOLD = (
    2,
    20.0,
    12,
)  # rows a frame, frames a second (0.4 times real time), and frames at the end of a push
TIMEOUT = 300.0  # s
ALONG = (0.3, 1.3)  # m of the table that drawings show


@dataclass(frozen=True)
class Clip:
    """One push: the bottle's states `[T, 13]` of any backend, a row each 0.01 s; action `[2]` (m/s,
    rad), goal `[2]` m, the patch's place across m, and a line of text.
    """

    state: Any
    action: Any
    goal: Any
    patch: float
    text: str


def write_push_video(clips: Sequence[Clip], folder: Path) -> tuple[Path, str]:
    """`(path, how)`: the film in `folder`, and a line that says what drew it. mp4 with the extra
    `[video]`, else gif.
    """
    return filmed(
        "adaptsim_jax.report.push_render",
        clips,
        folder / "push",
        drawn_frames,
        "above and the side",
        FPS,
    )


def filmed(
    renderer: str,
    clips: Sequence[Any],
    stem: Path,
    drawn: Callable[[Any], Iterator[np.ndarray]],
    side: str,
    fps: float,
) -> tuple[Path, str]:
    """`(path, how)` of a film at `stem`: by the module `renderer` where one kind of OpenGL works,
    else of the frames `drawn` from `side`.
    """
    path = stem.with_name(stem.name + best_suffix())
    for kind in kinds():
        if rendered(renderer, clips, path, kind):
            return path, f"rendered by MuJoCo ({kind or 'default OpenGL'})"
    write_video(drawn(clips), path, fps)
    tried = ", ".join(kind or "the default" for kind in kinds())
    return (
        path,
        f"drawn from {side}: no OpenGL for MuJoCo here (tried {tried}; set MUJOCO_GL to choose)",
    )


def kinds() -> list[str]:
    """What MUJOCO_GL may be: the user's word where there is one, else what needs no screen."""
    if given := os.environ.get("MUJOCO_GL"):
        return [given]
    if sys.platform.startswith("linux"):
        return ["egl", "osmesa"]
    return [""]


def rendered(module: str, clips: Sequence[Any], path: Path, kind: str) -> bool:
    """Whether `module`, run as a program, made the film at `path` of `clips`, dataclasses of arrays
    and text.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "clips.npz"
        names = type(clips[0]).__annotations__
        arrays = {
            f"{key}_{i}": np.asarray(getattr(clip, key))
            for i, clip in enumerate(clips)
            for key in names
        }
        np.savez(file, allow_pickle=False, **arrays)
        environment = os.environ | ({"MUJOCO_GL": kind, "PYOPENGL_PLATFORM": kind} if kind else {})
        command = [sys.executable, "-m", module, str(file), str(path)]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, timeout=TIMEOUT, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            return False
    return done.returncode == 0 and path.exists()


def read_clips(path: str | Path, kind: Any) -> list[Any]:
    """The clips that `rendered` wrote, of the dataclass `kind`."""
    with np.load(path, allow_pickle=False) as data:
        first = next(iter(kind.__annotations__))
        count = sum(name.startswith(f"{first}_") for name in data.files)
        return [kind(*(data[f"{key}_{i}"] for key in kind.__annotations__)) for i in range(count)]


def program(
    kind: Any, frames: Callable[[list[Any]], Iterator[np.ndarray]], fps: float | None = None
) -> None:
    """What a renderer does that is run as `python -m RENDERER clips.npz film.mp4`: clips of the
    dataclass `kind` to a film, of `fps` frames a second (None: as the clips have it). Any error
    ends the process with a code other than 0.
    """
    read, film = read_clips(sys.argv[1], kind), Path(sys.argv[2])
    write_video(frames(read), film, float(read[0].fps) if fps is None else fps)
    sys.stdout.flush()
    os._exit(
        0
    )  # OpenGL contexts that end after their driver complain or crash; the film is whole by now


def canvas_of(figure: Any) -> Callable[[], np.ndarray]:
    """What draws a figure of matplotlib, each time anew: its pixels `[H, W, 3]` uint8."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)

    def pixels() -> np.ndarray:
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    return pixels


def shown(clips: Sequence[Clip]) -> Iterator[tuple[Clip, int, int]]:
    """The clip and row of each picture, and for how many frames it stays: every second row, and the
    last one for a while.
    """
    for clip in clips:
        last = len(clip.state) - 1
        yield from ((clip, row, 1) for row in range(0, last, EVERY))
        yield clip, last, HOLD


def drawn_frames(clips: Sequence[Clip]) -> Iterator[np.ndarray]:
    """`[360, 640, 3]` uint8 frames: the table from above and from the side."""
    from matplotlib.figure import Figure

    for clip, row, times in shown(clips):
        figure = Figure(figsize=(6.4, 3.6), dpi=100, facecolor="white")
        # 5 inches to the metre in both
        above, side = (
            figure.add_axes((0.125, 0.365, 0.78125, 2.0 / 3.6)),
            figure.add_axes((0.125, 0.075, 0.78125, 0.9 / 3.6)),
        )
        _draw_above(above, clip, row)
        _draw_side(side, clip, row)
        figure.text(0.125, 0.945, clip.text, fontsize=11, color=look.INK)
        figure.text(
            0.906, 0.945, f"{0.01 * (row + 1):.2f} s", fontsize=11, color=look.MUTED, ha="right"
        )
        yield from [canvas_of(figure)()] * times


def plate(action: Any, row: int) -> tuple[float, float, float]:
    """How far the plate has come forward m, up m and pitched rad at `row`: the profile of
    `tasks.pushing.model`.
    """
    from adaptsim_jax.tasks.pushing import model as pushing

    path = float(np.sum(pushing.ramp(np.arange(0.0005, 0.01 * (row + 1), 0.001))) * 0.001)
    return float(action[0]) * path, pushing.RISE_SPEED * path, pushing.PITCH_RATE * path


def _edge(clip: Clip, row: int) -> tuple[np.ndarray, float]:
    """The plate's lower edge: its middle `[2]` m from above, and its height m."""
    from adaptsim_jax.tasks.pushing import model as pushing

    forward, up, pitch = plate(clip.action, row)
    ahead = forward - pushing.LINK_BACK + pushing.EDGE_DROP * np.sin(pitch)
    toward = np.array([np.cos(clip.action[1]), np.sin(clip.action[1])])
    return np.array(
        pushing.START
    ) + ahead * toward, pushing.LINK_HEIGHT + up - pushing.EDGE_DROP * np.cos(pitch)


def _draw_above(ax: Any, clip: Clip, row: int) -> None:
    from matplotlib.patches import Circle, Rectangle

    _still(ax, ALONG, (-0.2, 0.2), "y (m)")
    ax.tick_params(labelbottom=False)
    side = draw.PATCH_SIDE
    ax.add_patch(
        Rectangle(
            (draw.PATCH_X - side / 2, clip.patch - side / 2), side, side, facecolor=draw.PATCH
        )
    )
    ax.plot(*clip.goal, "x", color=draw.GOAL, markersize=9, markeredgewidth=3)
    track = np.concatenate([[draw.START], np.asarray(clip.state)[: row + 1, :2]])
    ax.plot(*track.T, color=draw.BOTTLE, linewidth=1.2)
    ax.add_patch(
        Circle(track[-1], draw.RADIUS, facecolor=draw.BOTTLE, alpha=0.5, edgecolor=draw.BOTTLE)
    )
    middle, _ = _edge(clip, row)
    across = 0.05 * np.array([-np.sin(clip.action[1]), np.cos(clip.action[1])])
    ax.plot(
        *np.stack([middle - across, middle + across], 1),
        color="#b5512f",
        linewidth=3.5,
        solid_capstyle="round",
    )


def _draw_side(ax: Any, clip: Clip, row: int) -> None:
    from matplotlib.patches import Polygon

    from adaptsim_jax.tasks.pushing import model as pushing

    _still(ax, ALONG, (-0.015, 0.165), "z (m)")
    ax.axhline(0.0, color="#a89f8f", linewidth=1.2)
    half = draw.PATCH_SIDE / 2
    ax.plot([draw.PATCH_X - half, draw.PATCH_X + half], [0, 0], color="#77808c", linewidth=3)
    ax.plot(clip.goal[0], 0.0, "x", color=draw.GOAL, markersize=9, markeredgewidth=3, clip_on=False)
    pose = np.asarray(clip.state)[row]
    w, x, y, z = pose[3:7]
    up = np.array([2 * (x * z + w * y), 1 - 2 * (x * x + y * y)]) * pushing.HEIGHT / 2
    out = np.array([up[1], -up[0]]) * 2 * draw.RADIUS / pushing.HEIGHT
    middle = pose[[0, 2]]
    corners = [middle + up + out, middle + up - out, middle - up - out, middle - up + out]
    ax.add_patch(Polygon(corners, facecolor=draw.BOTTLE, alpha=0.5, edgecolor=draw.BOTTLE))
    edge, height = _edge(clip, row)
    pitch = plate(clip.action, row)[2]
    tip = np.array([edge[0], height])
    top = tip + 0.12 * np.array([-np.sin(pitch), np.cos(pitch)])
    ax.plot(*np.stack([tip, top], 1), color="#b5512f", linewidth=3.5, solid_capstyle="round")


def _still(ax: Any, x: tuple[float, float], y: tuple[float, float], label: str) -> None:
    ax.set_xlim(*x)
    ax.set_ylim(*y)
    ax.set_yticks([0.0, 0.1] if y[0] > -0.1 else [-0.1, 0.0, 0.1])
    ax.set_facecolor("#f6f3ee")
    ax.spines[:].set_visible(False)
    ax.tick_params(colors=look.MUTED, labelsize=7, length=2)
    ax.set_ylabel(label, fontsize=8, color=look.MUTED)
