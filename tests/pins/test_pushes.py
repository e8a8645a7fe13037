"""What a search of pushes does, step by step, on a linear problem with the columns of simulated
pushes: whole ones take minutes.
"""

import json
from functools import partial

import jax
import numpy as np
import pytest

from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.tasks.pushing import model, slide
from adaptsim_jax.tasks.pushing.diagnosis.catalogue import DECLARED, QUANTITIES, effects_of
from adaptsim_jax.tasks.pushing.diagnosis.diagnose import CRITERIA
from adaptsim_jax.tasks.pushing.diagnosis.problem import prepare
from adaptsim_jax.tasks.pushing.diagnosis.read import read
from tests.pins.stored import FOLDER, check
from tests.pins.test_searches import LOOSE, told
from tests.tasks.pushing.test_diagnosis import ACTIONS, written

COLUMNS = "push_columns"
EVERY = 11  # rows, of which one is stored
NAMES = tuple(q.name for q in QUANTITIES)
EFFECTS = effects_of(False)
SHAPES = {name for e in EFFECTS for shape in e.points for name in shape}
PUSH = {"mu": 0.12, "log_e": float(np.log10(5e4)), "mu_p": 0.4, "y_p": 0.03}
AT = PUSH | {
    "spin": 1.0,
    "com_x": 0.003,
    "com_y": -0.002,
    "other_mu": 0.2,
    "other_y": 0.07,
    "grain_a": 0.1,
}
"""Where columns are taken: every quantity has one there."""
TRUTHS = {
    "nothing": {"mu": 0.01},
    "tilt": {"mu": 0.01, "tilt_x": 0.02, "tilt_y": -0.03},
    "two": {"start_y": 0.01, "drag": 0.6},
    "class": {"latency": 0.004},
    "ended": {"patch_size": 0.004, "grain_a": 0.05},
    "speeds": {"speed_offset": 0.008, "speed_scale": -0.01},
    "small": {"tilt_x": 0.003, "heading_offset": 0.004, "drag": 0.04},
}


def values_of(named: dict[str, float]) -> np.ndarray:
    """Values [P], neutral but for those named."""
    return np.array([named.get(q.name, q.default) for q in QUANTITIES])


@pytest.mark.long
def test_columns_of_pushes_are_those_stored(tmp_path):
    inner = dict(zip(model.PARAMETERS, (0.12, 5e4, 0.4, 0.03), strict=True))
    rows = jax.jit(jax.vmap(partial(slide.rollout, inner)))(ACTIONS.astype(np.float32))
    tracks = np.asarray(rows, float)[:, ::4, :2]
    noise = 5e-4 * np.random.default_rng(3).standard_normal(tracks.shape)
    pushed = read(written(tmp_path / "log", tracks + noise))
    problem = prepare(pushed, pushed.options, pushed.coefficients, EFFECTS)
    scale = np.array([q.scale for q in QUANTITIES])
    columns = problem.columns(values_of(AT), np.diag(scale))
    some = columns.reshape(len(ACTIONS), -1, 2, len(NAMES))[:, ::EVERY]
    rounded = {n: [float(f"{z:.4g}") for z in some[..., i].ravel()] for i, n in enumerate(NAMES)}
    check(COLUMNS, rounded, 1e-2)


def pushes(truth: dict[str, float]) -> Problem:
    """Pushes [T, R] that are linear in what they may lack, in units of their noise. A shape, such
    as a place on the table, changes nothing.
    """
    stored = json.loads((FOLDER / f"{COLUMNS}.json").read_text())
    columns = np.stack([np.array(stored[q.name]) / q.scale for q in QUANTITIES], -1)
    columns[:, [n in SHAPES for n in NAMES]] = 0.0
    columns = columns.reshape(len(ACTIONS), -1, len(NAMES))
    middle = values_of(PUSH)
    missing = np.array([truth.get(name, 0.0) for name in NAMES])
    noise = np.random.default_rng(7).standard_normal(columns.shape[:2])
    seen = columns @ missing + noise
    return Problem(
        QUANTITIES,
        DECLARED,
        EFFECTS,
        lambda values: seen - np.einsum("trk,tk->tr", columns, values - middle),
        lambda values, basis: columns @ basis.T,
        np.full(len(ACTIONS), float(columns.shape[1])),
        tuple(map(str, range(len(ACTIONS)))),
        middle[None],
        channels=2,
        again=DECLARED,
    )


@pytest.mark.parametrize("name", TRUTHS)
def test_pushes_are_searched_the_same(name):
    problem = pushes(TRUTHS[name])
    check(f"search_pushes_{name}", told(search_trials(problem, CRITERIA)), LOOSE)
