"""The comparison of methods whose policies are learned, on a probe with known answers, and the push
in more than one engine.
"""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig
from adaptsim_jax.baselines.arena import Arena, lanes
from adaptsim_jax.baselines.bayesopt import BayesOptConfig
from adaptsim_jax.baselines.compare import compare, compared
from adaptsim_jax.baselines.compare_learned import LearnedComparison, on_fresh
from adaptsim_jax.baselines.config import CompareConfig, default_comparison
from adaptsim_jax.baselines.direct import DirectConfig
from adaptsim_jax.baselines.mdn import FitConfig
from adaptsim_jax.baselines.registry import learned_methods
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.report.comparison import table, write_comparison
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.one_shot import action_grid, best_actions
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.task import PushingConfig
from tests.baselines import one_shot_probe as probes

METHODS = tuple(
    m for m in learned_methods() if m != "sysid_bayes"
)  # the same loop as SysID-Point with a dearer network
TINY = CompareConfig(
    methods=METHODS,
    seeds=2,
    iterations=2,
    train=TrainConfig(
        phase1=Phase1Config(
            trajectories=100, parallel=50, horizon=3, updates=5, capacity=300, archive=300
        )
    ),
    sysid=SysIdConfig(
        simulations=500,
        hidden=(32,),
        first_fit=FitConfig(updates=800),
        next_fit=FitConfig(updates=800),
    ),
    direct=DirectConfig(budgets=(0, 2, 16), updates=300, grid=101),
    bayesopt=BayesOptConfig(initial=4),
)


@pytest.fixture(scope="module")
def found():
    return compared(LearnedComparison(probes.probe(), ["wd", "ood-1"], TINY))


def cell(found, method, setting):
    return next(r for r in found[0] if (r["method"], r["setting"]) == (method, setting))


@pytest.mark.slow
def test_every_method_has_a_row_in_every_setting(found):
    assert [(r["method"], r["setting"]) for r in found[0]] == [
        (m, s) for m in METHODS for s in ("wd", "ood-1")
    ]
    for r in found[0]:
        assert len(r["per_seed"]) == 2 and 0.0 <= r["low"] <= r["mean"] <= r["high"] <= 1.0
        assert r["oracle"] > 0.99
    json.dumps(found, allow_nan=False)


def test_what_the_probe_allows(found):
    """gain 1.4 is within Omega: identified; 2.6 is not: the best that Omega has is 2.0, 1.5 is what
    UDR believes.
    """
    assert cell(found, "sysid_point", "wd")["mean"] > 0.95 > cell(found, "udr", "wd")["mean"]
    away = np.abs(probes.TESTS).mean()
    assert cell(found, "udr", "ood-1")["mean"] == pytest.approx(
        1 - np.mean(np.abs(probes.TESTS * (2.6 / 1.5 - 1) + 0.1)), abs=1e-5
    )
    best_of_omega = 1 - 0.3 * away
    assert cell(found, "bayesopt", "ood-1")["mean"] <= best_of_omega + 0.02
    assert (
        cell(found, "udr_target", "ood-1")["final_mean"]
        > 0.99
        > cell(found, "udr_target", "ood-1")["curve"]["mean"][0]
    )
    assert cell(found, "learn_in_target", "ood-1")["final_mean"] > 0.9


def test_target_trials_are_counted(found):
    spent = {m: cell(found, m, "wd").get("trials") for m in METHODS}
    assert spent["adaptsim"] == [4, 8, 12] and spent["sysid_point"] == [2, 4, 6]
    assert spent["bayesopt"] == [2, 4, 6, 8, 10, 12] and spent["udr"] == [0]
    assert spent["udr_target"] == spent["learn_in_target"] == [0, 2, 16]
    assert cell(found, "sysid_point", "wd")["target_trials"] == 6
    # trials of the method, and five test contexts for every policy that was scored, of two seeds
    assert cell(found, "learn_in_target", "wd")["made"] == 2 * (16 + 3 * 5)


def test_the_same_numbers_again_and_other_methods_do_not_matter(found):
    few = CompareConfig(**{**vars(TINY), "methods": ("sysid_point",)})
    again, _ = compared(LearnedComparison(probes.probe(), ["wd", "ood-1"], few))
    assert again[1]["per_seed"] == cell(found, "sysid_point", "ood-1")["per_seed"]


@pytest.fixture(scope="module")
def found_fresh():
    few = CompareConfig(**{**vars(TINY), "methods": ("adaptsim", "udr", "learn_in_target")})
    one = replace(probes.probe(), fresh=np.array([[0.0], [1.0]], np.float32))
    return compared(LearnedComparison(one, ["wd", "ood-1"], few))


