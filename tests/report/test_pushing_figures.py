"""Figures and films of the push: what is drawn is what was given, the plate meets the bottle, and
no OpenGL is no failure.
"""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.patches import Circle
from PIL import Image

from adaptsim_jax.report.figures_comparison import Axis, axes_of, parameters_found
from adaptsim_jax.report.film import drawn_frames, write_film
from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.pushing import figures as draw
from adaptsim_jax.tasks.pushing import film
from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.film import SCENE, PushClip
from adaptsim_jax.tasks.pushing.model import EDGE_RADIUS, RADIUS, START
from adaptsim_jax.tasks.registry import TASKS

AXES = [
    Axis("mu", 0.05, 0.2),
    Axis("e", 1e4, 1e6, True),
    Axis("mu_p", 0.2, 0.8),
    Axis("y_p", -0.1, 0.1),
]
PARAMS = np.array([[0.1, 1e5, 0.5, 0.05]])
ACTION = np.array([[0.7, 0.2]])
GOAL = np.array([0.9, -0.1])


@pytest.fixture(scope="module")
def clip():
    state, code = make_backend("planar").simulate(PARAMS, ACTION, np.array([START]))
    assert not code.any()
    return PushClip(state[0], ACTION[0], GOAL, 0.05, "a push")


@pytest.mark.parametrize(
    "task, called", [("pushing", "μ table"), ("scooping", "μ piece"), ("other", "")]
)
def test_parameters_are_called_what_their_task_calls_them(task, called):
    symbols = TASKS[task].symbols if task in TASKS else {}
    axis = axes_of(Space((Parameter("mu", 0.1, 0.2),)), symbols)[0]
    assert axis == Axis("mu", 0.1, 0.2, False, called)


def test_a_table_top_shows_each_push_where_it_was():
    track = np.stack([np.linspace(0.56, 0.8, 20), np.linspace(0, 0.05, 20)], -1)
    panels = [[[draw.Push((0.85, 0.02), track, 0.7)], [draw.Push((0.75, -0.1), track, 0.2)] * 2]]
    params = np.tile(PARAMS, (4, 1))
    figure = draw.pushes_over_iterations(
        panels, [["iteration 3", "iteration 4"]], params, AXES, patch=0.05, first=3
    )
    tops, lines = figure.axes[:2], figure.axes[2:]
    assert [ax.get_title() for ax in tops] == ["iteration 3", "iteration 4"] and len(lines) == 4
    assert [ax.get_xlabel() for ax in tops] == ["reward 0.70", "reward 0.20, 0.20"]
    ends = [p.center for p in tops[0].patches if isinstance(p, Circle)]
    assert (0.0, 0.56) in ends and np.allclose(
        ends[-1], (0.05, 0.8)
    )  # y across, x away from the arm
    assert np.allclose(tops[0].lines[-1].get_xydata(), [[0.02, 0.85]])
    assert tops[0].get_xlim()[0] > tops[0].get_xlim()[1]  # the arm's left is on the left
    assert lines[0].lines[0].get_xdata().tolist() == [3, 4, 5, 6]


def test_a_push_that_failed_has_no_track_and_is_no_failure_of_the_figure(tmp_path):
    lost, fine = np.full((20, 2), np.nan), np.stack([np.linspace(0.56, 1.2, 20), np.zeros(20)], -1)
    for tracks, farthest in (([lost], draw.REACH[0]), ([lost, fine], 1.25)):
        panels = [[[draw.Push((0.85, 0.02), track, 0.0) for track in tracks]]]
        figure = draw.pushes_over_iterations(panels, [["iteration 0"]], PARAMS, AXES)
        assert figure.axes[0].get_ylim()[1] == pytest.approx(farthest)
        figure.savefig(tmp_path / "pushes.png")


