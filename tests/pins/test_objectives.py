"""Residuals, columns and candidates of each objective, at fixed vectors."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import JointCandidate, candidates
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.models import (
    part_of,
    search_group,
    separable_candidates,
    within,
)
from adaptsim_jax.attribution.equation.searched import EffectTable, Searched
from adaptsim_jax.attribution.estimate import linear
from adaptsim_jax.attribution.fitted import Selection
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import TreeFit, Vector
from adaptsim_jax.attribution.paths import losses, run, starts_of, weigh
from adaptsim_jax.attribution.posed import declared_vector, posed
from adaptsim_jax.attribution.problem import TreeProblem, own_inertia, scaled_reach
from adaptsim_jax.attribution.score import candidate_columns, table
from adaptsim_jax.attribution.tree_objective import select
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.starts import problem_of
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.diagnosed import simulator
from tests.diagnosis.test_simulator import recorded
from tests.pins.machines import MACHINES, record
from tests.pins.stored import check, mark

HORIZON = 0.5
# what compiles programs of its own is left to the longer tier
TIERS = [
    pytest.param(name, marks=[pytest.mark.long] if name in ("stop", "follower") else [])
    for name in MACHINES
]
LOOSE = 1e-4  # of differences of simulations
NEAR = 0.02  # of a unit, by which the second vector is moved
FEW = ("viscous", "coulomb", "armature", "delay", "encoder_offset", "damping_step", "torque_gain")
"""Effects of a catalogue that is compiled in seconds."""


@dataclass(frozen=True)
class Posed:
    """A machine's problem by simulation and by the balance, and the vector that is fitted."""

    machine: Any
    problem: TreeProblem
    null: Vector
    reach: Any


@pytest.fixture(scope="module")
def posed_of(tmp_path_factory):
    """`posed_of(name)`, made once each; with those effects of the catalogue that are in `few`."""
    known: dict[tuple[str, tuple[str, ...] | None], Posed] = {}
    machines: dict[str, Any] = {}

    def make(name: str, few: tuple[str, ...] | None = None) -> Posed:
        if name not in machines:
            machines[name] = load(record(tmp_path_factory.mktemp("pins") / name, name), None)
        if (name, few) not in known:
            machine = machines[name]
            effects = tuple(e for e in MACHINE if not few or e.name in few)
            problem = posed(machine, effects, HORIZON)
            null = declared_vector(machine, problem)
            reach = scaled_reach(problem, *own_inertia(problem, null))
            known[name, few] = Posed(machine, problem, null, reach)
        return known[name, few]

    return make


def moved(vector: Vector, size: float) -> Vector:
    """A vector near another, within its bounds."""
    off = size * np.sin(1.0 + np.arange(len(vector)))
    return vector.at(np.clip(vector.values + off, vector.low, vector.high))


def three(case: Posed) -> dict[str, Vector]:
    """The declared vector, one near it, and one with effects."""
    wanted = {("coulomb", "joint"), ("delay", "common"), ("encoder_offset", "joint")}
    some = [
        c
        for c in candidates(case.problem, case.null, case.reach)
        if (c.effect, c.sharing) in wanted and not c.shape
    ]
    rows = [e for c in some for e in c.entries]
    values = [
        e.off + 0.1 * (min(e.high, 1.0) - e.off) * (0.1 if e.unit == "s" else 1.0) for e in rows
    ]
    return {
        "declared": case.null,
        "near": moved(case.null, NEAR),
        "effects": case.null.with_entries(rows, values),
    }


def told(c: JointCandidate) -> list[Any]:
    """A candidate as it is stored."""
    rows = [
        [e.owner, e.name, list(e.joints), e.start, e.off, e.low, e.high, e.unit, e.prior]
        for e in c.entries
    ]
    return [c.effect, list(c.joints), c.sharing, dict(c.shape), rows]


@pytest.mark.parametrize("name", MACHINES)
def test_candidates_are_the_same_in_the_same_order(posed_of, name):
    case = posed_of(name)
    rows = [told(c) for c in candidates(case.problem, case.null, case.reach)]
    fitted = [[*e.key, e.start, e.off, e.low, e.high, e.unit, e.prior] for e in case.null.entries]
    check(f"candidates_{name}", {"fitted": fitted, "candidates": rows})


