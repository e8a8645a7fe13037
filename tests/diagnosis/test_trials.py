"""Selection over independent trials, on a linear problem whose truth is known."""

import json
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.experiment import separated_by
from adaptsim_jax.diagnosis.fit import fitted, settled
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.rows import (
    Recorded,
    _standing_out,
    error_table,
    headline,
    label,
    over_floor,
)
from adaptsim_jax.diagnosis.run import Run
from adaptsim_jax.diagnosis.schema import new_report
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.diagnosis.written import MODEL, Output, cleared, finished, planned
from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.mend.model_toml import Form

TRIALS, ROWS = 14, 60


def problem(truth, seed=0, trials=TRIALS):
    """Trials that are linear in four quantities: a is declared; b, c and the pair (d) that does
    what b does are effects.
    """
    rng = np.random.default_rng(seed)
    basis = rng.standard_normal((trials, ROWS, 3))
    basis = np.concatenate([basis, basis[..., 1:2] * 2.0], -1)
    seen = basis @ np.array(truth) + rng.standard_normal((trials, ROWS))

    def quantity(n):
        return Quantity(n, "", -5.0, 5.0, prior=10.0, scale=0.1)

    def effect(n):
        return Effect(n, "force", (quantity(n),), physics="a column", excitation="any trial")

    return Problem(
        tuple(map(quantity, "abcd")),
        ("a",),
        tuple(map(effect, "bcd")),
        lambda values: seen - np.einsum("trk,tk->tr", basis, values),
        lambda values, b: basis @ b.T,
        np.full(trials, float(ROWS)),
        tuple(map(str, range(trials))),
        np.zeros((1, 4)),
    )


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_named_where_nothing_lacks(seed):
    found = search_trials(problem((0.7, 0.0, 0.0, 0.0), seed), Criteria())
    assert not found.named
    assert abs(found.final.fit.values[0] - 0.7) < 0.2
    assert 0.8 < found.final.fit.held.mean() < 1.2


def test_an_effect_is_named_and_its_size_found():
    found = search_trials(problem((0.7, 0.0, 0.8, 0.0)), Criteria())
    (named,) = found.named
    assert named.candidate.name == "c"
    assert not named.alternatives
    assert abs(found.final.fit.values[2] - 0.8) < 0.2


def test_five_trials_can_show_an_effect_at_any_level_if_all_are_better():
    (named,) = search_trials(
        problem((0.7, 0.0, 0.8, 0.0), trials=5), Criteria(confidence=0.01)
    ).named
    assert named.candidate.name == "c" and named.test.better == named.test.folds == 5
    assert 0.01 < named.test.p < 0.05


def test_an_effect_at_its_bound_is_not_named_and_says_so():
    lacks = problem((0.7, 0.0, 0.8, 0.0))
    narrow = replace(
        lacks,
        quantities=(
            *lacks.quantities[:2],
            replace(lacks.quantities[2], high=0.5),
            lacks.quantities[3],
        ),
    )
    found = search_trials(narrow, Criteria())
    assert not found.named and [s.reason.code for s in found.trace if s.action == "dropped"] == [
        "at_bound"
    ]
    endless = replace(
        lacks, quantities=tuple(replace(q, low=-np.inf, high=np.inf) for q in lacks.quantities)
    )
    assert [n.candidate.name for n in search_trials(endless, Criteria()).named] == ["c"]


@pytest.mark.parametrize(("matters", "names"), [(0.5, ["c"]), (9.0, [])])
def test_what_changes_less_than_matters_is_not_named(matters, names):
    """0.8 is eight times the scale of 0.1."""
    found = search_trials(problem((0.7, 0.0, 0.8, 0.0)), Criteria(matters=matters))
    assert [n.candidate.name for n in found.named] == names
    assert names or "less_than_matters" in [s.reason.code for s in found.trace if s.reason]


def test_a_model_that_is_taken_is_fitted_on_with_starts_found_anew():
    told = []
    lacks = replace(problem((0.7, 0.0, 0.8, 0.0)), anew=told.append)
    (named,) = search_trials(lacks, Criteria()).named
    assert named.candidate.name == "c" and len(told) == 2 and abs(told[0][2] - 0.8) < 0.2


def test_two_effects_that_do_the_same_are_told_as_a_class():
    found = search_trials(problem((0.7, 0.8, 0.0, 0.0)), Criteria())
    (named,) = found.named
    assert {named.candidate.name, *[e.name for e in named.alternatives]} == {"b", "d"}


def test_an_effect_smaller_than_what_no_effect_explains_is_not_named():
    """Another law of motion, the same in all trials, beside an effect of its size and beside one
    that is far larger.
    """
    other = 1.6 * np.sin(np.arange(ROWS))
    for size, names in ((1.5, []), (4.5, ["c"])):
        linear = problem((0.7, 0.0, size, 0.0))
        odd = replace(linear, residuals=lambda values, r=linear.residuals: r(values) + other)
        assert [n.candidate.name for n in search_trials(odd, Criteria()).named] == ["c"]
        assert [
            n.candidate.name
            for n in search_trials(odd, Criteria(beyond=0.9, lacks_nothing=1.14)).named
        ] == names


