"""A mended push as the simulator that policies are trained in: what a diagnosis wrote goes into
`adaptsim train --model`.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax import cli, make_task
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import planar, slide
from adaptsim_jax.tasks.pushing.config import PushingConfig
from adaptsim_jax.tasks.pushing.kind import of_model
from adaptsim_jax.tasks.pushing.trial import make_simulator
from adaptsim_jax.tasks.registry import make_one_shot

PARAMS, ACTION = jnp.array([0.1, 1e5, 0.6, 0.05]), jnp.array([0.6, 0.1])
DECLARED = {"mu": 0.12, "e": 9e4, "mu_p": 0.5, "y_p": 0.02}
TILT = {"name": "tilt", "where": "table", "parameters": {"tilt_x": 0.0, "tilt_y": 0.03}}
LATE = {"name": "latency", "where": "camera", "parameters": {"latency": 0.02}}
MODEL = {
    "schema": 2,
    "task": "pushing",
    "model": "planar",
    "friction": "clean",
    "mass": 0.3,
    "coefficients": "native",
    "declared": DECLARED,
    "effects": [TILT, LATE],
}


def test_a_mended_push_is_the_slide_and_one_that_lacks_nothing_is_planar():
    plain = make_simulator(PushingConfig())(PARAMS, ACTION)
    np.testing.assert_array_equal(plain, planar.rollout(PARAMS, ACTION))
    tilted = jax.jit(make_simulator(PushingConfig(mended=slide.Lacking(tilt_y=0.03))))(
        PARAMS, ACTION
    )
    assert tilted.shape == plain.shape
    assert tilted[-1, 1] > plain[-1, 1] + 0.005, "it slides downhill"
    gently = make_simulator(PushingConfig(mended=slide.Lacking(tilt_y=1e-9)))(PARAMS, ACTION)
    assert np.abs(np.asarray(gently - plain)).max() < 0.03, "the planar model's step apart"


def test_a_model_file_becomes_options_without_what_the_camera_does():
    options = of_model(MODEL, "model.toml")
    assert options.pop("left_out") == ["latency"]
    task = make_task("pushing", options)
    assert task.settings["fitted"]["e"] == 9e4
    made = config.from_table(PushingConfig, options, "here")
    assert made.mended == slide.Lacking(tilt_y=0.03)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": 0.5}, "mass = 0.5"),
        ({"declared": {"mu": 0.1}}, "no number 'e'"),
        (
            {"effects": [TILT | {"parameters": {"tilt_x": "much"}}]},
            "tilt_x.value = 'much' must be a finite number",
        ),
        ({"effects": {"tilt": 0.1}}, "must be a list of tables"),
        ({"schema": 1}, "written by adaptsim_jax 0.1"),
        ({"fricton": "clean"}, "unknown key 'fricton'"),
    ],
)
def test_a_file_that_is_amiss_is_refused_with_the_key(change, words):
    with pytest.raises(BadInput, match=words):
        of_model(MODEL | change, "model.toml")


@pytest.mark.slow
def test_it_is_trained_and_adapted_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config.write(tmp_path / "model.toml", MODEL)
    small = [
        "phase1.reuse.together=2",
        "phase1.reuse.capacity=2",
        "phase1.trajectories=4",
        "phase1.parallel=2",
        "phase1.updates=1",
        "phase1.capacity=96",
        "task.trials=100",
    ]
    small += [
        "task.pretrain=false",
        "task.refine=0",
        "task.correct=false",
        "task.show_gap=false",
        "task.rehearsal=[0, 0]",
    ]
    asked = [x for pair in small for x in ("--set", pair)]
    assert cli.main(["train", "pushing", "--run", "r", "--model", "model.toml", *asked]) == 0
    assert "latency is of the measurement" in capsys.readouterr().out
    assert cli.main(["adapt", "r", "--target", "fitted", "--starts", "1", "--iterations", "1"]) == 0
    result = json.loads(next((tmp_path / "r").glob("adapt-*/result.json")).read_text())
    assert result["target"]["params"]["mu"] == 0.12
    assert cli.main(["train", "scooping", "--run", "s", "--model", "model.toml"]) == 2


def test_a_target_may_lack_what_the_simulator_has_not():
    level, tilted = (
        make_one_shot("pushing", {}).world("planar", **settings)
        for settings in ({}, {"lacking": {"tilt_y": 0.03}})
    )
    goals, actions = np.array([[0.9, 0.0]]), np.zeros((1, 2), np.float32)
    places = [
        world.run(np.asarray(PARAMS)[None], goals, actions)[0][0, -1] for world in (level, tilted)
    ]
    assert places[1][1] > places[0][1] + 0.005
    mended = make_one_shot("pushing", {"mended": {"tilt_y": 0.03}}).world("planar")
    np.testing.assert_allclose(
        mended.run(np.asarray(PARAMS)[None], goals, actions)[0][0, -1], places[1], atol=1e-6
    )