@pytest.mark.parametrize("name", TIERS)
def test_simulated_stretches_leave_the_same(posed_of, name):
    case, out = posed_of(name, FEW), {}
    for key, vector in three(case).items():
        starts = starts_of(case.problem)
        paths = run(case.problem, vector, starts)
        weights = weigh(case.problem, paths)
        loss = losses(case.problem, paths, weights)
        lin = linear(case.problem, TreeFit(vector, starts, weights, loss, "", 0))
        groups = zip(lin.residual, lin.start, lin.shared, strict=True)
        out[key] = [
            [mark(loss), mark(r), mark(by_start), [mark(z) for z in np.moveaxis(shared, -1, 0)]]
            for r, by_start, shared in groups
        ]
    check(f"tree_{name}", out, LOOSE)


@pytest.mark.long
@pytest.mark.parametrize("name", ["motors", "servos"])
def test_columns_and_scores_of_candidates_are_the_same(posed_of, name):
    case = posed_of(name)
    starts = starts_of(case.problem)
    paths = run(case.problem, case.null, starts)
    weights = weigh(case.problem, paths)
    fit = TreeFit(case.null, starts, weights, losses(case.problem, paths, weights), "", 0)
    lin = linear(case.problem, fit)
    every = candidates(case.problem, case.null, case.reach)
    pairs = [(e, c.shaped()) for c in every for e in c.entries]
    columns = candidate_columns(case.problem, lin, pairs)
    out = {
        "columns": [[mark(z) for z in np.moveaxis(c, -1, 0)] for c in columns],
        "scores": [
            [
                s.candidate.effect,
                list(s.candidate.joints),
                s.candidate.sharing,
                s.held_out,
                s.p,
            ]
            for s in sorted(table(case.problem, lin, every), key=lambda s: s.candidate.key)
        ],
    }
    check(f"scores_{name}", out, LOOSE)


@pytest.mark.parametrize("name", TIERS)
def test_the_balance_misses_the_same(posed_of, name):
    case, out = posed_of(name), []
    for b in balances(case.problem, case.machine.tracks):
        own = within(part_of(case.null, b))
        commanded = case.machine.log.input_kind != "torque"
        state = Searched(case.problem, b, own, case.reach, Criteria(), commanded)
        every = separable_candidates(state)
        rows = {"windows": [mark(b.clear), mark(b.trial), mark(b.time)], "offered": []}
        for c in every:
            columns = [mark(state.table.of(e, c.shaped())) for e in c.entries]
            rows["offered"].append([c.effect, list(c.joints), c.sharing, dict(c.shape), columns])
        for key, vector in three(case).items():
            made = EffectTable(case.problem, b, part_of(vector, b))
            fitted = [mark(made.of(e)) for e in made.vector.entries]
            rows[key] = [mark(made.missing()), fitted]
        out.append(rows)
    check(f"balance_{name}", out, LOOSE)


@pytest.mark.parametrize("name", ["motors", pytest.param("servos", marks=[pytest.mark.long])])
def test_the_balance_is_searched_the_same(posed_of, name):
    case, out = posed_of(name), []
    commanded = case.machine.log.input_kind != "torque"
    for b in balances(case.problem, case.machine.tracks):
        own = within(part_of(case.null, b))
        found = search_group(case.problem, b, own, case.reach, Criteria(), commanded)
        rows = [
            [s.action, s.candidate.effect, list(s.candidate.joints), *(s.reason or ("", 0.0))[:2]]
            for s in found.steps
        ]
        named = [
            [n.candidate.effect, list(n.candidate.joints), n.test.gain, n.test.p, n.steady]
            + [[a.effect, list(a.joints)] for a in n.alternatives]
            for n in found.named
        ]
        out.append({"trace": rows, "named": named, "final": list(found.final.values)})
    check(f"search_balance_{name}", out, LOOSE)


def steps_of(found: Finding) -> list[list[Any]]:
    """The trace of a search: action, effect, joints, code and number."""
    return [
        [
            s.action,
            s.candidate.effect if s.candidate else "",
            list(s.candidate.joints) if s.candidate else [],
            *(s.reason or ("", 0.0))[:2],
        ]
        for s in found.trace
    ]


