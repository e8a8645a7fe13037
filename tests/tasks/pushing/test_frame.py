"""Tracks in another frame than declared are told by what they look like; those of a robot that
veers a little are taken.
"""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing.frame import check_frame

ANGLES = {2: np.array([0.22, -0.13]), 12: np.linspace(-0.28, 0.28, 12)}
FRAMES = {
    "mirrored": lambda a: -a,
    "degrees": np.radians,
    "in_degrees": np.degrees,
    "turned": lambda a: a - 0.6,
    "frame": lambda a: 2.0 + np.arange(len(a)) % 3 * 1.9,
}


def way(angles, seed=0, noise=0.01):
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.1, 0.6, (len(angles), 1))
    angles = angles + noise * rng.normal(size=len(angles))
    return length * np.stack([np.cos(angles), np.sin(angles)], 1)


@pytest.mark.parametrize("count", ANGLES)
@pytest.mark.parametrize("name", FRAMES)
def test_another_frame_is_refused(count, name):
    angles = ANGLES[count] * (0.05 if name == "in_degrees" else 1.0)
    went = FRAMES[name](angles)
    with pytest.raises(BadInput, match=r"^tracks.csv: the bottles .*; .*--as-declared$"):
        check_frame(range(count), angles, way(went), "tracks.csv")


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("count", [1, 2, 4, 12])
def test_pushes_that_go_where_they_should_are_not_doubted(seed, count):
    """Nor those of a plate that is not held square, whose bottles scatter by 2 degrees."""
    angles = np.random.default_rng([1, seed]).uniform(-0.3, 0.3, count)
    check_frame(range(count), angles, way(angles, seed, 0.03), "")


def test_a_robot_that_veers_is_taken():
    for angles in ANGLES.values():
        check_frame(range(len(angles)), angles, way(angles + 0.12, noise=0.0), "")


def test_bottles_that_hardly_moved_say_nothing():
    check_frame(range(2), ANGLES[2], -0.01 * np.ones((2, 2)), "")


@pytest.mark.parametrize("count", [5, 12])
def test_tracks_of_other_pushes_are_refused(count):
    angles = np.linspace(-0.28, 0.28, count)
    went = way(angles)
    check_frame(range(count), angles, went, "tracks.csv")
    order = np.arange(count)
    order[[0, -1]] = order[[-1, 0]]
    with pytest.raises(
        BadInput, match=rf"trials 0 and {count - 1} went where the other was pushed"
    ):
        check_frame(range(count), angles, went[order], "tracks.csv")
    if count > 2:
        mixed = np.random.default_rng(3).permutation(angles)
        with pytest.raises(BadInput, match="off by one"):
            check_frame(range(count), mixed, np.roll(way(mixed), 1, 0), "tracks.csv")


@pytest.mark.parametrize("seed", range(20))
def test_bottles_that_scatter_are_not_taken_for_exchanged(seed):
    angles = np.random.default_rng([2, seed]).uniform(-0.3, 0.3, 12)
    check_frame(range(12), angles, way(angles + 0.1, seed, 0.03), "tracks.csv")
