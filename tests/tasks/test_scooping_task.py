"""Scooping as a task: what it observes and rewards, the bank, and Phase 1 and 2 on it."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adapt.phase1 import Phase1Config, make_phase1
from adaptsim_jax.adapt.presets import default_config
from adaptsim_jax.adapt.reuse import ReuseConfig
from adaptsim_jax.adapt.training import traced
from adaptsim_jax.errors import BadInput
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.space import PLUS, STAY, gaussian, step
from adaptsim_jax.tasks import scooping, scooping_bank
from adaptsim_jax.tasks.registry import make_task
from adaptsim_jax.tasks.scooping import ScoopingConfig, make_scooping

SHORT = ScoopingConfig(
    trials=60, tests=2, hidden=(16,), training=GoalConfig(block=20, updates=5, batch=16, capacity=60, candidates=4)
)


def test_contexts_lie_in_the_papers_box():
    drawn = np.asarray(jax.vmap(scooping.draw_context)(jax.random.split(jax.random.key(0), 2000)))
    for contexts in (drawn, scooping.test_contexts(64)):
        assert np.all(np.abs(contexts[:, :2]) <= scooping.PLACES) and np.all(np.abs(contexts[:, 2:4]) <= 1)
        assert np.all((contexts[:, 4] >= 0) & (contexts[:, 4] < 1)) and np.abs(contexts[:, :4].mean(0)).max() < 0.1
        assert contexts[:, 0].std() == pytest.approx(0.04 / np.sqrt(3), rel=0.1)


def test_errors_of_execution_are_added_to_pitch_and_rate():
    context = jnp.array([0.01, 0.0, 1.0, -0.5, 0.3])
    done = scooping.executed(jnp.zeros(3), context, ScoopOptions(noise=(0.012, 0.04, 0.0)))
    np.testing.assert_allclose(done, [np.radians(6) + 0.012, -0.02, 0.0125], rtol=1e-5)


def test_the_camera_blurs_ahead_and_is_the_same_for_the_same_context():
    points = jnp.zeros((8, 2))
    contexts = jax.vmap(scooping.draw_context)(jax.random.split(jax.random.key(1), 500))
    seen = np.asarray(jax.vmap(lambda c: scooping.camera_view(points, c, (0.002, 0.002)))(contexts))
    np.testing.assert_allclose(seen.mean((0, 1)), [0.002, 0.0], atol=1e-4)
    np.testing.assert_allclose(seen.std((0, 1)), [0.002, 0.002], rtol=0.05)
    np.testing.assert_array_equal(seen[0], scooping.camera_view(points, contexts[0], (0.002, 0.002)))


def test_a_piece_lost_from_sight_is_no_success_and_no_nan_to_a_network():
    outcomes = jnp.full((2, 9, 2), jnp.nan).at[1].set(1e6)
    trajectory = scooping.measured(jnp.zeros((2, 5)), outcomes, (0.0, 0.0))
    assert trajectory.success.tolist() == [0.0, 1.0] and np.isfinite(scooping.observed(trajectory)).all()


def test_rollout_is_the_engines_trial_of_the_policys_action():
    """One program for both, so that nothing is compiled twice: the task's rollout beside its own trials."""
    task, naf = make_scooping(SHORT), scooping.make_scooping_naf(SHORT)
    policy = task.init_policy(jax.random.key(3))
    params = jnp.asarray(task.space.values(task.settings["ood-3"]), jnp.float32)
    trial = scooping.make_trial(scooping.checked(SHORT), SHORT.numerics)

    @jax.jit
    def both(key, params):
        contexts = jax.vmap(scooping.draw_context)(jax.random.split(key, 2))
        every = jnp.concatenate([contexts, jnp.asarray(scooping.test_contexts(2))])
        actions = naf.greedy(policy.weights, scooping.seen_place(every))
        return task.rollout(key, policy, params), jax.vmap(trial, (None, 0, 0))(params, actions, every), every

    got, outcomes, contexts = both(jax.random.key(1), params)
    assert got.points.shape == (2, 8, 2) and task.observe(got).shape == (32,) == (task.obs_dim,)
    np.testing.assert_allclose(got.points, jax.vmap(lambda o, c: scooping.camera_view(o[:-1], c, SHORT.camera))(
        outcomes[:2], contexts[:2]), atol=1e-4)  # fmt: skip
    np.testing.assert_allclose(got.success, scooping.success(outcomes[:2]))
    np.testing.assert_allclose(got.tested, scooping.success(outcomes[2:]).mean())
    x = np.asarray(outcomes[:, :-1, 0])
    assert np.all(np.abs(x[:, 0]) < 1e-6) and np.all(x[:, -1] > 0.03)  # it lies still, and is carried or pushed ahead


