"""Why an effect does not stay is said by the rule that it failed."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.nested_models import SimulatedEvidence, between_rows, steadiness
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.rules import MODEL, NAME, refusal
from adaptsim_jax.diagnosis.testing import Test as Paired
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.registry import effect_named

DT = 0.005  # s
GOOD = Paired(0.4, 0.0001, 6, 6, 24)


def the_effect(name):
    return effect_named(name, MACHINE)


def judged(delay=0.01, angles=0.5, test=GOOD, steady=27.0, floor=0.1, least=0.0, describes=False):
    """Of a delay [s] that leaves `angles` times the error of the angles without it, at a noise
    floor.
    """
    entry = Entry("delay", "delay", (0,), 0.0, 0.0, -0.1, 0.1, "s")
    candidate = JointCandidate("delay", (0,), "joint", (entry,))
    vector: Any = Vector((entry,), np.array([delay]))

    def of(size):
        return SimpleNamespace(
            fit=SimpleNamespace(vector=vector),
            held=SimpleNamespace(squared=np.full((8, 2), size**2)),
        )

    problem: Any = SimpleNamespace(
        reach=SimpleNamespace(dt=DT),
        fold=np.zeros(8, int),
        joints=1,
        floor=np.full(2, floor),
        least=least,
        effect=lambda name: replace(the_effect(name), describes=describes),
    )
    evidence = SimulatedEvidence(problem, of(angles), of(1.0), candidate, test, steady, Criteria())
    return refusal(evidence, (MODEL, NAME))


def test_what_holds_out_stays():
    assert judged() is None


@pytest.mark.parametrize(
    "change, says",
    [
        ({"delay": 0.1 * DT}, ("within_row", 0.1, "a shift in time of 0.1 sampling intervals")),
        (
            {"test": Paired(0.4, 0.2, 4, 6, 24)},
            ("not_confirmed", 0.2, "left-out stretches do not confirm it"),
        ),
        ({"test": Paired(0.005, 0.0001, 6, 6, 24)}, ("too_little_gain", 0.005, "less than 1 %")),
        ({"steady": 1.2}, ("unsteady", 1.2, "1.2 times its scatter")),
        ({"delay": 0.1}, ("at_bound", 1.0, "at the end of what such a machine may have")),
        ({"delay": -0.1}, ("at_bound", 1.0, "at the end of what such a machine may have")),
        ({"angles": 1.1}, ("angles_not_nearer", -0.1, "do not come nearer")),
        ({"angles": 0.97}, ("no_joint_improves", 0.06, "takes 6 % off the squared error")),
        ({"angles": 0.9, "floor": 1.5}, ("no_joint_improves", 0.084, "takes 8 % off")),
        ({"angles": 0.9, "least": 1.5}, ("no_joint_improves", 0.084, "takes 8 % off")),
        ({"angles": 0.8, "describes": True}, ("no_joint_improves", 0.36, "takes 36 % off")),
    ],
)
def test_the_rule_that_failed_is_told(change, says):
    code, number, words = says
    found = judged(**change)
    assert found.code == code and found.number == pytest.approx(number, abs=0.01)
    assert words in found.words


@pytest.mark.parametrize(("floor", "stays"), [(1e-4, False), (1e-5, True)])
def test_bristles_that_bend_within_the_noise_are_no_effect(floor, stays):
    """0.3 N m of friction on bristles of 1e-4 rad/(N m) breaks away after 3e-5 rad."""
    level = Entry("coulomb", "level", (0,), 0.0, 0.0, 0.0, 9.0, "N m")
    entry = Entry("presliding", "compliance", (0,), 0.0, 0.0, 0.0, 9.0, "rad/(N m)")
    vector: Any = Vector((level, entry), np.array([0.3, 1e-4]))

    def of(size):
        return SimpleNamespace(
            fit=SimpleNamespace(vector=vector),
            held=SimpleNamespace(squared=np.full((8, 2), (size * floor) ** 2)),
        )

    problem: Any = SimpleNamespace(
        reach=SimpleNamespace(dt=DT, torque=np.array([1.0])),
        fold=np.zeros(8, int),
        joints=1,
        floor=np.full(2, floor),
        least=0.0,
        effect=the_effect,
    )
    candidate = JointCandidate("presliding", (0,), "joint", (entry,))
    evidence = SimulatedEvidence(problem, of(2.0), of(9.0), candidate, GOOD, 27.0, Criteria())
    why = refusal(evidence, (MODEL, NAME))
    if stays:
        assert why is None
    else:
        assert why.code == "below_noise" and "break away within" in why.words


@pytest.mark.parametrize(("rows", "read"), [(-0.7, False), (-0.5, True), (0.2, True), (0.3, False)])
def test_commands_between_rows_are_how_rows_are_read(rows, read):
    entry = Entry("delay", "delay", (0, 1), 0.0, 0.0, -0.1, 0.1, "s")
    model: Any = SimpleNamespace(
        fit=SimpleNamespace(vector=Vector((entry,), np.array([rows * DT])))
    )
    problem: Any = SimpleNamespace(
        joints=2, reach=SimpleNamespace(dt=DT, peak=np.ones(2)), effect=the_effect
    )
    assert (
        bool(
            between_rows(
                problem, model, JointCandidate("delay", (0, 1), "common", (entry,)), Criteria()
            )
        )
        is read
    )


def test_steadiness_is_that_of_an_effect_all_else_held():
    """Two folds' equations in an effect and an inertia that trade places: each fold wants the
    effect, whatever it wants of both.
    """
    entries = tuple(Entry(k, k, (0,), 0.0, 0.0, -9.0, 9.0, "1") for k in ("coulomb", "inertia"))
    hess = np.array([[[1.0, 1.0], [1.0, 1.001]], [[1.0, 1.0], [1.0, 1.002]]])
    slope = np.array([[0.01, 0.011], [-0.01, -0.011]])
    model: Any = SimpleNamespace(
        fit=SimpleNamespace(vector=Vector(entries, np.array([0.5, 0.2]))),
        held=SimpleNamespace(
            vectors=np.zeros((2, 2)), normal=SimpleNamespace(hess=hess, slope=slope)
        ),
    )
    assert steadiness(
        model, JointCandidate("coulomb", (0,), "joint", entries[:1])
    ) == pytest.approx(50.0, rel=1e-3)
