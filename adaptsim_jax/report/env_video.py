"""A film of episodes of any MuJoCo model, such as those of the first and the best policy in a
target.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.push_video import canvas_of, filmed

FPS, HOLD = 25.0, 12  # frames a second, and frames at the end of an episode


@dataclass(frozen=True)
class Clip:
    """One episode: places `qpos [T, nq]` and `mocap [T, 3 n]`, a row each `dt` s; the model's bytes
    (mjb); a line of text; frames a second.
    """

    qpos: Any
    mocap: Any
    dt: Any
    model: Any
    text: str
    fps: Any


def clip_of(qpos: np.ndarray, mocap: np.ndarray, dt: float, model: np.ndarray, text: str) -> Clip:
    """A clip at its own speed, as near to 25 frames a second as whole steps go."""
    every = max(1, round(1.0 / (FPS * dt)))
    return Clip(qpos[::every], mocap[::every], every * dt, model, text, 1.0 / (every * dt))


def write_env_video(clips: Sequence[Clip], folder: Path) -> tuple[Path, str]:
    """`(path, how)`: the film in `folder`, and a line that says what drew it. mp4 with the extra
    `[video]`, else gif.
    """
    fps = float(clips[0].fps)
    return filmed(
        "adaptsim_jax.report.env_render",
        clips,
        folder / "policies",
        drawn_frames,
        "coordinates over time",
        fps,
    )


def drawn_frames(clips: Sequence[Clip]) -> Iterator[np.ndarray]:
    """`[360, 480, 3]` uint8 frames: the joints' coordinates so far, where nothing can be
    rendered.
    """
    from matplotlib.figure import Figure

    for clip in clips:
        figure = Figure(figsize=(4.8, 3.6), dpi=100, facecolor="white")
        ax = figure.add_axes((0.14, 0.14, 0.8, 0.74))
        time = float(clip.dt) * np.arange(len(clip.qpos))
        ax.plot(time, clip.qpos, linewidth=1.2)
        ax.set_xlabel("s")
        ax.set_ylabel("coordinates (m, rad)")
        figure.text(0.14, 0.93, str(clip.text), fontsize=11, color=look.INK)
        pixels = canvas_of(figure)
        line = ax.axvline(0.0, color=look.INK, linewidth=0.8)
        for row in range(len(clip.qpos)):
            line.set_xdata([time[row]] * 2)
            yield from [pixels()] * (HOLD if row == len(clip.qpos) - 1 else 1)
