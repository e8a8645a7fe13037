"""Scoops drawn and filmed: the right thing in the right place, with OpenGL or without."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.commands import adapt_scooping
from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_scooping, push_video, scoop_video
from adaptsim_jax.report.figures_pushing import Axis
from adaptsim_jax.report.figures_scooping import scoops_over_iterations
from adaptsim_jax.report.scoop_video import ScoopClip, drawn_frames, outlines, write_scoop_video
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.config import scooping_space

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
    shown = list(scoop_video.shown([made]))
    assert (
        len(shown) == scoop_video.FRAMES
        and shown[-1][1] == 40
        and shown[-1][2] == pytest.approx(model.SECONDS)
    )
    assert scoop_video.verdict(made, 10) == "iteration 2" and "not on" in scoop_video.verdict(
        made, 40
    )
    frames = drawn_frames([made])
    first = next(frames)
    assert first.shape == (360, 640, 3) and first.dtype == np.uint8
    later = [next(frames) for _ in range(30)][-1]
    assert np.mean(np.any(first != later, -1)) > 0.02


def test_a_film_without_opengl(monkeypatch, tmp_path):
    monkeypatch.setattr(push_video, "rendered", lambda *_: False)
    monkeypatch.setattr(scoop_video, "FRAMES", 3)
    monkeypatch.setattr(scoop_video, "HOLD", 1)
    path, how = write_scoop_video([clip()], tmp_path)
    assert path.exists() and path.stat().st_size > 1000 and "no OpenGL" in how


def test_scenes_load_in_mujoco_and_are_where_the_drawing_is():
    mujoco = pytest.importorskip("mujoco")
    from adaptsim_jax.report.scoop_render import scene

    for shape in range(3):
        m = mujoco.MjModel.from_xml_string(scene(np.array([0.3, 5e4, shape, 0.02])))
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
    figure = scoops_over_iterations([clip()], [""], [0.0], np.tile(PARAMS, (3, 1)), AXES)
    monkeypatch.setattr(
        figures_scooping,
        "scoops_over_iterations",
        lambda *given, **_: drawn.append(given) or figure,
    )
    monkeypatch.setattr(adapt_scooping, "visits_of", lambda result, start: start)
    monkeypatch.setattr(adapt_scooping, "clips_of", lambda made, policies, target: [policies] * 3)
    score, reward = (
        np.array([[0.5, np.nan, 0.5], [0.0, 1.0, 0.5]]),
        np.array([[0.9, 0.2, 0.1], [0.3, 0.4, 0.5]]),
    )
    history = SimpleNamespace(score=score, reward=reward, mean=np.full((2, 3, 4), 0.5, np.float32))
    result = SimpleNamespace(history=history, policy=SimpleNamespace(told=None))
    task = SimpleNamespace(space=scooping_space(), name="scooping")
    found = {"run": "run", "target": {"params": dict(zip("abcd", PARAMS, strict=True))}}
    trained = SimpleNamespace(phase1=SimpleNamespace(task=task))
    adapt_scooping.show(trained, {}, found, result, tmp_path, False)
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
