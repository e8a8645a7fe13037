"""Pushes rendered by MuJoCo, as a program: `python -m adaptsim_jax.report.push_render clips.npz
film.mp4`.

A process of its own, since MuJoCo's OpenGL is chosen by the environment at import and may take the
process down.
"""

import importlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.report.push_video import FPS, Clip, plate, program, shown
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import scene as pushing_scene

WIDTH, HEIGHT = 640, 360
YELLOW, WAY = (0.95, 0.75, 0.05, 1.0), (0.0, 0.35, 0.6, 1.0)
CAMERA = {"azimuth": 115.0, "elevation": -44.0, "distance": 0.64, "lookat": (0.78, 0.07, 0.03)}


def frames(clips: list[Clip]) -> Iterator[np.ndarray]:
    """`[360, 640, 3]` uint8 frames: bottle, plate, patch, the goal as a yellow cross, and the way
    so far.
    """
    mujoco: Any = importlib.import_module("mujoco")
    m = pushing_scene.model(pushing.PAPER, 0.005, drawn=True)
    _light(m)
    data, camera = mujoco.MjData(m), mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = (
        CAMERA["azimuth"],
        CAMERA["elevation"],
        CAMERA["distance"],
    )
    camera.lookat[:] = CAMERA["lookat"]
    patch = m.geom("patch").id
    renderer = mujoco.Renderer(m, HEIGHT, WIDTH)
    for clip, row, times in shown(clips):
        m.geom_pos[patch, 1] = float(clip.patch)
        data.qpos[:7], data.qpos[7], data.qpos[8:] = (
            clip.state[row, :7],
            clip.action[1],
            plate(clip.action, row),
        )
        mujoco.mj_forward(m, data)
        renderer.update_scene(data, camera)
        _add_marks(mujoco, renderer.scene, clip, row)
        yield from [
            with_text(renderer.render(), str(clip.text), f"{0.01 * (row + 1):.2f} s")
        ] * times


def _light(m: Any) -> None:
    """Even light, as in a room: a table lit by one lamp shows its polygons."""
    m.vis.headlight.ambient[:], m.vis.headlight.diffuse[:], m.vis.headlight.specular[:] = (
        0.45,
        0.25,
        0.0,
    )
    m.light_type[:] = 1  # directional
    m.light_dir[:], m.light_diffuse[:], m.light_specular[:] = (0.35, 0.45, -1.0), 0.45, 0.0
    m.vis.quality.shadowsize = 4096


def _add_marks(mujoco: Any, scene: Any, clip: Clip, row: int) -> None:
    """A cross on the goal and the bottle's way so far, which are seen and touch nothing."""
    for turn in (np.pi / 4, -np.pi / 4):
        c, s = np.cos(turn), np.sin(turn)
        _box(
            mujoco,
            scene,
            (0.028, 0.005, 0.0006),
            (*clip.goal, 0.0008),
            (c, -s, 0, s, c, 0, 0, 0, 1),
            YELLOW,
        )
    track = np.concatenate([[pushing.START], clip.state[: row + 1 : 2, :2]])
    for a, b in itertools.pairwise(track):
        length = float(np.linalg.norm(b - a))
        if length > 1e-4:
            c, s = (b - a) / length
            size, middle = (length / 2 + 0.001, 0.0018, 0.0004), (*(a + b) / 2, 0.0006)
            _box(mujoco, scene, size, middle, (c, -s, 0, s, c, 0, 0, 0, 1), WAY)


def _box(mujoco: Any, scene: Any, size: Any, at: Any, turn: Any, rgba: Any) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]

    def array(values):
        return np.asarray(values, np.float64)

    mujoco.mjv_initGeom(
        geom,
        mujoco.mjtGeom.mjGEOM_BOX,
        array(size),
        array(at),
        array(turn),
        np.asarray(rgba, np.float32),
    )
    geom.emission, geom.specular = 0.6, 0.0
    scene.ngeom += 1


def with_text(frame: np.ndarray, text: str, time: str) -> np.ndarray:
    """`frame` with a line at its upper left and the time at its upper right."""
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(frame)
    brush = ImageDraw.Draw(image)
    font = ImageFont.truetype(
        str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), 16
    )
    brush.text((14, 10), text, fill=(32, 38, 46), font=font)
    brush.text((frame.shape[1] - 14, 10), time, fill=(70, 80, 92), font=font, anchor="ra")
    return np.asarray(image)


if __name__ == "__main__":
    program(Clip, frames, FPS)