def test_what_is_missing_from_a_model_that_leaves_the_noise_is_not_named():
    """Beside a large effect, one that a hundred rows show and no eye would."""
    small = problem((0.7, 0.4, 4.5, 0.0))
    assert len(search_trials(small, Criteria()).named) == 2
    assert [n.candidate.name for n in search_trials(small, Criteria(lacks_nothing=1.14)).named] == [
        "c"
    ]


def test_a_fit_that_leaves_structure_is_begun_again_from_beside():
    """Two minima, of which the nearer is the worse."""

    def wells(a):
        return np.stack([10.0 * (a**2 - 1.0), 2.0 * (a - 1.0)], 1)

    def slopes(values, basis):
        return np.tile(np.array([20.0 * values[0], 2.0])[:, None] * basis[:, 0], (TRIALS, 1, 1))

    two = Problem(
        (Quantity("a", "", -5.0, 5.0, prior=100.0, scale=1.8),),
        ("a",),
        (),
        lambda values: -wells(values[:, 0]),
        slopes,
        np.full(TRIALS, 2.0),
        tuple(map(str, range(TRIALS))),
        np.zeros((1, 1)),
    )
    begin = np.array([-1.2])
    assert fitted(two, ["a"], begin, 10)[0][0] < -0.9
    assert settled(two, ["a"], begin, 10)[0][0] < -0.9  # nothing is declared that may be moved
    assert abs(settled(replace(two, again=("a",)), ["a"], begin, 10)[0][0] - 1.0) < 1e-3


def test_a_folder_gets_the_report_also_without_a_page_and_nothing_stays_of_an_earlier_run(tmp_path):
    (tmp_path / "leading.toml").write_text("")
    counts = {"trials": 3, "samples": 3, "held_out_trials": 3}
    report = new_report("pushing", "the push", "within_noise", "Nothing.", counts)
    plan = {"message": "push fast", "separates": ["b", "d"], "rows": [[0.5, 0.1]]}
    model = Form("pushing", "the push")
    files = {MODEL: model.text, **planned(report, plan, ("speed", "angle"))}
    run = Run("adaptsim diagnose logs", time.monotonic())
    told = finished(report, {}, run, Output(cleared(tmp_path), files=files))
    assert json.loads((tmp_path / "report.json").read_text())["run"] == told["run"]
    assert (
        tmp_path / "next_experiment.csv"
    ).read_text() == "trial,speed,angle\n1,0.500000,0.100000\n"
    assert (tmp_path / "model.toml").read_text() == model.text() and not (
        tmp_path / "leading.toml"
    ).exists()


def test_a_few_trials_far_worse_than_the_others_are_told():
    seen = SimpleNamespace(trial="push", trials="pushes", names=tuple("abcdefgh"))

    def model(held):
        return SimpleNamespace(fit=SimpleNamespace(held=np.square(held)))

    assert _standing_out(seen, model([1, 2, 1, 1, 3, 1, 1, 1])) == ""
    told = _standing_out(seen, model([1, 2, 9, 1, 3, 1, 1, 8]))
    assert (
        told
        == " Pushes c, h stand out with up to 6 times the error of the others: are their tracks "
        "right? --without c,h"
    )
    assert _standing_out(seen, model([1, 9, 9, 1, 9, 1, 1, 1])) == ""


def test_the_message_and_the_table_tell_one_error():
    model = SimpleNamespace(fit=SimpleNamespace(held=np.square([1.0, 2.0, 10.0, 20.0])))
    found = SimpleNamespace(named=(), null=model, final=model)
    rows = np.zeros((4, 3, 2))
    seen = Recorded(
        "push",
        "pushes",
        tuple("abcd"),
        rows[..., 0],
        rows,
        rows[..., 0] + 1.0,
        ("x", "y"),
        5e-4,
        "given",
    )
    assert error_table(seen, found, {"before": rows, "after": rows})["before"] == pytest.approx(
        3e-3
    )
    assert (
        "to 3 mm, 6.0 times the noise floor"
        in headline(seen, found, over_floor(model), 7.0).declared
    )


def test_the_next_experiment_shows_one_of_a_class_by_itself():
    """What shows the name, and what shows its look-alike, each once; none for a name that stands
    alone.
    """
    found = search_trials(problem((0.7, 0.5, 0.0, 0.0)), Criteria())
    shown = {"b": "fast motion", "d": "slow motion"}.get

    def plan(finding):
        text = "{} or {}: record {}."
        return separated_by(finding, label, lambda z: z.words, lambda z: shown(z.name, ""), text)

    assert plan(found) == {
        "message": "b at force or d at force: record fast motion; or slow motion.",
        "separates": ["b", "d"],
    }
    assert plan(search_trials(problem((0.7, 0.0, 0.8, 0.0)), Criteria())) is None
