import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import MINUS, PLUS, STAY, Parameter, Space, gaussian, sample, step

MIXED = Space(
    (
        Parameter("m", 1.0, 2.0, "kg", physical_low=0.0),
        Parameter("e", 1e4, 1e6, "Pa", "log"),
        Parameter("g", 0, 2, "", "categorical"),
    )
)


def test_unit_and_physical_by_hand():
    np.testing.assert_allclose(
        MIXED.physical(jnp.array([0.25, 0.5, 0.6])), [1.25, 1e5, 1.0], rtol=1e-5
    )
    np.testing.assert_allclose(MIXED.unit(jnp.array([1.25, 1e5, 1.0])), [0.25, 0.5, 0.5], atol=1e-6)


def test_values_are_named_as_plain_numbers():
    named = MIXED.named(jnp.array([0.25, 0.5, 0.6]))
    assert named == {"m": 1.25, "e": pytest.approx(1e5, rel=1e-5), "g": 1.0}
    assert all(type(value) is float for value in named.values())


def test_targets_outside_the_box_extrapolate():
    np.testing.assert_allclose(MIXED.unit(jnp.array([0.3, 1e7, 0.0])), [-0.7, 1.5, 0.0], atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-0.5, 1.5, width=32), min_size=2, max_size=2))
def test_round_trip_of_continuous_parameters(values):
    u = jnp.array([*values, 0.5], jnp.float32)
    np.testing.assert_allclose(MIXED.unit(MIXED.physical(u)), u, atol=1e-5)


@pytest.mark.parametrize("delta", [0.05, 0.1, 0.3])
def test_step_moves_by_delta_or_a_category_and_stays_in_the_box(delta):
    dist = gaussian(MIXED, jnp.array([0.5, 0.98, 0.5]))
    up = step(MIXED, dist, jnp.array([PLUS, PLUS, PLUS]), delta)
    np.testing.assert_allclose(up.mean, [0.5 + delta, 1.0, 1.0], atol=1e-6)
    down = step(MIXED, dist, jnp.array([MINUS, STAY, MINUS]), delta)
    np.testing.assert_allclose(down.mean, [0.5 - delta, 0.98, 0.0], atol=1e-6)
    np.testing.assert_array_equal(up.std, dist.std)


def test_a_two_valued_parameter_flips():
    space = Space((Parameter("g", 0, 1, "", "categorical"),))
    dist = step(space, gaussian(space, jnp.zeros(1)), jnp.array([PLUS]), 0.1)
    assert space.physical(dist.mean) == 1.0
    assert space.physical(step(space, dist, jnp.array([MINUS]), 0.1).mean) == 0.0


def test_samples_of_e_have_its_mean_and_spread_and_stay_inside():
    dist = gaussian(MIXED, jnp.array([0.5, 0.0, 1.0]), 0.05)
    drawn = np.asarray(sample(jax.random.key(0), dist, (20_000,)))
    assert drawn.min() >= 0 and drawn.max() <= 1
    np.testing.assert_allclose(drawn[:, 0].mean(), 0.5, atol=2e-3)
    np.testing.assert_allclose(drawn[:, 0].std(), 0.05, rtol=0.03)


def test_uniform_samples_fill_the_box():
    drawn = np.asarray(MIXED.sample(jax.random.key(0), (10_000,)))
    assert drawn.shape == (10_000, 3)
    np.testing.assert_allclose(
        np.quantile(drawn, [0.1, 0.5, 0.9], axis=0).T[:2], [[0.1, 0.5, 0.9]] * 2, atol=0.03
    )
    categories, counts = np.unique(drawn[:, 2], return_counts=True)
    np.testing.assert_allclose(categories, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(counts / len(drawn), 1 / 3, atol=0.02)


def test_x64_and_float32(request):
    u = np.array([0.3, 0.7, 0.5])
    single = MIXED.physical(jnp.asarray(u, jnp.float32))
    assert single.dtype == jnp.float32
    with jax.enable_x64(True):
        double = MIXED.physical(jnp.asarray(u))
        assert double.dtype == jnp.float64
        np.testing.assert_allclose(double[1], 1e4 * 100**0.7, rtol=1e-14)
    np.testing.assert_allclose(single, double, rtol=1e-5)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"m": 1.5, "e": 1e5, "gg": 1}, "did you mean 'g'"),
        ({"m": 1.5, "e": 1e5}, "parameter 'g' is missing"),
        ({"m": -1.0, "e": 1e5, "g": 1}, "outside its physical range"),
        ({"m": float("nan"), "e": 1e5, "g": 1}, "not a finite number"),
        ({"m": "1.5", "e": 1e5, "g": 1}, "not a finite number"),
        ({"m": True, "e": 1e5, "g": 1}, "not a finite number"),
        ({"m": -(10**30), "e": 1e5, "g": 1}, "outside its physical range"),
        ({"m": 10**400, "e": 1e5, "g": 1}, "not a finite number"),
    ],
)
def test_bad_values_say_the_mend_in_one_line(given, says):
    with pytest.raises(BadInput, match=says) as caught:
        MIXED.values(given, "target.toml")
    assert "\n" not in str(caught.value) and "target.toml" in str(caught.value)


@pytest.mark.parametrize(
    "bad",
    [("m", 2.0, 1.0), ("m", 0.0, 1.0, "", "log"), ("m", 0.0, 1.0, "", "cubic"), ("m", 1.0, 1.0)],
)
def test_bad_parameters_are_refused(bad):
    with pytest.raises(BadInput):
        Parameter(*bad)


def test_repeated_names_are_refused():
    with pytest.raises(BadInput, match="repeat"):
        Space((Parameter("m", 0, 1), Parameter("m", 0, 1)))