def test_fresh_contexts_score_what_others_chose_and_change_nothing_else(found, found_fresh):
    for r in found_fresh[0]:
        plain = cell(found, r["method"], r["setting"])
        assert (
            "fresh" not in plain
            and r["per_seed"] == plain["per_seed"]
            and r["curve"] == plain["curve"]
        )
        assert (
            len(r["fresh"]["per_seed"]) == 2
            and r["fresh"]["low"] <= r["fresh"]["mean"] <= r["fresh"]["high"]
        )
    # UDR believes in a gain of 1.5 and no bias: in 1.4 and 0.1 it lands at 0.1 for 0, and at 1.4 /
    # 1.5 + 0.1 for 1
    assert cell(found_fresh, "udr", "wd")["fresh"]["mean"] == pytest.approx(
        1 - (0.1 + 0.1 - 0.1 / 1.5) / 2, abs=1e-5
    )
    assert (
        cell(found_fresh, "udr", "wd")["fresh"]["final_mean"]
        == cell(found_fresh, "udr", "wd")["fresh"]["mean"]
    )
    text = table(
        {
            **found_fresh[1],
            "seeds": 2,
            "iterations": 2,
            "starts": 2,
            "command": "",
            "rows": found_fresh[0],
        }
    )
    assert "in fresh contexts, by which none was chosen" in text


def test_of_several_best_policies_the_fresh_mean_counts():
    rewards = np.array([[[0.5, 1.0, 1.0]], [[0.2, 0.1, 0.0]]])  # [S, N, I + 1]
    fresh = np.array([[[0.9, 0.6, 0.8]], [[0.3, 0.7, 0.5]]])
    told = on_fresh(rewards, fresh)
    np.testing.assert_allclose(told["per_seed"], [0.7, 0.3])
    np.testing.assert_allclose([told["mean"], told["final_mean"]], [0.5, 0.65])


def test_trials_that_fail_earn_nothing_and_are_counted():
    arena = Arena(probes.probe(), probes.probe_world(0.5), np.array([[1.4, 0.1]]))
    policies = jnp.tile(jnp.array([1.4, 0.1]), (3, 1))
    where = np.zeros(3, int)
    np.testing.assert_allclose(
        arena.score(where, policies), 4 / 5, atol=1e-6
    )  # the test at 0.8 lands too far
    assert (arena.failed.tolist(), arena.made.tolist()) == ([3], [15])
    seen = arena.visit(lanes(1, np.arange(3), 1, 0).keys, where, policies)
    assert np.isfinite(seen.obs).all() and np.isfinite(seen.score).all()


def test_training_in_groups_is_training_all():
    arena = Arena(probes.probe(), probes.probe_world(), np.array([[1.4, 0.1]]))
    batch = lanes(1, np.arange(13), 1, 0)
    means = np.random.default_rng(0).uniform(size=(13, 2)).astype(np.float32)
    dists = jax.vmap(lambda m: gaussian(probes.SPACE, m))(jnp.asarray(means))
    trained = arena.train(batch.keys, dists, arena.untrained(batch.keys))
    np.testing.assert_allclose(trained, probes.SPACE.physical(means), atol=1e-6)


