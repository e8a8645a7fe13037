"""Recordings of pushes: what is refused, and an effect that is named from the command line."""

import hashlib
import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from adaptsim_jax import __version__, cli
from adaptsim_jax.commands.robot_session import recorded_trials
from adaptsim_jax.core import config, store
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import model, slide
from adaptsim_jax.tasks.pushing.diagnosis.diagnose import informative_pushes
from adaptsim_jax.tasks.pushing.diagnosis.problem import prepare
from adaptsim_jax.tasks.pushing.diagnosis.read import read
from adaptsim_jax.tasks.pushing.model import HEIGHT
from adaptsim_jax.tasks.pushing.planar import DRAKE

COUNT = 12
RNG = np.random.default_rng(3)
ACTIONS = np.stack(
    [RNG.permutation(np.linspace(0.4, 0.8, COUNT)), RNG.permutation(np.linspace(-0.3, 0.3, COUNT))],
    1,
)


@pytest.fixture(scope="module")
def tracks():
    """[T, R, 2] m at 50 Hz of a table that is not level."""
    values = dict(zip(model.PARAMETERS, (0.12, 5e4, 0.4, 0.03), strict=True)) | {
        "tilt_x": 0.02,
        "tilt_y": -0.03,
    }
    rows = jax.jit(jax.vmap(lambda a: slide.rollout(values, a)))(ACTIONS.astype(np.float32))
    out = np.asarray(rows, float)[:, ::4, :2]
    return out + 5e-4 * RNG.standard_normal(out.shape)


def written(folder, tracks, meta='task = "pushing"\n', rate=50.0):
    folder.mkdir(exist_ok=True)
    (folder / "meta.toml").write_text(meta)
    rows = [f"{i},{a:.6f},{b:.6f}" for i, (a, b) in enumerate(ACTIONS, 1)]
    (folder / "actions.csv").write_text("\n".join(["trial,speed,angle", *rows, ""]))
    rows = [
        f"{i},{k / rate:.4f},{x:.6f},{y:.6f}"
        for i, track in enumerate(tracks, 1)
        for k, (x, y) in enumerate(track)
    ]
    (folder / "tracks.csv").write_text("\n".join(["trial,time,x,y", *rows, ""]))
    return folder


def test_pushes_are_read_with_their_noise(tmp_path, tracks):
    pushed = read(written(tmp_path, tracks))
    assert pushed.names == tuple(map(str, range(1, COUNT + 1)))
    assert pushed.noise == pytest.approx(5e-4, rel=0.2)
    assert pushed.noise_source == "rows before the hit"


def test_rounding_is_noise_though_a_bottle_at_rest_does_not_show_it(tmp_path, tracks):
    still = tracks.copy()
    still[:, :8] = model.START
    pushed = read(written(tmp_path, np.round(still, 3)))
    assert pushed.noise == pytest.approx(1e-3 / np.sqrt(12.0))
    assert any("rounded to 1 mm" in note for note in pushed.notes)


def test_frames_in_which_the_camera_saw_nothing_are_drop_outs(tmp_path, tracks):
    folder = written(tmp_path, tracks)
    lines = (folder / "tracks.csv").read_text().splitlines()
    cut = [i for i in range(1, len(lines)) if i % 7 == 3]
    (folder / "tracks.csv").write_text(
        "\n".join(lines[i] for i in range(len(lines)) if i not in cut) + "\n"
    )
    shorter = read(folder)
    for row in ("{},{},,", "{},{},nan,nan"):
        lost = [
            row.format(*line.split(",")[:2]) if i in cut else line for i, line in enumerate(lines)
        ]
        (folder / "tracks.csv").write_text("\n".join([*lost, ""]))
        np.testing.assert_array_equal(read(folder).xy, shorter.xy)
    half = [line.rsplit(",", 1)[0] + "," if i == 10 else line for i, line in enumerate(lines)]
    (folder / "tracks.csv").write_text("\n".join([*half, ""]))
    with pytest.raises(BadInput, match="line 11: column y holds no number"):
        read(folder)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda z: z * [1.0, -1.0], "mirrored"),
        (lambda z: z + np.array([0.5, 0.0]), "another frame"),
        (lambda z: 1000.0 * z, "metres"),
        (
            lambda z: np.where(np.arange(len(z))[:, None, None] == 4, z[4, 0], z),
            "trial 5: the bottle never moved",
        ),
        (lambda z: z[..., ::-1] + np.array([0.56, -0.56]), "another frame"),
        (lambda z: z[:, ::5], "20 Hz"),
    ],
)
def test_what_cannot_be_judged_is_refused(tmp_path, tracks, change, says):
    changed = change(tracks)
    with pytest.raises(BadInput, match=says):
        read(written(tmp_path, changed, rate=50.0 * changed.shape[1] / tracks.shape[1]))


