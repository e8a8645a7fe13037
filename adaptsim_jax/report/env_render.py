"""Episodes of any MuJoCo model rendered off screen, as a program: `python -m
adaptsim_jax.report.env_render clips.npz film.mp4`.

A process of its own, since MuJoCo's OpenGL is chosen by the environment at import and may take the
process down.
"""

import importlib
import os
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np

from adaptsim_jax.report.env_video import HOLD, Clip
from adaptsim_jax.report.push_render import with_text
from adaptsim_jax.report.push_video import program

WIDTH, HEIGHT, BAND = 480, 360, 36


def frames(clips: list[Clip]) -> Iterator[np.ndarray]:
    """`[360, 480, 3]` uint8 frames by the model's first camera, or a free one that sees all of
    it.
    """
    mujoco: Any = importlib.import_module("mujoco")
    model = _model(mujoco, clips[0].model)
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, HEIGHT - BAND, WIDTH)
    band = np.full((BAND, WIDTH, 3), 255, np.uint8)  # text shows on it whatever the scene is like
    for clip in clips:
        last = len(clip.qpos) - 1
        for row, mocap in enumerate(clip.mocap):
            data.qpos[:], data.mocap_pos[:] = clip.qpos[row], mocap.reshape(data.mocap_pos.shape)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, 0 if model.ncam else -1)
            text, time = str(clip.text), f"{float(clip.dt) * row:.2f} s"
            yield from [with_text(np.concatenate([band, renderer.render()]), text, time)] * (
                HOLD if row == last else 1
            )


def _model(mujoco: Any, raw: np.ndarray) -> Any:
    with tempfile.NamedTemporaryFile(suffix=".mjb", delete=False) as file:
        file.write(np.asarray(raw, np.uint8).tobytes())
    try:
        return mujoco.MjModel.from_binary_path(file.name)
    finally:
        os.unlink(file.name)


if __name__ == "__main__":
    program(Clip, frames)
