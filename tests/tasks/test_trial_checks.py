"""What tracks say by themselves of clocks, trackers that froze, units and mirrors: the checks that
pushes, scoops and tosses share.
"""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.camera_record import unit_like
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.frame import touch
from adaptsim_jax.tasks.pushing.slide import rollout
from adaptsim_jax.tasks.scooping.motion import check_mirrored
from adaptsim_jax.tasks.trial_clock import began, check_frozen, clock_rate

ACTIONS = np.array([[0.45, 0.1], [0.6, -0.2], [0.8, 0.0]])
TIME = np.arange(80) / 60
NOISE = 3e-4  # m


@pytest.fixture(scope="module")
def slides():
    """Places `[6, 80, 2]` m at 60 Hz of three pushes of a slippery and of a grippy bottle, as a
    camera sees them.
    """
    rng, out = np.random.default_rng(5), []
    for mu, e, mu_p in ((0.05, 1e6, 0.2), (0.2, 1e4, 0.8)):
        for action in ACTIONS:
            rows = np.asarray(
                rollout({"mu": mu, "e": e, "mu_p": mu_p, "y_p": 0.0}, action.astype(np.float32))
            )
            own = np.arange(len(rows)) * 0.005
            out.append(np.stack([np.interp(TIME, own, rows[:, k]) for k in range(2)], 1))
    return np.array(out) + NOISE * rng.standard_normal((6, 80, 2))


def rate(slides, stretch, late=0.0, pushed=1.0):
    actions = np.tile(ACTIONS, (2, 1))
    seen = [began(stretch * TIME + late, xy) for xy in slides]
    asked = actions / [
        pushed,
        1.0,
    ]  # what the arm was told, where it then ran `pushed` times as fast
    return clock_rate(seen, touch(asked, np.tile(model.START, (6, 1))))


@pytest.mark.parametrize("stretch", [0.1, 0.25, 0.5, 2.0, 4.0, 8.0])
def test_a_clock_of_another_rate_is_told_by_its_factor(slides, stretch):
    assert rate(slides, stretch) == pytest.approx(stretch, rel=0.15)
    assert rate(slides[[0]].repeat(6, 0), stretch) is not None


@pytest.mark.parametrize("stretch", [0.8, 0.9, 1.0, 1.1, 1.2])
def test_what_is_an_effect_is_no_clock_of_another_rate(slides, stretch):
    assert rate(slides, stretch) is None
    assert rate(slides, 1.0, late=0.15) is None and rate(slides, 1.0, late=-0.1) is None
    assert (
        rate(slides, 1.0, pushed=stretch) is None and rate(slides, 1.0, pushed=0.5) is None
    )  # an arm at half speed


def told(k):
    return f"row {k}"


def frozen(xy, first, last):
    out = xy.copy()
    out[first : last + 1] = out[first]
    return out


@pytest.mark.parametrize(
    ("first", "last", "says"), [(25, 31, "then leaps"), (22, 79, "no friction"), (3, 24, "leaps")]
)
def test_a_tracker_that_froze_is_told_by_row_and_time(slides, first, last, says):
    for xy in slides:
        check_frozen(TIME, xy, told, "the bottle")
        with pytest.raises(BadInput, match=says) as error:
            check_frozen(TIME, frozen(xy, first, last), told, "the bottle")
        assert f"row {first + 1}" in str(error.value) and f"from {TIME[first]:.4g} to" in str(
            error.value
        )


def test_a_bottle_that_comes_to_rest_is_no_tracker_that_froze(slides):
    """Without noise, rounded, and of a tracker that holds what hardly moves."""
    still = np.asarray(
        rollout({"mu": 0.2, "e": 1e5, "mu_p": 1.2, "y_p": 0.0}, np.array([0.8, 0.0], np.float32))
    )
    xy = np.stack(
        [np.interp(TIME, np.arange(len(still)) * 0.005, still[:, k]) for k in range(2)], 1
    )
    xy[60:] = xy[60]
    for track in (xy, *slides):
        for step in (0.0, 5e-4, 1e-3, 2e-3, 5e-3):
            check_frozen(TIME, np.round(track / step) * step if step else track, told, "the bottle")
    for track in slides:
        held = track.copy()
        for k in range(3, len(held)):
            if np.linalg.norm(held[k] - held[k - 3 : k], axis=1).max() < 1.5e-3:
                held[k] = held[k - 1]
        check_frozen(TIME, held, told, "the bottle")


def test_a_tracker_slower_than_the_log_is_told(slides):
    for every in (2, 4):
        with pytest.raises(BadInput, match=f"only once in {every} rows"):
            check_frozen(TIME, slides[1][(np.arange(80) // every) * every], told, "the bottle")


def test_units_are_told_by_their_size():
    assert [unit_like(0.7 * f, 0.7) for f in (1e3, 1e2, 1 / 0.0254)] == ["mm", "cm", "inches"]
    assert unit_like(0.1 * 100 * 0.6, 0.1) == "inches or cm"


def test_a_mirror_is_told_from_any_origin():
    declared = np.array([-0.02, 0.015, 0.03, -0.001])
    check_mirrored(declared, 0.4 + declared, "f")
    check_mirrored(declared, np.full(4, 0.001), "f")  # each counted from itself
    with pytest.raises(BadInput, match="turn the sign of y"):
        check_mirrored(declared, 0.4 - declared + 1e-3, "f")
