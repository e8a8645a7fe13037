"""The spatula's motion against its twist integrated numerically."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.model import ScoopOptions

ACTION = np.array([np.radians(6.0), 0.13, 0.012])


def _by_twist(action, options):
    """The tip by integrating the link's twist in small steps, and turning the arm from link to tip
    with it.
    """
    pitch, rate, distance = action

    def clamped(values):
        return CubicSpline(spatula.KNOTS, values, bc_type="clamped")

    speed, turning = (
        clamped(spatula.FORWARD),
        clamped(np.array(spatula.PITCH) + np.eye(6)[1] * rate),
    )
    arm = np.array(
        [
            np.cos(pitch) * 0.177 - np.sin(pitch) * 0.043,
            -np.sin(pitch) * 0.177 - np.cos(pitch) * 0.043 - 0.1,
        ]
    )
    link, angle, count = -arm + [-0.015 - distance, 0.0], 0.0, 20_000
    out = []
    for k in range(count + 1):
        c, s = np.cos(angle), np.sin(angle)
        if k % (count // 100) == 0:
            out.append(
                [
                    link[0] + c * arm[0] + s * arm[1],
                    link[1] + c * arm[1] - s * arm[0],
                    pitch + angle,
                ]
            )
        t = (k + 0.5) / count
        link = link + np.array([speed(t), 0.0]) / count
        angle += turning(t) / count
    return np.array(out)


def test_the_tip_hangs_from_the_link(x64):
    options = ScoopOptions()
    ours = np.asarray(spatula.motion(jnp.asarray(ACTION), 100, options))
    by_hand = _by_twist(ACTION, options)
    np.testing.assert_allclose(ours[:, [0, 2]], by_hand[:, [0, 2]], atol=1e-6)
    low = np.asarray(by_hand[:, 1] + np.asarray(spatula.lowest(jnp.asarray(by_hand[:, 2]))))
    np.testing.assert_allclose(
        ours[:, 1], by_hand[:, 1] + np.maximum(0.0, options.clearance - low), atol=1e-6
    )
    assert (low < -1e-3).any() and (low > 0.02).any()  # it would sink, and it lifts


@pytest.mark.parametrize("clearance", [0.0, 4e-4])
def test_no_edge_comes_below_the_clearance(x64, clearance):
    pose = spatula.motion(jnp.asarray(ACTION), 400, ScoopOptions(clearance=clearance))
    low = np.asarray(pose[:, 1] + spatula.lowest(pose[:, 2]))
    assert low.min() == pytest.approx(clearance, abs=1e-12)
    assert np.asarray(pose)[0, 0] == pytest.approx(-0.027)


def test_a_positive_rate_lifts_late(x64):
    def rises(rate):
        return np.asarray(spatula.motion(jnp.array([0.1, rate, 0.01]), 400))[:, 1] > 4e-3

    early, late = (np.argmax(rises(rate)) / 400 for rate in (-0.2, 0.2))
    assert 0.2 < early < late - 0.03 < 0.7


def test_gradients_are_finite_differences(x64):
    def place(a):
        return spatula.motion(a, 40)[jnp.array([8, 16, 30, 40])]

    jacobian = np.asarray(jax.jacobian(place)(jnp.asarray(ACTION)))
    for i in range(3):
        e = 1e-6 * np.eye(3)[i]
        numeric = (
            np.asarray(place(jnp.asarray(ACTION + e))) - np.asarray(place(jnp.asarray(ACTION - e)))
        ) / 2e-6
        np.testing.assert_allclose(jacobian[..., i], numeric, atol=1e-7)


@pytest.mark.parametrize(
    "options, says",
    [
        (ScoopOptions(clearance=0.4), "metres"),
        (ScoopOptions(noise=(0.1,)), "three"),
        (ScoopOptions(press=-1.0), "press"),
    ],
)
def test_bad_options_are_refused(options, says):
    with pytest.raises(BadInput, match=says):
        model.check_options(options)


def test_actions_span_the_papers_ranges():
    ends = model.physical_action(np.array([[-1.0] * 3, [1.0] * 3]))
    np.testing.assert_allclose(ends, [model.ACTION_LOW, model.ACTION_HIGH], rtol=1e-6)
