"""Scoops drawn and filmed: the right thing in the right place, with OpenGL or without."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.commands import phase2
from adaptsim_jax.report import figures as look
from adaptsim_jax.report import film as films
from adaptsim_jax.report.figures_comparison import Axis
from adaptsim_jax.report.film import drawn_frames, write_film
from adaptsim_jax.tasks.scooping import film, kind, model
from adaptsim_jax.tasks.scooping.config import scooping_space
from adaptsim_jax.tasks.scooping.film import SCENE, ScoopClip, outlines, scoops_over_iterations

PARAMS = np.array([0.3, 5e4, 1.0, 0.02])
AXES = [Axis("mu", 0.25, 0.4), Axis("e", 1e4, 5e5, True), Axis("g", 0, 1), Axis("h", 0.015, 0.025)]


def clip(params=PARAMS, rows=41, success=True):
    """A spatula that slides 20 cm and rises, with the piece on it."""
    share = np.linspace(0.0, 1.0, rows)
    tip = np.stack([-0.03 + 0.2 * share, 0.04 * share, 0.1 - 0.3 * share], 1)
    piece = np.stack([0.17 * share, 0.01 + 0.05 * share, 0.1 * share], 1)
    return ScoopClip(piece, tip, params, success, "iteration 2")


def test_outlines_stand_where_the_poses_say():
    shapes = outlines(clip(), 0)
    tip = np.array([-0.03, 0.0])
    front = shapes["blade"][shapes["blade"][:, 0].argmax()]
    assert np.linalg.norm(front - tip) < 2e-3  # the tip is the blade's front edge
    assert shapes["blade"][:, 0].min() < tip[0] - 0.09
    assert shapes["blade"][:, 1].max() > 0.005  # nose down by 0.1 rad: the back is higher
    np.testing.assert_allclose(np.abs(shapes["piece"]).max(0), [model.RADIUS, 0.02], atol=1e-9)
    ellipse = outlines(clip(np.array([0.3, 5e4, 0.0, 0.02])), 0)["piece"]
    np.testing.assert_allclose(np.ptp(ellipse, axis=0), [0.03, 0.02], atol=1e-4)


def test_frames_are_drawn_and_say_how_it_ended():
    made = clip(success=False)
    shown = film.moments(made)
    assert (
        len(shown) == film.FRAMES
        and shown[-1].row == 40
        and shown[-1].time == pytest.approx(model.SECONDS)
    )
    assert film.verdict(made, 10) == "iteration 2" and "not on" in film.verdict(made, 40)
    frames = drawn_frames(SCENE, [made])
    first = next(frames)
    assert first.shape == (360, 640, 3) and first.dtype == np.uint8
    later = [next(frames) for _ in range(30)][-1]
    assert np.mean(np.any(first != later, -1)) > 0.02


def test_a_film_without_opengl(monkeypatch, tmp_path):
    monkeypatch.setattr(films, "rendered", lambda *_: False)
    monkeypatch.setattr(film, "FRAMES", 3)
    path, how = write_film(replace(SCENE, hold=1), [clip()], tmp_path)
    assert path.exists() and path.stat().st_size > 1000 and "no OpenGL" in how


def test_scenes_load_in_mujoco_and_are_where_the_drawing_is():
    mujoco = pytest.importorskip("mujoco")
    for shape in range(3):
        m = mujoco.MjModel.from_xml_string(film.scene_xml(np.array([0.3, 5e4, shape, 0.02])))
        piece = m.geom_size[1]
        assert piece[0] == model.RADIUS and {model.CYLINDER: piece[1]}.get(shape, piece[2]) == 0.01
    tip, data = clip().tip[20], mujoco.MjData(m)
    data.mocap_pos[1], data.mocap_quat[1] = (
        (tip[0], 0, tip[1]),
        (np.cos(tip[2] / 2), 0, np.sin(tip[2] / 2), 0),
    )
    mujoco.mj_forward(m, data)
    for geom, name in ((2, "blade"), (3, "neck")):
        middle = outlines(clip(), 20)[name].mean(0)
        np.testing.assert_allclose(data.geom_xpos[geom, [0, 2]], middle, atol=1e-6)
        along = data.geom_xmat[geom].reshape(3, 3)[[0, 2], 0]
        drawn = np.diff(outlines(clip(), 20)[name][:2], axis=0)[0]
        np.testing.assert_allclose(along, drawn / np.linalg.norm(drawn), atol=1e-6)


def test_the_best_visit_is_the_one_that_is_deployed(tmp_path, monkeypatch):
    """The highest raw return, not the highest reward, as in `result.json`."""
    drawn = []
    monkeypatch.setattr(
        film, "scoops_over_iterations", lambda *given, **_: drawn.append(given) or "figure"
    )
    monkeypatch.setattr(kind, "clips_of", lambda config, policies, target: [policies] * 3)
    monkeypatch.setattr(phase2, "save", lambda figure, path: path)
    score, reward = (
        np.array([[0.5, np.nan, 0.5], [0.0, 1.0, 0.5]]),
        np.array([[0.9, 0.2, 0.1], [0.3, 0.4, 0.5]]),
    )
    history = SimpleNamespace(
        score=score,
        reward=reward,
        mean=np.full((2, 3, 4), 0.5, np.float32),
        policy=np.arange(2),
    )
    result = SimpleNamespace(history=history, policy=SimpleNamespace(told=None))
    task = SimpleNamespace(space=scooping_space(), name="scooping", doubt=0.0)
    run = SimpleNamespace(task="scooping", config={}, path=tmp_path)
    lines = phase2.write_look(run, task, ("wd", PARAMS), result, tmp_path, False)
    assert lines == [f"written: {tmp_path / 'scoops.png'}"]
    assert drawn[0][:3] == (
        [1, 1, 1],
        ["iteration 0", "iteration 1 (best)", "iteration 2"],
        [0.3, 0.4, 0.5],
    )


def test_the_figure_of_iterations(tmp_path):
    figure = scoops_over_iterations(
        [clip(), clip(success=False)],
        ["iteration 0", "iteration 3 (best)"],
        [0.17, 1.0],
        np.tile(PARAMS, (4, 1)),
        AXES,
        target=PARAMS.tolist(),
    )
    path = look.save(figure, tmp_path / "scoops.png")
    assert path.stat().st_size > 10_000
