"""A mechanism's log that contradicts its model is told with what to write; the healthy one is not doubted."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from tests.generators.mechanism_worlds import write_world

SAME = lambda x: x


@pytest.fixture(scope="module", params=["arm3", "furuta"])
def healthy(request, tmp_path_factory):
    """Three driven joints, and two of which one has no drive."""
    folder = tmp_path_factory.mktemp(request.param)
    write_world(folder, "null", 5, machine=request.param, mode="torque")
    return load(folder / "recording")


def spoiled(machine, q=SAME, u=SAME):
    """Angles and speeds, and torques, otherwise in every trial."""
    each = lambda t: replace(t, q=q(t.q), v=None if t.v is None else q(t.v), u=u(t.u))
    return replace(machine, tracks=tuple(each(t) for t in machine.tracks))


def swap(x):
    return np.concatenate([x[:, [1, 0]], x[:, 2:]], 1)


def times(j, factor):
    return lambda x: x * np.where(np.arange(x.shape[1]) == j, factor, 1.0)


def moved(machine, q):
    """The last angle a quarter turn on; speeds as they are."""
    own = next((t for t in machine.tracks if t.q is q), None)
    return q if own is None else q + np.where(np.arange(q.shape[1]) == q.shape[1] - 1, np.pi / 2, 0.0)


def model(machine, length=1.0, mass=1.0):
    """The machine whose file has lengths and masses otherwise."""
    tree = machine.tree
    size = mass * np.array([1.0, *[length] * 3, *[length**2] * 6])
    other = replace(tree, place=length * np.asarray(tree.place), inertial=np.asarray(tree.inertial) * size)
    return replace(machine, mechanism=replace(machine.mechanism, tree=other))


WRONG = {
    "joints": (lambda m: spoiled(m, swap, swap), "look swapped"),
    "torques": (lambda m: spoiled(m, u=swap), "the torques of .* look swapped"),
    "signs": (lambda m: spoiled(m, u=lambda u: -u), "all torques have the other sign"),
    "angle": (lambda m: spoiled(m, times(1, -1.0)), "turn the signs of columns q_"),
    "degrees": (lambda m: spoiled(m, times(1, 180 / np.pi)), '= "deg" under'),
    "radians": (lambda m: spoiled(m, times(1, np.pi / 180)), '= "rad" under'),
    "turns": (lambda m: spoiled(m, times(1, 0.5 / np.pi)), '= "rev" under'),
    "zero": (lambda m: spoiled(m, lambda q: moved(m, q)), "a quarter turn from where the model has its zero"),
    "mm": (lambda m: model(m, length=1e3), "lengths 0.001 times those"),
    "short": (lambda m: model(m, length=0.1), "lengths 10 times those"),
    "grams": (lambda m: model(m, mass=1e3), "masses in grams"),
    "mNm": (lambda m: spoiled(m, u=lambda u: 1e3 * u), "torques in mN m"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_contradicts_the_model_is_refused_with_a_mend(healthy, name):
    spoil, says = WRONG[name]
    with pytest.raises(BadInput, match=f"{says}.*--as-declared$"):
        check_conventions(spoil(healthy))


def test_a_healthy_log_is_not_doubted(healthy):
    assert check_conventions(healthy) == ()


def test_a_free_swing_says_nothing_of_the_torques_unit(tmp_path):
    write_world(tmp_path, "null", 5, machine="pendulum", mode="torque")
    machine = spoiled(load(tmp_path / "recording"), u=np.zeros_like)
    assert all(f.kind != "masses" for f in check_conventions(machine))


def test_masses_that_are_somewhat_off_and_late_logs_are_warned_of(healthy):
    (found,) = check_conventions(model(healthy, mass=0.1))
    assert found.severity == "warn" and "times those that the masses of" in found.message
    (found,) = check_conventions(spoiled(healthy, u=lambda u: np.roll(u, 3, axis=0)))
    assert "ahead of the torque that makes it" in found.message


def test_inertias_a_little_off_are_no_lengths_far_off(tmp_path):
    write_world(tmp_path / "world", "null", 10043)
    assert check_conventions(load(tmp_path / "world/recording", None)) == ()
