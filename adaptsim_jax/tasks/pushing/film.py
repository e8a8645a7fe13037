"""The push on film: bottle, plate and patch from above and from the side, or in MuJoCo's scene."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.report.film import Moment, Scene, Stage, camera, captioned, light
from adaptsim_jax.tasks.pushing import model as pushing

EVERY = 2  # rows a frame, at 20 frames a second: 0.4 times real time
ALONG = (0.3, 1.3)  # m of the table that drawings show
BOTTLE, GOAL, PATCH, PLATE = "#0072B2", "#D49A00", "#c3cad3", "#b5512f"
YELLOW, WAY = (0.95, 0.75, 0.05, 1.0), (0.0, 0.35, 0.6, 1.0)


@dataclass(frozen=True)
class PushClip:
    """One push: the bottle's states `[T, 13]` of any backend, a row each 0.01 s; action `[2]` (m/s,
    rad), goal `[2]` m, the patch's place across m, and a line of text.
    """

    state: Any
    action: Any
    goal: Any
    patch: float
    text: str


def moments(clip: PushClip) -> list[Moment]:
    """Every second row, and the last one."""
    last = len(clip.state) - 1
    return [Moment(row, 0.01 * (row + 1), str(clip.text)) for row in (*range(0, last, EVERY), last)]


def plate(action: Any, row: int) -> tuple[float, float, float]:
    """How far the plate has come forward m, up m and pitched rad at `row`: the profile of
    `tasks.pushing.model`.
    """
    path = float(np.sum(pushing.ramp(np.arange(0.0005, 0.01 * (row + 1), 0.001))) * 0.001)
    return float(action[0]) * path, pushing.RISE_SPEED * path, pushing.PITCH_RATE * path


def plate_edge(clip: PushClip, row: int) -> tuple[np.ndarray, float]:
    """The plate's lower edge: its middle `[2]` m from above, and its height m."""
    forward, up, pitch = plate(clip.action, row)
    ahead = forward - pushing.LINK_BACK + pushing.EDGE_DROP * np.sin(pitch)
    toward = np.array([np.cos(clip.action[1]), np.sin(clip.action[1])])
    height = pushing.LINK_HEIGHT + up - pushing.EDGE_DROP * np.cos(pitch)
    return np.array(pushing.START) + ahead * toward, height


def drawing(clip: PushClip) -> Callable[[Moment], Any]:
    """The table from above and from the side, 5 inches to the metre in both."""

    def draw(moment: Moment) -> Any:
        figure = captioned(moment, 0.125, 0.906, 0.945)
        _draw_above(figure.add_axes((0.125, 0.365, 0.78125, 2.0 / 3.6)), clip, moment.row)
        _draw_side(figure.add_axes((0.125, 0.075, 0.78125, 0.9 / 3.6)), clip, moment.row)
        return figure

    return draw


def _draw_above(ax: Any, clip: PushClip, row: int) -> None:
    from matplotlib.patches import Circle, Rectangle

    _frame(ax, (-0.2, 0.2), "y (m)")
    ax.tick_params(labelbottom=False)
    side = pushing.PATCH_SIDE
    corner = (pushing.PATCH_X - side / 2, clip.patch - side / 2)
    ax.add_patch(Rectangle(corner, side, side, facecolor=PATCH))
    ax.plot(*clip.goal, "x", color=GOAL, markersize=9, markeredgewidth=3)
    track = np.concatenate([[pushing.START], np.asarray(clip.state)[: row + 1, :2]])
    ax.plot(*track.T, color=BOTTLE, linewidth=1.2)
    ax.add_patch(Circle(track[-1], pushing.RADIUS, facecolor=BOTTLE, alpha=0.5, edgecolor=BOTTLE))
    middle, _ = plate_edge(clip, row)
    across = 0.05 * np.array([-np.sin(clip.action[1]), np.cos(clip.action[1])])
    _draw_plate(ax, middle - across, middle + across)


