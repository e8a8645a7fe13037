"""Scoops rendered by MuJoCo, as a program: `python -m adaptsim_jax.report.scoop_render clips.npz
film.mp4`.

A process of its own, since MuJoCo's OpenGL is chosen by the environment at import and may take the
process down.
"""

import importlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.report.push_render import HEIGHT, WIDTH, with_text
from adaptsim_jax.report.push_video import program
from adaptsim_jax.report.scoop_video import FPS, ScoopClip, shown, verdict
from adaptsim_jax.tasks.scooping import model

CAMERA = {"azimuth": 112.0, "elevation": -16.0, "distance": 0.24, "lookat": (-0.03, 0.0, 0.022)}


def scene(params: Any) -> str:
    """MJCF of table, spatula and piece, the latter two moved by hand; nothing touches anything."""
    r, half = model.RADIUS, float(params[3]) / 2
    shape = int(params[2])
    size = f"{r} {half}" if shape == model.CYLINDER else f"{r} {r} {half}"
    (bx, bz), (hx, hz) = model.BLADE_CENTRE, model.BLADE_HALF
    (nx, nz), (kx, kz) = model.NECK_CENTRE, model.NECK_HALF
    c, s = np.cos(model.NECK_RISE / 2), np.sin(model.NECK_RISE / 2)
    look = 'contype="0" conaffinity="0"'
    grip = f"{nx - 0.10} 0 {nz + 0.06} {nx - 0.008} 0 {nz + 0.006}"
    return f"""<mujoco><visual><global offwidth="{WIDTH}" offheight="{HEIGHT}"/><map znear="0.02"/>
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
</worldbody></mujoco>"""


def frames(clips: Sequence[ScoopClip]) -> Iterator[np.ndarray]:
    """`[360, 640, 3]` uint8 frames; the camera goes with the tip."""
    mujoco: Any = importlib.import_module("mujoco")
    renderer: Any = None
    data: Any = None
    last, m = None, None
    for clip, row, time, times in shown(clips):
        if clip is not last:
            m = mujoco.MjModel.from_xml_string(scene(clip.params))
            m.vis.headlight.ambient[:], m.vis.headlight.diffuse[:], m.vis.headlight.specular[:] = (
                0.45,
                0.3,
                0.0,
            )
            data, last = mujoco.MjData(m), clip
            if renderer is not None:
                renderer.close()
            renderer = mujoco.Renderer(m, HEIGHT, WIDTH)
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation, camera.distance = (
            CAMERA["azimuth"],
            CAMERA["elevation"],
            CAMERA["distance"],
        )
        camera.lookat[:] = np.add(CAMERA["lookat"], (clip.tip[row, 0], 0.0, 0.5 * clip.tip[row, 1]))
        for body, (x, z, angle) in enumerate((clip.piece[row], clip.tip[row])):
            data.mocap_pos[body] = x, 0.0, z
            data.mocap_quat[body] = np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0
        mujoco.mj_forward(m, data)
        renderer.update_scene(data, camera)
        yield from [with_text(renderer.render(), verdict(clip, row), f"{time:.2f} s")] * times


if __name__ == "__main__":
    program(ScoopClip, frames, FPS)
