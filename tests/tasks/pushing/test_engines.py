"""The engines of the push: physics that must hold, and agreement between them.

MJX and native MuJoCo solve the same scene; float32 moves a bottle by hundredths of a millimetre
(docs/results/pushing.md). The planar model leaves out pitch and yaw, which costs some millimetres;
Drake has another law of contact, which costs centimetres.
"""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing import planar as pushing_planar
from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.model import PAPER
from experiments import pushing_fit


@pytest.fixture(scope="module")
def batch():
    return pushing.draw(seed=3, samples=12)


@pytest.fixture(scope="module")
def native():
    return make_backend("native").simulate


@pytest.fixture(scope="module")
def reference(native, batch):
    return native(*batch)


def apart(a, b):
    """Distance of final positions, mm."""
    return 1e3 * np.linalg.norm(
        np.asarray(a.state)[:, -1, :2] - np.asarray(b.state)[:, -1, :2], axis=1
    )


def test_bottles_go_along_the_push_and_stay_upright(reference, batch):
    _, actions, starts = batch
    assert reference.state.shape == (12, 130, 13) and not reference.code.any()
    heading = np.stack([np.cos(actions[:, 1]), np.sin(actions[:, 1])], -1)
    gone = reference.state[:, -1, :2] - starts
    across = gone[:, 0] * heading[:, 1] - gone[:, 1] * heading[:, 0]
    assert np.all((gone * heading).sum(1) > 0.1) and np.abs(across).max() < 1e-3
    assert np.abs(reference.state[:, :, 2] - 0.05).max() < 2e-3  # it neither hops nor sinks


@pytest.mark.parametrize("name", ["native", "planar"])
def test_sliding_loses_the_energy_that_friction_takes(name, batch):
    """After the push, v^2 of the centre of mass falls by 2 mu g s; the patch is far away."""
    params, actions, starts = (a.copy() for a in batch)
    params[:, 3] = 0.9
    out = make_backend(name).simulate(params, actions, starts).state
    rows = slice(81, None)
    down = PAPER.com[2]  # the bottle is hit above its centre of mass, and nods for a while
    velocity = out[:, rows, 7:9] + down * np.stack([out[:, rows, 11], -out[:, rows, 10]], -1)
    place = out[:, rows, :2] + 2 * down * np.stack([out[:, rows, 5], -out[:, rows, 4]], -1)
    speed = np.linalg.norm(velocity, axis=-1)
    lost = (speed[:, 0] ** 2 - speed[:, -1] ** 2) / 2
    way = np.linalg.norm(place[:, -1] - place[:, 0], axis=-1)
    moving = way > 0.02
    assert moving.sum() >= 3
    np.testing.assert_allclose(
        lost[moving], (params[:, 0] * pushing.GRAVITY * way)[moving], rtol=0.03
    )
    assert np.all(np.diff(speed, axis=1) < 1e-3)  # nothing pushes any more


def test_every_parameter_reaches_native_and_planar(native, batch):
    """A change of any one moves the bottle, and to the same side in both: more friction, or a patch
    nearer, brakes.
    """
    params = np.array([[0.1, 1e5, 0.4, 0.06]])
    changed = np.array(
        [
            [0.13, 1e5, 0.4, 0.06],
            [0.1, 1e6, 0.4, 0.06],
            [0.1, 1e5, 0.7, 0.06],
            [0.1, 1e5, 0.4, 0.03],
        ]
    )
    every = np.concatenate([params, changed])
    actions, starts = np.tile([[0.7, 0.0]], (5, 1)), np.tile(pushing.START, (5, 1))
    for simulate in (native, make_backend("planar").simulate):
        x = simulate(every, actions, starts).state[:, -1, 0]
        moved = x[1:] - x[0]
        assert abs(moved[1]) > 1e-3 and np.all(moved[[0, 2, 3]] < -5e-3)


def test_planar_is_near_native(reference, batch):
    out = make_backend("planar").simulate(*batch)
    assert not out.code.any() and out.state.shape == reference.state.shape
    assert np.median(apart(out, reference)) < 6 and apart(out, reference).max() < 60


@pytest.mark.slow
def test_calibration_finds_a_spring_again():
    """Pushes of a planar model with other coefficients: the fit must come back to millimetres from
    centimetres.
    """
    truth = pushing_planar.DEFAULT._replace(
        elasticity=pushing.ElasticityMap((4.4, 0.3, 0.0), (-0.9, 0.3, 0.0)), lift=0.1
    )
    observed = pushing_fit.observe(make_backend("planar", coefficients=truth), seed=5, samples=40)
    before = pushing_fit.fit_planar(observed, rounds=1)
    after = pushing_fit.fit_planar(observed, rounds=400)
    assert before.held_out[0] > 0.004
    assert after.held_out[0] < 0.25 * before.held_out[0]


def test_calibration_wants_enough_pushes():
    with pytest.raises(BadInput, match="0 of 4 pushes of planar are usable"):
        params, actions, starts = pushing.draw(0, 4)
        bad = make_backend("planar")._replace(
            simulate=lambda *_: make_backend("planar").simulate(params * np.nan, actions, starts)
        )
        pushing_fit.observe(bad, 0, 4)


def test_planar_rollout_is_pure_and_traced_once(batch):
    params, actions, _ = (jnp.asarray(a, jnp.float32) for a in batch)
    run = jax.jit(jax.vmap(pushing_planar.rollout))
    first = run(params, actions)
    assert first.shape == (12, 130, 2) and first.dtype == jnp.float32
    run(params[::-1], actions)
    assert run._cache_size() == 1

    def final(action):
        return pushing_planar.rollout(params[0], action)[-1, 0]

    _, slope = jax.jit(lambda a: jax.jvp(final, (a,), (jnp.array([1.0, 0.0]),)))(actions[0])
    assert 0.1 < float(slope) < np.inf  # faster goes further