def test_an_unknown_key_and_a_push_in_degrees_are_refused(tmp_path, tracks):
    with pytest.raises(BadInput, match="fricton"):
        read(written(tmp_path, tracks, 'task = "pushing"\nfricton = "clean"\n'))
    folder = written(tmp_path, tracks)
    text = (folder / "actions.csv").read_text().splitlines()
    (folder / "actions.csv").write_text("\n".join([text[0], "1,0.5,17.0", *text[2:], ""]))
    with pytest.raises(BadInput, match="degrees"):
        read(folder)


def test_a_session_is_read_from_the_files_that_were_told(tmp_path, tracks):
    folder = written(tmp_path / "told", tracks)
    run = store.RunFolder.create(
        tmp_path / "run", {"task": {"coefficients": "drake"}}, task="pushing"
    )
    file = folder / "tracks.csv"
    visit = {"file": str(file), "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    visit["pushes"] = [
        {"trial": i, "action": list(map(float, a))} for i, a in enumerate(ACTIONS, 1)
    ]
    session = tmp_path / "robot"
    store.save_checkpoint(
        session / store.CHECKPOINT,
        {"a": np.zeros(1)},
        task="pushing",
        step=1,
        config_hash="x",
        extra={"history": [visit]},
    )
    table = {"schema": store.SCHEMA, "version": __version__, "run": str(run.path)}
    table |= {"run_from_here": "../run", "trained": {}}
    config.write(session / "robot.toml", table | {"seed": 0, "starts": 1, "iterations": 1})
    pushed = recorded_trials(session)
    assert pushed.coefficients == DRAKE
    np.testing.assert_allclose(pushed.actions, ACTIONS, atol=1e-9)
    file.write_text(file.read_text() + "\n")
    with pytest.raises(BadInput, match="is not the file that was told"):
        recorded_trials(session)


def test_a_look_alike_that_no_push_shows_does_not_hide_one_that_some_push_does(tmp_path, tracks):
    """A scale of lengths by 5 % is what a camera straight over the arm's base sees 2.1 m above it,
    and unlike a faster plate.
    """
    pushed = read(written(tmp_path, tracks))
    problem = prepare(pushed, pushed.options, pushed.coefficients)

    def model(**given):
        values = problem.neutral
        values[problem.at(given)] = list(given.values())
        return SimpleNamespace(fit=SimpleNamespace(values=values))

    scaled, near, fast = (
        model(scale=0.05),
        model(near=0.05 / 1.05 / HEIGHT),
        model(speed_scale=0.05),
    )

    def named(*others):
        return SimpleNamespace(
            final=scaled,
            named=(
                SimpleNamespace(
                    candidate=problem.effect("camera_scale"),
                    alternatives=tuple(candidate for candidate, _ in others),
                    models=tuple(fitted for _, fitted in others),
                ),
            ),
        )

    parallax, speed = (problem.effect("parallax"), near), (problem.effect("speed_scale"), fast)
    both, one = (
        informative_pushes(pushed, named(parallax, speed)),
        informative_pushes(pushed, named(parallax)),
    )
    assert both["separates"] == ["camera_scale", "speed_scale"] and len(both["rows"]) == 3
    assert (
        one["message"].startswith("No push within the bounds tells camera scale and parallax apart")
        and not one["rows"]
    )


@pytest.mark.slow
def test_a_table_that_is_not_level_is_named(tmp_path, tracks):
    out = tmp_path / "out"
    assert cli.main(["diagnose", str(written(tmp_path / "pushes", tracks)), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    (effect,) = report["effects"]
    assert effect["name"] == "tilt"
    assert effect["parameters"]["tilt_y"]["value"] == pytest.approx(-0.03, abs=0.005)
    assert report["error"]["after"] < 1.3 * report["error"]["noise_floor"]
    assert 'name = "tilt"' in (out / "model.toml").read_text()
    assert "Tracks from above" in (out / "report.html").read_text()