def _draw_side(ax: Any, clip: PushClip, row: int) -> None:
    from matplotlib.patches import Polygon

    _frame(ax, (-0.015, 0.165), "z (m)")
    ax.axhline(0.0, color="#a89f8f", linewidth=1.2)
    half = pushing.PATCH_SIDE / 2
    ax.plot([pushing.PATCH_X - half, pushing.PATCH_X + half], [0, 0], color="#77808c", linewidth=3)
    ax.plot(clip.goal[0], 0.0, "x", color=GOAL, markersize=9, markeredgewidth=3, clip_on=False)
    pose = np.asarray(clip.state)[row]
    w, x, y, z = pose[3:7]
    up = np.array([2 * (x * z + w * y), 1 - 2 * (x * x + y * y)]) * pushing.HEIGHT / 2
    out = np.array([up[1], -up[0]]) * 2 * pushing.RADIUS / pushing.HEIGHT
    middle = pose[[0, 2]]
    corners = [middle + up + out, middle + up - out, middle - up - out, middle - up + out]
    ax.add_patch(Polygon(corners, facecolor=BOTTLE, alpha=0.5, edgecolor=BOTTLE))
    edge, height = plate_edge(clip, row)
    pitch = plate(clip.action, row)[2]
    tip = np.array([edge[0], height])
    _draw_plate(ax, tip, tip + 0.12 * np.array([-np.sin(pitch), np.cos(pitch)]))


def _draw_plate(ax: Any, begin: np.ndarray, end: np.ndarray) -> None:
    ax.plot(*np.stack([begin, end], 1), color=PLATE, linewidth=3.5, solid_capstyle="round")


def _frame(ax: Any, y: tuple[float, float], label: str) -> None:
    from adaptsim_jax.report import figures as look

    ax.set_xlim(*ALONG)
    ax.set_ylim(*y)
    ax.set_yticks([0.0, 0.1] if y[0] > -0.1 else [-0.1, 0.0, 0.1])
    ax.set_facecolor("#f6f3ee")
    ax.spines[:].set_visible(False)
    ax.tick_params(colors=look.MUTED, labelsize=7, length=2)
    ax.set_ylabel(label, fontsize=8, color=look.MUTED)


def stage(clip: PushClip) -> Stage:
    """Bottle, plate and patch, the goal as a yellow cross, and the way so far."""
    import mujoco

    from adaptsim_jax.tasks.pushing.engines import scene

    model: Any = scene.model(pushing.PAPER, 0.005, drawn=True)
    light(model, 0.45, 0.25)
    # a table that is lit by one lamp at a place shows its polygons
    model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_dir[:], model.light_diffuse[:], model.light_specular[:] = (0.35, 0.45, -1), 0.45, 0
    model.vis.quality.shadowsize = 4096
    model.geom_pos[model.geom("patch").id, 1] = float(clip.patch)
    view = camera(115.0, -44.0, 0.64, (0.78, 0.07, 0.03))

    def place(data: Any, row: int) -> None:
        data.qpos[:7], data.qpos[7] = clip.state[row, :7], clip.action[1]
        data.qpos[8:] = plate(clip.action, row)

    return Stage(model, place, lambda row: view, lambda scene, row: _add_marks(scene, clip, row))


def _add_marks(scene: Any, clip: PushClip, row: int) -> None:
    for turn in (np.pi / 4, -np.pi / 4):
        toward = np.cos(turn), np.sin(turn)
        _add_box(scene, (0.028, 0.005, 0.0006), (*clip.goal, 0.0008), toward, YELLOW)
    track = np.concatenate([[pushing.START], clip.state[: row + 1 : 2, :2]])
    for a, b in itertools.pairwise(track):
        length = float(np.linalg.norm(b - a))
        if length > 1e-4:
            size = (length / 2 + 0.001, 0.0018, 0.0004)
            _add_box(scene, size, (*(a + b) / 2, 0.0006), (b - a) / length, WAY)


def _add_box(scene: Any, size: Any, middle: Any, toward: Any, rgba: Any) -> None:
    """A box on the table, its length along `toward [2]`."""
    import mujoco

    if scene.ngeom >= scene.maxgeom:
        return
    geom, (c, s) = scene.geoms[scene.ngeom], toward
    turn = np.array((c, -s, 0, s, c, 0, 0, 0, 1), np.float64)
    places = (np.asarray(size, np.float64), np.asarray(middle, np.float64), turn)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, *places, np.asarray(rgba, np.float32))
    geom.emission, geom.specular = 0.6, 0.0
    scene.ngeom += 1


SCENE = Scene(
    home=f"{__name__}:SCENE",
    name="push",
    clip=PushClip,
    size=(640, 360),
    hold=12,
    fps=lambda clips: 20.0,
    moments=moments,
    drawing=drawing,
    side="above and the side",
    stage=stage,
)
