"""A body of another mass, as the balance of torques names it."""

from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.carried import carried
from adaptsim_jax.attribution.equation.models import search_balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import BODY_MASS, BODY_NUMBERS, inertias
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from tests.generators.arm_worlds import write_arm
from tests.logs.measured_files import measured

CENTRE, OWN, MASS = np.array([0.1, -0.02, 0.05]), np.diag([0.002, 0.003, 0.0025]), 0.8


def inertial_of(mass, centre, own):
    about = own + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *(mass * centre), *about[np.triu_indices(3)]])


def at(**numbers):
    row = np.zeros((1, len(BODY_NUMBERS)))
    for name, value in numbers.items():
        row[0, BODY_NUMBERS.index(name)] = value
    return inertias(inertial_of(MASS, CENTRE, OWN)[None]).at(row)


def test_more_mass_is_at_the_centre_and_of_the_same_shape():
    value, _ = at(mass=0.4)
    np.testing.assert_allclose(value[0], inertial_of(1.2, CENTRE, 1.5 * OWN), rtol=1e-9)


def test_a_moment_moves_the_centre_and_not_the_mass():
    value, _ = at(moment_x=0.04)
    away = CENTRE + np.array([0.05, 0.0, 0.0])
    np.testing.assert_allclose(value[0], inertial_of(MASS, away, OWN), rtol=1e-9)


def test_slopes_are_those_of_differences():
    here = dict(mass=0.2, moment_y=0.01, size=0.05)
    _, slope = at(**here)
    for name in ("mass", "moment_x", "moment_z", "size"):
        more, less = (at(**here | {name: here.get(name, 0.0) + h})[0] for h in (1e-6, -1e-6))
        near = slope[0][:, BODY_NUMBERS.index(name)]
        np.testing.assert_allclose((more - less)[0] / 2e-6, near, rtol=1e-6, atol=1e-9)


def searched(folder: Path):
    machine = load(folder, None)
    problem = machine.problem(MACHINE)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    return search_balances(
        problem, balances(problem, machine.tracks), null, reach, Criteria(), False
    )


@pytest.mark.long
def test_a_payload_has_its_name_and_nothing_else_takes_its_place(tmp_path):
    truth = write_arm(
        tmp_path / "arm", measured("robots") / "ufactory_xarm7__xarm7_nohand.xml", "payload", 8022
    )
    found = searched(tmp_path / "arm")
    names = {(n.candidate.effect, j) for n in found.named for j in n.candidate.joints}
    assert names - {tuple(e) for e in truth["effects"]} == {(BODY_MASS, 6)}
    mass = found.final.known()[BODY_MASS, "mass", (6,)]
    assert mass == pytest.approx(truth["payload"], rel=0.25)
    assert carried(found.searches[0]) is None  # it has a name


@pytest.mark.long
def test_bodies_that_are_all_off_are_no_single_mass(tmp_path):
    truth = write_arm(
        tmp_path / "arm", measured("robots") / "kuka_iiwa_14__iiwa14.xml", "friction", 8003
    )
    found = searched(tmp_path / "arm")
    names = {(n.candidate.effect, j) for n in found.named for j in n.candidate.joints}
    assert names <= {tuple(e) for e in truth["effects"]}
    assert carried(found.searches[0]) is None
