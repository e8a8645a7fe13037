"""What is to be recorded next, of a machine whose names have look-alikes."""

from types import SimpleNamespace

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.report import next_experiment
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.effects.joints.catalogue import MACHINE

PROBLEM = SimpleNamespace(
    joint_names=("lift", "elbow"),
    joints=2,
    kinds=("slide", "hinge"),
    units=("m", "rad"),
    effect=lambda name: next(e for e in MACHINE if e.name == name),
)


def candidate(effect, *joints):
    return JointCandidate(effect, joints, "joint", ())


def found(*named):
    reach = SimpleNamespace(speed=np.array([0.1, 2.0]))
    return SimpleNamespace(named=named, reach=reach)


def test_the_joints_of_a_name_and_its_look_alike_are_to_be_moved_as_shows_them():
    alike = (candidate("coulomb", 0), candidate("viscous", 0, 1))
    name = Named(candidate("stribeck", 1), None, 3.0, alike)
    plan = next_experiment(PROBLEM, found(Named(candidate("bias", 0), None, 3.0), name))
    assert plan["separates"] == ["stribeck", "coulomb"]
    assert plan["message"] == (
        "stribeck at elbow does no better in this recording than coulomb at lift. To separate them "
        "record, of elbow (here mostly below 2 rad/s): long stretches of slow motion beside fast "
        "ones; or lift (here mostly below 0.1 m/s): reversals, and both slow and fast motion; or "
        "all joints: fast motion."
    )


def test_a_name_that_stands_alone_asks_for_nothing():
    assert next_experiment(PROBLEM, found(Named(candidate("bias", 0), None, 3.0))) is None