def test_a_start_moves_the_path(batch):
    params, actions, starts = batch
    moved = pushing_planar.rollout(params[0], actions[0], start=starts[0] + np.array([0.01, 0.0]))
    assert float(moved[0, 0]) == pytest.approx(starts[0, 0] + 0.01, abs=1e-6)
    assert float(moved[0, 1]) == pytest.approx(starts[0, 1], abs=1e-6)


@pytest.mark.parametrize("name", ["native", "planar"])
def test_one_bad_sample_is_told_and_spares_the_others(name, batch, reference):
    params, actions, starts = (a.copy() for a in batch)
    params[2, 0], actions[5, 1], params[7, 1] = np.nan, 3.0, -1.0
    out = make_backend(name).simulate(params, actions, starts)
    bad = np.array([2, 5, 7])
    assert np.all(out.code[bad] == pushing.UNFIT) and not np.delete(out.code, bad).any()
    assert np.isfinite(out.state).all()
    if name == "native":
        np.testing.assert_allclose(
            np.delete(out.state, bad, 0), np.delete(reference.state, bad, 0), atol=1e-9
        )


def test_a_bottle_of_true_inertia_falls(batch):
    """With a cylinder's inertia and its centre of mass at half height, a hit at the foot tips it
    (147 of 200 in Drake).
    """
    true = dataclasses.replace(PAPER, inertia=pushing.cylinder_inertia(0.3), com=(0.0, 0.0, 0.0))
    out = make_backend("native", true).simulate(*batch)
    assert (out.code == pushing.FALLEN).sum() >= 4 and np.isfinite(out.state).all()
    with pytest.raises(BadInput, match="only slides; use backend native, mjx or drake"):
        make_backend("planar", true)


def test_heavy_and_light_bottles_go_elsewhere_and_turn(batch, reference):
    for options, turned in ((pushing.HEAVY, 0.1), (pushing.LIGHT, 0.02)):
        out = make_backend("native", options).simulate(*batch)
        assert not out.code.any() and np.median(apart(out, reference)) > 10
        assert np.abs(2 * out.state[:, -1, 6]).max() > turned


def test_the_number_of_threads_changes_nothing(native, batch, reference):
    one = make_backend("native", threads=1).simulate(*batch)
    np.testing.assert_allclose(one.state, reference.state, atol=1e-9)


@pytest.mark.slow
def test_mjx_agrees_with_native_and_is_traced_once(batch, reference, monkeypatch):
    traces = []
    real = pushing.ground_friction
    monkeypatch.setattr(pushing, "ground_friction", lambda *a: (traces.append(1), real(*a))[1])
    simulate = make_backend("mjx").simulate
    out = simulate(*batch)
    assert out.state.dtype == np.float32 and not out.code.any()
    assert np.median(apart(out, reference)) < 0.05 and apart(out, reference).max() < 2.0
    traced = len(traces)
    simulate(*(a[::-1] for a in batch))
    assert len(traces) == traced > 0


@pytest.mark.parametrize("name", ["native", "drake"])
def test_a_table_that_is_not_level_draws_the_bottle_aside(name):
    """As the planar slide has it, within a quarter: pushes that are still on their way after a
    second.
    """
    if name == "drake":
        pytest.importorskip("pydrake")
    tilt = 0.03
    gravity = (0.0, pushing.GRAVITY * np.sin(tilt), -pushing.GRAVITY * np.cos(tilt))
    batch = (
        np.array([[0.12, 1e5, 0.3, 0.9]] * 2),
        np.array([[0.7, 0.0], [0.8, -0.2]]),
        np.tile(pushing.START, (2, 1)),
    )
    level, turned = (
        make_backend(name, **given).simulate(*batch) for given in ({}, {"gravity": gravity})
    )
    slides = [
        make_backend("planar", lacking=lacking).simulate(*batch)
        for lacking in ({}, {"tilt_y": tilt})
    ]

    def aside(pair):
        return (pair[1].state - pair[0].state)[:, -1, 1]

    np.testing.assert_allclose(aside((level, turned)), aside(slides), rtol=0.25)
    assert (
        np.abs(turned.state[:, 15, :2] - pushing.START).max() < 1e-3
    )  # friction holds it until the plate comes


@pytest.mark.slow
def test_drake_is_near_native(native, batch):
    """Three pushes; another contact law and no fit to them: see docs/results/pushing.md for two
    hundred.
    """
    pytest.importorskip("pydrake")
    few = tuple(a[:3] for a in batch)
    out = make_backend("drake").simulate(*few)
    assert not out.code.any() and out.state.shape == (3, 130, 13)
    assert np.median(apart(out, native(*few))) < 60
    np.testing.assert_allclose(np.linalg.norm(out.state[:, :, 3:7], axis=-1), 1, atol=1e-9)


def test_drake_that_is_not_there_says_what_to_install(monkeypatch):
    real = importlib.import_module

    def absent(name):
        return (
            (_ for _ in ()).throw(ImportError(name)) if name.startswith("pydrake") else real(name)
        )

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(BadInput, match=r"pip install 'adaptsim_jax\[drake\]'"):
        make_backend("drake")


def test_drake_refuses_steps_that_miss_the_rows():
    pytest.importorskip("pydrake")
    from adaptsim_jax.tasks.pushing.engines.drake import PushContact

    with pytest.raises(BadInput, match="must divide the row"):
        make_backend("drake", contact=PushContact(dt=0.003))
    with pytest.raises(BadInput, match="use one of lagged, tamsi"):
        make_backend("drake", contact=PushContact(solver="implicit"))