SOME = ("viscous", "coulomb", "armature", "stribeck", "delay", "torque_gain", "torque_limit")
LOW = Criteria(alpha=0.5, size=1e-4, confidence=0.4, worth=0.0)
"""A few stretches show little: levels at which searches go on."""
TREES: dict[str, tuple[str, tuple[str, ...], Criteria]] = {
    "replaced": ("motors", SOME, replace(LOW, gap=0.9, confidence=0.9)),
    "rotor": ("urdf", SOME, replace(LOW, confidence=0.6, steady=0.5)),
    "rare": (
        "motors",
        SOME,
        replace(LOW, outlying=1.1, few=1, explained=1e3, left=2.0, confidence=1.0),
    ),
    "servos": ("servos", FEW, LOW),
}
"""Machine, effects of the catalogue, and criteria of searches by simulated stretches."""


def tree_of(found: Selection) -> dict[str, Any]:
    """What a search by simulated stretches found."""
    named = [
        [n.candidate.effect, list(n.candidate.joints), n.test.gain, n.test.p, n.steady]
        + [[a.effect, list(a.joints)] for a in n.alternatives]
        for n in found.named
    ]
    return {
        "trace": steps_of(found),
        "named": named,
        "scores": [[s.candidate.effect, list(s.candidate.joints), s.p] for s in found.scores],
        "final": list(found.final.fit.vector.values),
        "last": [[s.candidate.effect, list(s.candidate.joints), s.p] for s in found.last],
        "stages": [[c.effect for c in m.added] for m in found.stages],
    }


LONG = ("rare", "servos", "replaced")  # more than ten seconds


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] if n in LONG else []) for n in TREES]
)
def test_stretches_are_searched_the_same(posed_of, name):
    machine, effects, criteria = TREES[name]
    case = posed_of(machine, effects)
    check(f"search_tree_{name}", tree_of(select(case.problem, case.null, criteria)), LOOSE)


@pytest.mark.long
def test_a_search_that_goes_on_from_another_is_the_same(posed_of):
    case = posed_of("motors", SOME)
    every = candidates(case.problem, case.null, case.reach)
    rubs = next(c for c in every if c.effect == "coulomb" and c.sharing == "all")
    vector = case.null.with_entries(rubs.entries, [0.05, 0.1])
    criteria = replace(LOW, steady=0.0)
    found = select(case.problem, case.null, criteria, hint=(vector, (rubs,)))
    check("search_tree_hint", tree_of(found), LOOSE)


def test_mujoco_predicts_the_same(tmp_path: Path):
    made = simulator(*read_source_and_log(record(tmp_path / "log", "servos")))
    values = np.array([q.default for q in made.quantities])
    scale = np.array([q.scale for q in made.quantities])
    which = np.arange(made.stretches.count)
    out: dict[str, Any] = {
        "quantities": [
            [q.name, q.unit, q.default, q.low, q.high, q.scale, q.prior] for q in made.quantities
        ],
        "declared": made.declared,
        "candidates": [[c.name, c.place, c.names, c.points] for c in made.candidates],
        "channels": [[c.name, c.unit, c.noise] for c in made.channels],
        "fold": mark(problem_of(made).fold),
    }
    for key, off in {
        "neutral": 0.0 * scale,
        "near": 0.3 * scale,
        "far": scale * np.sin(np.arange(len(scale))),
    }.items():
        rows = np.tile(values + off, (len(which), 1))
        out[key] = [
            mark(z) for z in np.moveaxis(made.predict(rows, made.stretches.start, which), -1, 0)
        ]
    rows = np.tile(values, (len(which), 1))
    columns = made.linearise(rows, made.stretches.start, which, np.diag(scale))
    out["columns"] = [[mark(z) for z in np.moveaxis(c, -1, 0)] for c in columns]
    check("mujoco_servos", out, LOOSE)


def test_a_simulator_of_ones_own_leaves_the_same():
    problem = problem_of(recorded({"leak": 0.004}, seed=3, trials=4))
    values = np.array([q.default for q in problem.quantities])
    scale = np.array([q.scale for q in problem.quantities])
    out: dict[str, Any] = {"fold": list(problem.fold), "block": list(problem.block)}
    for key, off in {"neutral": 0.0, "near": 0.5, "far": 2.0}.items():
        at = values + off * scale
        rows = np.tile(at, (len(problem.trials), 1))
        columns = problem.columns(at, np.diag(scale))
        out[key] = [mark(problem.residuals(rows)), [mark(z) for z in np.moveaxis(columns, -1, 0)]]
    check("own_tanks", out)
