"""Which joints are neighbours where two arms on one base share no moving body."""

from types import SimpleNamespace

import pytest

from adaptsim_jax.attribution.candidates import JointCandidate, adjacent


@pytest.mark.parametrize(
    ("joints", "others", "near"),
    [((1,), (0,), True), ((3,), (3,), True), ((1,), (2,), False), ((0, 1), (3,), False)],
)
def test_neighbours_are_joints_of_one_arm(joints, others, near):
    problem = SimpleNamespace(parents=(-1, 0, -1, 2))
    one, other = (JointCandidate("coulomb", j, "joint", ()) for j in (joints, others))
    assert adjacent(problem, one, other) is near and adjacent(problem, other, one) is near
