"""What each search does, step by step: action, effect, joints, code and number."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.starts import problem_of
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.diagnosed import simulator
from tests.diagnosis.test_simulator import recorded
from tests.diagnosis.test_trials import problem
from tests.pins.machines import record
from tests.pins.stored import check

LOOSE = 1e-4
PUSHES = Criteria(lacks_nothing=1.01, beyond=0.9, tried=6)
# truths and criteria of a linear problem with effects b, c and d, which does what b does
LINEAR: dict[str, tuple[tuple[float, ...], dict[str, Any], Criteria]] = {
    "nothing": ((0.7, 0.0, 0.0, 0.0), {}, Criteria()),
    "one": ((0.7, 0.0, 0.8, 0.0), {}, Criteria()),
    "class": ((0.7, 0.5, 0.0, 0.0), {}, Criteria()),
    "both": ((0.7, 0.5, 0.6, 0.0), {}, Criteria()),
    "small": ((0.7, 0.06, 0.09, 0.0), {"seed": 2}, Criteria(size=0.0)),
    "few": ((0.7, 0.0, 0.8, 0.0), {"trials": 5}, Criteria(confidence=0.01)),
    "pushes": ((0.7, 0.6, 0.5, 0.0), {"seed": 1}, PUSHES),
    "matters": ((0.7, 0.3, 0.2, 0.0), {"seed": 1}, Criteria(matters=3.0)),
    "unsteady": ((0.7, 0.5, 0.6, 0.0), {"seed": 3}, Criteria(steady=20.0)),
    "alpha": ((0.7, 0.05, 0.04, 0.0), {"seed": 6}, Criteria(alpha=3.0, size=-1.0, confidence=0.6)),
}
TANKS: dict[str, tuple[dict[str, float], dict[str, Any]]] = {
    "nothing": ({"gain": 1.1}, {"seed": 2}),
    "leak": ({"leak": 0.004}, {"seed": 3}),
    "two": ({"dead_voltage": 0.8, "sensor_offset": 30.0}, {"seed": 4}),
    "few": ({"leak": 0.004}, {"seed": 5, "trials": 3}),
}


def told(found: Finding) -> dict[str, Any]:
    """What a search over short trials found."""

    def test(z):
        return [z.gain, z.p, float(z.better), float(z.folds), float(z.parts)]

    return {
        "scores": [[s.candidate.name, dict(s.shape), s.gain, s.p] for s in found.scores],
        "null": [found.null.fit.loss, list(found.null.fit.values)],
        "final": [found.final.fit.loss, list(found.final.fit.values)],
        "added": [c.name for c in found.final.added],
        "named": [
            [n.candidate.name, test(n.test), n.steady, [a.name for a in n.alternatives]]
            for n in found.named
        ],
        "trace": [
            [
                s.action,
                s.candidate.name if s.candidate else "",
                s.reason.code if s.reason else "",
                s.reason.number if s.reason else 0.0,
            ]
            for s in found.trace
        ],
    }


@pytest.mark.parametrize("name", LINEAR)
def test_a_linear_problem_is_searched_the_same(name):
    truth, more, criteria = LINEAR[name]
    check(f"search_linear_{name}", told(search_trials(problem(truth, **more), criteria)), LOOSE)


def test_an_effect_at_its_bound_is_refused_the_same():
    lacks = problem((0.7, 0.0, 0.8, 0.0))
    quantities = tuple(replace(q, high=0.3) if q.name == "c" else q for q in lacks.quantities)
    check(
        "search_linear_bound",
        told(search_trials(replace(lacks, quantities=quantities), Criteria())),
        LOOSE,
    )


@pytest.mark.parametrize("name", TANKS)
def test_tanks_are_searched_the_same(name):
    hidden, more = TANKS[name]
    check(
        f"search_tanks_{name}",
        told(search_trials(problem_of(recorded(hidden, **more)), Criteria())),
        LOOSE,
    )


def test_a_twin_of_a_leak_is_its_class():
    tanks = recorded({"leak": 0.004}, seed=6)
    twin = replace(tanks.candidates[0], name="evaporation")
    found = search_trials(problem_of(tanks, (*tanks.candidates, twin)), Criteria())
    check("search_tanks_twin", told(found), LOOSE)


@pytest.mark.long
def test_mujoco_is_searched_the_same(tmp_path):
    made = simulator(*read_source_and_log(record(tmp_path / "log", "servos")))
    found = search_trials(problem_of(made), Criteria())
    assert np.isfinite(found.final.fit.loss)
    check("search_mujoco_servos", told(found), LOOSE)