def test_the_bank_is_of_this_engine():
    """Outcomes in the file against the engine, for a few of its trials; and the network against all of them."""
    with np.load(scooping_bank.PATH, allow_pickle=False) as file:
        about, wins = json.loads(str(file["about"])), file["wins"]
    wins = np.unpackbits(wins)[: about["count"]].astype(bool)
    params, actions = scooping_bank.points(about["count"], about["seed"])
    some = slice(0, 64)
    again, codes = scooping_bank.simulate(params[some], actions[some], ScoopOptions(), Numerics())
    assert (
        np.mean(again == wins[some]) >= 0.95 and np.mean(codes == model.FINE) > 0.95
    )  # other processors round otherwise
    bank = scooping_bank.load_bank(ScoopOptions(), Numerics())
    logit = np.asarray(jax.jit(jax.vmap(bank.logit))(*(jnp.asarray(v, jnp.float32) for v in (params, actions))))
    likelier = max(wins.mean(), 1 - wins.mean())
    assert np.mean((logit > 0) == wins) > likelier + 0.15
    assert abs(np.mean(1 / (1 + np.exp(-logit))) - wins.mean()) < 0.02
    assert about["accuracy"] > 0.8


def test_a_bank_of_other_options_is_refused():
    with pytest.raises(BadInput, match="another bank"):
        make_scooping(replace(SHORT, clearance=1e-3))
    with pytest.raises(BadInput, match="another bank"):
        make_scooping(replace(SHORT, numerics=Numerics(relaxation=0.1)))
    assert make_scooping(replace(SHORT, clearance=1e-3, source="simulator")).name == "scooping"


def test_features_span_omega_and_the_actions():
    low = scooping_bank.features(jnp.asarray(model.LOW), jnp.asarray(model.ACTION_LOW))
    high = scooping_bank.features(jnp.asarray(model.HIGH), jnp.asarray(model.ACTION_HIGH))
    np.testing.assert_allclose(low, -np.ones(7), atol=1e-5)
    np.testing.assert_allclose(high, np.ones(7), atol=1e-5)


@pytest.mark.slow
def test_phase_1_with_reused_policies(monkeypatch):
    """Shapes are never lent across, and means of E are shapes. The engine, tested above, is replaced by a rule that compiles
    fast: low pitches scoop ellipsoids, high ones the others."""

    def make_trial(options, numerics):
        def trial(params, action, context):
            pitch = scooping.executed(action, context, options)[0]
            won = jnp.where(params[2] == 0, pitch < 0.08, pitch > 0.1) * 1.0
            places = jnp.arange(8.0)[:, None] * jnp.array([[0.02, 0.0]])
            return jnp.concatenate([places, jnp.stack([won, 0.01 * won])[None]])

        return trial

    monkeypatch.setattr(scooping, "make_trial", make_trial)
    task = make_scooping(SHORT)
    sizes = Phase1Config(
        trajectories=8, parallel=4, horizon=2, updates=2, batch=8, capacity=16, archive=16, hidden=(16,),
        reuse=ReuseConfig(threshold=0.5, first=60, most=90, least=20, capacity=40, together=4),
    )  # fmt: skip
    phase1 = make_phase1(task, sizes)
    hyper = traced(default_config("scooping").hyper)
    state, info = jax.jit(phase1.run)(jax.jit(phase1.init)(jax.random.key(0)), hyper, jnp.arange(2))
    assert np.all((info.reward >= 0) & (info.reward <= 1)) and info.reward.mean() > 0
    assert set(np.unique(np.asarray(state.archive.mean)[:, 2])) == {0.0, 1.0}
    owners = np.asarray(state.pool.mean)[: int(state.pool.count)]
    assert info.reused[1] > 0.2 and set(np.unique(owners[:, 2])) == {0.0, 1.0}


def test_shapes_are_categories():
    space = scooping.scooping_space()
    drawn = np.asarray(space.sample(jax.random.key(0), (400,)))
    assert set(np.unique(drawn[:, 2])) == {0.0, 1.0} and 0.4 < drawn[:, 2].mean() < 0.6
    wide = np.asarray(scooping.wide_space().physical(scooping.wide_space().sample(jax.random.key(0), (600,))))
    assert np.bincount(wide[:, 2].astype(int)).min() > 150
    dist = gaussian(space, jnp.array([0.5, 0.5, 0.3, 0.5]))
    assert dist.mean[2] == 0.0
    moved = step(space, dist, jnp.array([STAY, PLUS, PLUS, STAY]), 0.15).mean
    np.testing.assert_allclose(moved, [0.5, 0.65, 1.0, 0.5], atol=1e-6)


def test_settings_are_physical_and_only_what_the_paper_bolds_is_outside():
    task = make_scooping(SHORT)
    outside = {
        name: {p for p, u in zip(task.space.names, np.asarray(task.space.unit(task.space.values(s))), strict=True)
               if not -1e-4 <= u <= 1 + 1e-4}
        for name, s in task.settings.items()
    }  # fmt: skip
    assert outside == {"wd": set(), "ood-1": {"mu", "h"}, "ood-2": {"mu"}, "ood-3": {"e", "h"}, "ood-4": {"g"}}
    assert task.space.names == model.PARAMETERS


@pytest.mark.parametrize(
    "options, says",
    [({"trails": 3}, "trials"), ({"tests": 0}, "tests = 0"), ({"source": "x"}, "bank"), ({"camera": [0.1]}, "camera"),
     ({"numerics": {"dt": 0.0033}}, "dt")],
)  # fmt: skip
def test_bad_options_are_refused(options, says):
    with pytest.raises(BadInput, match=says):
        make_task("scooping", options)