def test_the_grids_best_actions_by_hand_and_refined():
    """The best action for a context is (context - bias) / gain; one grid for all is a grid for
    each.
    """
    params = np.array([2.0, 0.0])
    coarse, actions = best_actions(
        probes.probe_world(), params, probes.TESTS, probes.reward, (5,), shared=True
    )
    np.testing.assert_allclose(actions[:, 0], [-0.5, 0.0, 0.0, 0.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(coarse, [0.8, 0.6, 1.0, 0.6, 0.8], atol=1e-6)
    each, _ = best_actions(probes.probe_world(), params, probes.TESTS, probes.reward, (5,))
    np.testing.assert_allclose(each, coarse, atol=1e-6)
    _, actions = best_actions(
        probes.probe_world(), params, probes.TESTS, probes.reward, (5,), rounds=6
    )
    np.testing.assert_allclose(actions[:, 0], probes.TESTS[:, 0] / 2, atol=0.5 / 2**6)
    assert action_grid((3, 2)).tolist() == [[-1, -1], [-1, 1], [0, -1], [0, 1], [1, -1], [1, 1]]


@pytest.fixture(scope="module")
def push():
    return make_pushing_one_shot(PushingConfig(trials=40, tests=6, hidden=(16,)))


def test_the_pushs_world_is_the_tasks_own_rollout(push):
    params = push.task.space.values(push.task.settings["ood-2"])
    arena = Arena(push, push.world("planar"), params[None])
    policies = arena.untrained(lanes(1, np.arange(2), 1, 0).keys)
    tested = jax.jit(
        jax.vmap(
            lambda p: (
                push.task.rollout(jax.random.key(0), p, jnp.asarray(params, jnp.float32)).tested
            )
        )
    )
    np.testing.assert_allclose(arena.score(np.zeros(2, int), policies), tested(policies), atol=1e-4)


def test_the_push_in_native_lands_near_planar_and_heavy_elsewhere(push):
    params = np.tile(push.task.space.values(push.task.settings["wd"]), (3, 1))
    actions = np.array([[-0.5, 0.0], [0.2, 0.3], [0.8, -0.5]], np.float32)
    ends = {}
    for name, options in {"planar": {}, "native": {}, "heavy": {"bottle": "heavy"}}.items():
        points, codes = push.world("native" if name == "heavy" else name, **options).run(
            params, np.zeros((3, 2)), actions
        )
        assert points.shape == (3, 6, 2) and not codes.any()
        ends[name] = points[:, -1]
    assert np.linalg.norm(ends["planar"] - ends["native"], axis=1).max() < 0.02
    assert np.linalg.norm(ends["heavy"] - ends["native"], axis=1).max() > 0.02


def test_a_push_that_cannot_be_made_is_not_a_number_with_a_code(push):
    points, codes = push.world("planar").run(
        np.array([[0.1, np.nan, 0.5, 0.0]]), np.zeros((1, 2)), np.zeros((1, 2))
    )
    assert np.isnan(points).all() and codes.tolist() == [model.UNFIT]


def test_tuning_leaves_a_policy_without_trials_and_moves_one_with_them(push):
    policy = push.task.init_policy(jax.random.key(0))
    goals, actions = (
        jnp.tile(jnp.array([0.8, 0.0]), (8, 1)),
        jax.random.uniform(jax.random.key(1), (8, 2), minval=-1.0),
    )
    points = jnp.tile(jnp.array([0.8, 0.0]), (8, 6, 1))
    tune = jax.jit(push.tune)
    same = tune(jax.random.key(2), policy, goals, actions, points, jnp.array(0))
    np.testing.assert_array_equal(same.weights, policy.weights)
    moved = tune(jax.random.key(2), policy, goals, actions, points, jnp.array(8))
    assert np.isfinite(moved.weights).all() and not np.allclose(moved.weights, policy.weights)


def test_what_compare_writes_says_what_a_reward_is(found, tmp_path):
    rows, about = found
    results = {
        "task": "probe",
        "seeds": 2,
        "iterations": 2,
        "starts": 2,
        "command": "none",
        "rows": rows,
    } | about
    results["versions"] = {"adaptsim_jax": "0", "jax": "0"}
    text = table(results)
    assert "1 - distance" in text and "LearnInTarget" in text and "Normalized" not in text
    paths = write_comparison(results, tmp_path / "out")
    assert all(p.stat().st_size > 100 for p in paths)
    assert "0 is UDR" not in paths[-1].read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    "task, change, says",
    [
        ("pushing", {"methods": ("gradient",)}, "learn_in_target"),
        ("pushing", {"target": "drak"}, "did you mean 'drake'"),
        ("pushing", {"target_options": {"bottle": "full"}}, "heavy"),
        ("pushing", {"target_options": {"bottle": {}}}, "heavy"),
        ("pushing", {"target_options": {"botle": "heavy"}}, "did you mean 'bottle'"),
        (
            "pushing",
            {"target_options": {"backend": "native"}},
            "unknown setting of planar 'backend'",
        ),
        ("pushing", {"target_options": {"coefficients": "darke"}}, "did you mean 'drake'"),
        ("pushing", {"target": "native", "target_options": {"dt": "fast"}}, "key 'dt' is 'fast'"),
        ("pushing", {"target": "native", "target_options": {"dt": 0.003}}, "must divide the row"),
        ("pushing", {"target": "native", "target_options": {"threads": 0}}, "threads = 0"),
        ("scooping", {"target_options": {"foo": 1}}, "unknown key 'foo'; known: numerics"),
        ("scooping", {"target_options": {"numerics": {"dt": 0.004}}}, "must divide the row"),
        (
            "scooping",
            {"target_options": {"numerics": {"dtt": 0.0025}}},
            "'numerics.dtt'; did you mean 'dt'",
        ),
        ("scooping", {"target": "mjx", "target_options": {"options": 1}}, "unknown key 'options'"),
        ("pushing", {"target": "planar", "target_options": {"bottle": "heavy"}}, "native"),
        ("pendulum", {"methods": ("bayesopt",)}, "not for pendulum"),
        ("pendulum", {"target": "drake"}, "leave target out"),
    ],
)
def test_what_cannot_be_compared_is_refused(task, change, says):
    with pytest.raises(BadInput, match=says):
        compare(
            task, CompareConfig(**{**vars(default_comparison(task)), "settings": ("wd",), **change})
        )


def test_sizes_that_make_no_sense_are_refused():
    for make in (
        lambda: DirectConfig(budgets=(4, 4)),
        lambda: DirectConfig(grid=0),
        lambda: BayesOptConfig(initial=1),
    ):
        with pytest.raises(BadInput):
            make()