def test_parameters_of_each_method_and_seed_are_dots_and_methods_without_any_are_left_out():
    found = np.array([[0.1, 1e4, 0.5, 0.0], [0.2, 1e6, 0.6, 0.1]])
    rows = [
        {"method": "adaptsim", "setting": "ood-1", "best_params": found.tolist()},
        {"method": "udr", "setting": "ood-1"},
    ]
    figure = parameters_found(
        {"rows": rows, "settings": {"ood-1": {"params": [0.25, 5e4, 0.1, -0.1]}}}, AXES
    )
    assert len(figure.axes) == 4
    for k, ax in enumerate(figure.axes):
        target, seeds, middle = ax.lines
        assert target.get_xdata() == pytest.approx([[0.25, 5e4, 0.1, -0.1][k]] * 2)
        np.testing.assert_allclose(seeds.get_xdata(), found[:, k])
        assert middle.get_xdata()[0] == pytest.approx(1e5 if k == 1 else found[:, k].mean())
        low, high = ax.get_xlim()
        assert low < min(target.get_xdata()) and high > found[:, k].max()


def test_the_drawn_plate_meets_the_bottle_when_it_begins_to_move(clip):
    track = np.asarray(clip.state)[:, :2]
    row = int(np.argmax(np.linalg.norm(track - START, axis=1) > 1e-6))
    gap = [
        np.linalg.norm(track[k] - film.plate_edge(clip, k)[0]) - RADIUS - EDGE_RADIUS
        for k in (row - 2, row)
    ]
    assert (
        0 < gap[0] < 0.016 and -0.016 < gap[1] < 0
    )  # it touches between these rows, 8 mm apart each
    assert 0.01 < film.plate_edge(clip, row)[1] < 0.06
    forward, _, _ = film.plate(clip.action, 129)
    assert forward == pytest.approx(
        0.7 * (0.1 + 0.1 + 0.25), abs=2e-3
    )  # half the ramps and the hold


@pytest.mark.slow
def test_a_drawing_shows_the_bottle_going_to_where_it_went(clip):
    first, *_, last = frames = list(drawn_frames(SCENE, [clip]))
    assert (
        len(frames) == 65 + SCENE.hold and first.shape == (360, 640, 3) and first.dtype == np.uint8
    )

    def blue(f):
        return np.argwhere(
            (f[32:228, 80:580, 2] > 1.35 * f[32:228, 80:580, 0]) & (f[32:228, 80:580, 2] > 150)
        )

    def metres(pixel):
        return 0.3 + pixel / 500.0

    assert abs(metres(np.median(blue(first)[:, 1])) - 0.56) < 0.02
    assert metres(blue(last)[:, 1].max()) == pytest.approx(clip.state[-1, 0] + RADIUS, abs=0.02)


def test_where_mujoco_has_no_opengl_the_film_is_drawn_and_the_line_says_so(
    clip, tmp_path, monkeypatch
):
    monkeypatch.setenv("MUJOCO_GL", "none-such")
    short = PushClip(clip.state[::26], clip.action, clip.goal, clip.patch, clip.text)
    path, how = write_film(SCENE, [short], tmp_path)
    assert "no OpenGL" in how and "none-such" in how and "\n" not in how
    if path.suffix == ".gif":
        with Image.open(path) as film:
            assert film.size == (640, 360) and film.n_frames >= 3
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.slow
def test_mujoco_renders_the_same_push_where_it_can(clip, tmp_path):
    short = PushClip(clip.state[::26], clip.action, clip.goal, clip.patch, clip.text)
    path, how = write_film(SCENE, [short], tmp_path)
    if "rendered" not in how:
        pytest.skip(how)
    if path.suffix == ".gif":
        with Image.open(path) as film:
            film.seek(0)
            picture = np.asarray(film.convert("RGB")).astype(int)
        yellow = (picture[..., 0] > 200) & (picture[..., 1] > 170) & (picture[..., 2] < 90)
        green = (picture[..., 1] > picture[..., 0] + 30) & (picture[..., 1] > picture[..., 2] + 20)
        assert (
            yellow.sum() > 100 and green.sum() > 1000
        )  # the goal's cross and the bottle are in sight


def test_a_film_that_cannot_be_made_ends_in_an_error_code(tmp_path):
    command = [
        sys.executable,
        "-m",
        "adaptsim_jax.report.film",
        SCENE.home,
        str(tmp_path / "none.npz"),
        str(tmp_path / "a.gif"),
    ]
    assert subprocess.run(command, capture_output=True, check=False).returncode != 0
    assert not list(tmp_path.iterdir())
