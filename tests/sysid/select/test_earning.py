"""When a simpler effect will do, and when effects that are small beside the torque count all the same."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.select.earning import choose, earns, needed

PROBLEM = SimpleNamespace(criteria=Criteria(), torque_scale=np.array([1.0, 1.0]))
COULOMB, STRIBECK, BIAS = ("coulomb", "joint1"), ("stribeck", "joint1"), ("bias", "joint1")


def model(*active, total=0.0, size=4, force=1.0):
    """A fitted model that leaves `force` N m of unexplained torque at joint 1."""
    merit = lambda price: total - price * size
    return SimpleNamespace(
        active=active, total=total, size=size, response=0, moving=np.array([force**2, 0.0]), merit=merit
    )


def frictions(scale: float):
    """A declared model, dry friction that leaves a fifth of what is unexplained, and Stribeck's that leaves a fifteenth."""
    base = model(force=scale)
    simple = model(COULOMB, total=470.0, size=5, force=0.2 * scale)
    return base, simple, model(STRIBECK, total=700.0, size=7, force=0.06 * scale)


def test_a_simpler_effect_will_do_where_it_leaves_nothing_that_matters():
    base = model(force=0.1)
    simple = model(COULOMB, total=900.0, size=5, force=0.0012)
    wider = model(STRIBECK, total=930.0, size=7, force=0.001)
    assert choose(PROBLEM, [simple, wider], base) is simple


def test_a_simpler_effect_that_would_not_be_named_is_no_stand_in():
    base, simple, wider = frictions(0.003)  # of the torque: too little to matter by itself
    assert earns(PROBLEM, wider, base, base) and not earns(PROBLEM, simple, base, base)
    assert choose(PROBLEM, [simple, wider], base) is wider


@pytest.mark.parametrize(("total", "left", "count", "expected"), [
    (700.0, 0.001, 2, True), (150.0, 0.001, 2, False), (700.0, 0.2, 2, False), (700.0, 0.001, 3, False), (150.0, 0.001, 1, True),
])  # fmt: skip
def test_small_effects_count_where_they_are_nearly_all_and_no_chance(total, left, count, expected):
    base = model(force=0.003)
    active = (COULOMB, BIAS, ("drag", "joint2"))[:count]
    new = model(*active, total=total, size=4 + count, force=left * 0.003)
    assert earns(PROBLEM, new, base, base) is expected


@pytest.mark.parametrize(("without", "expected"), [(350.0, True), (640.0, False)])
def test_of_two_small_effects_each_must_be_no_chance(without, expected):
    base = model(force=0.003)
    pair = model(COULOMB, BIAS, total=700.0, size=6, force=3e-6)
    less = model(COULOMB, total=without, size=5, force=0.002)
    found = SimpleNamespace(base=base, final=base)
    assert needed(PROBLEM, pair, less, found) is expected
