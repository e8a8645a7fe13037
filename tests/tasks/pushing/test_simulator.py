"""The push simulated in the MuJoCo scene from compiled code, with the planar twin as its guide."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.corrections import PushRecord, nearer, refine, search
from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.engines.served import make_served, served_seconds
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing


def GUIDE(a):
    return jnp.stack([0.8 + 0.2 * a[0] + 0.03 * a[0] ** 2, 0.1 * a[1]])


def PUSH(a):
    return 1.05 * GUIDE(a) + jnp.array([0.01, -0.005]) + 0.01 * jnp.sin(3 * a)


def test_served_pushes_are_the_native_engines_whatever_the_batch_axes():
    params, actions, starts = model.draw(3, 12)
    params[5, 0] = np.nan
    push = make_served(model.PAPER, 6)
    params32, actions32 = (jnp.asarray(x, jnp.float32) for x in (params, actions))
    found = jax.jit(jax.vmap(jax.vmap(push)))(params32.reshape(3, 4, 4), actions32.reshape(3, 4, 2))
    expected = make_backend("native").simulate(np.asarray(params32), np.asarray(actions32), starts)
    rows = [21, 42, 64, 86, 107, 129]  # a sixth, a third, ... of 130
    places = np.where(
        (expected.code == model.FINE)[:, None, None], expected.state[:, rows, :2], np.nan
    )
    np.testing.assert_allclose(np.asarray(found).reshape(12, 6, 2), places, atol=1e-6)
    assert np.isnan(found[1, 1]).all() and served_seconds() > 0.0
    # one set of parameters for several actions, as where a policy is tried
    shared = jax.jit(lambda p, a: jax.vmap(lambda x: push(p, x))(a))(
        params32[0], jnp.stack([actions32[0]] * 2)
    )
    np.testing.assert_allclose(shared[:, -1], np.stack([places[0, -1]] * 2), atol=1e-6)


@pytest.mark.long
def test_a_visit_in_the_native_scene_reaches_its_goals_where_the_target_is_e():
    options = {"pretrain": True, "refine": 3, "tests": 1, "hidden": (8,), "show_gap": True}
    task = make_pushing(PushingConfig(simulator="native", **options))
    policy = task.init_policy(jax.random.key(0))
    seen = jax.jit(task.rollout)(jax.random.key(1), policy, task.space.physical(policy.at))
    np.testing.assert_array_equal(
        seen.points, seen.expected
    )  # the same pushes at the same parameters
    assert np.linalg.norm(seen.points[:, -1] - seen.goals, axis=-1).max() < 0.002


def test_a_guide_takes_the_steps_and_the_simulator_judges():
    goal, start = jnp.array([0.95, 0.03]), jnp.array([-0.5, 0.5])

    def apart(n):
        return float(jnp.linalg.norm(PUSH(refine(PUSH, goal, start, n, GUIDE)) - goal))

    assert apart(1) > 0.02 and apart(2) < 0.01 and apart(3) < 0.003

    # one trial asks nothing of the simulator
    def never(a):
        return 1 / 0

    np.testing.assert_array_equal(
        refine(never, goal, start, 1, GUIDE), refine(PUSH, goal, start, 1, GUIDE)
    )
    # pushes that fail in the simulator leave the guide's solution
    failed = refine(lambda a: jnp.full(2, jnp.nan), goal, start, 3, GUIDE)
    np.testing.assert_array_equal(failed, refine(PUSH, goal, start, 1, GUIDE))
    found = search(PUSH, goal[None], start[None], 3, True, GUIDE)
    assert float(jnp.linalg.norm(PUSH(found[0]) - goal)) < 0.003


def test_slopes_of_a_guide_lead_to_parameters_that_the_simulator_explains():
    def end(u, a):
        return jnp.stack([0.7 + 0.3 * u[0] * (1 + 0.5 * a[0]), 0.1 * a[1] + 0.05 * u[1]])

    def guide(u, a):
        return 0.9 * end(u, a) + 0.02

    actions = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (6, 2)), jnp.float32)
    truth, mean = jnp.array([0.6, 0.4, 0.5, 0.5]), jnp.full(4, 0.5)
    told = PushRecord(actions, jax.vmap(lambda a: end(truth, a))(actions), jnp.ones(6, bool))
    plain, guided = nearer(end, mean, told), nearer(end, mean, told, guide)
    np.testing.assert_array_equal(nearer(end, mean, told, end), plain)

    def off(u):
        return float(
            jnp.linalg.norm(jax.vmap(lambda a: end(u, a))(actions) - told.places, axis=-1).mean()
        )

    assert off(guided) < 0.2 * off(mean) and abs(float(guided[0] - plain[0])) < 0.02
