"""Numbers by trial and log: which log is marked, what a null marks, what can be exchanged."""

import numpy as np
import pytest

from adaptsim_jax.diagnosis.numbers import Evidence, Number, add_numbers, tabled

LOGS, TRIALS, BLOCKS, ROWS = 5, 3, 4, 40


def recorded(off: dict[int, np.ndarray], seed: int, logs: int = LOGS):
    """Rows of `y = x . truth + noise`, in which a log's truth may be `off`; the fit of all, and
    evidence about it.
    """
    rng = np.random.default_rng(seed)
    truth, hess, slope, trial = np.array([1.0, 2.0, -1.0]), [], [], []
    rows = []
    for log in range(logs):
        for t in range(TRIALS):
            for _ in range(BLOCKS):
                x = rng.normal(size=(ROWS, 3))
                x[:, 2] = x[:, 1] + 0.2 * x[:, 2]  # the second and third look alike
                y = x @ (truth + off.get(log, 0.0)) + rng.normal(size=ROWS)
                rows.append((x, y))
                trial.append(log * TRIALS + t)
    fit = np.linalg.lstsq(
        np.concatenate([x for x, _ in rows]), np.concatenate([y for _, y in rows])
    )
    for x, y in rows:
        hess.append(x.T @ x)
        slope.append(x.T @ (y - x @ fit[0]))
    none = np.zeros((3, 3))
    evidence = Evidence(np.array(hess), np.array(slope), none, none[0], np.array(trial))
    numbers = [Number(f"n{k}", "1", z, 0.0, np.eye(3)[k]) for k, z in enumerate(fit[0])]
    names = [f"day{k // TRIALS}/t{k % TRIALS}" for k in range(logs * TRIALS)]
    return numbers, evidence, names, [name.split("/")[0] for name in names]


def test_the_log_that_differs_is_marked_at_the_number_that_differs():
    rows = tabled(*recorded({3: np.array([0.8, 0.0, 0.0])}, seed=0))
    assert [row["apart"] for row in rows] == [["day3"], [], []]
    assert rows[0]["low"] < 1.0 < rows[0]["high"]  # an interval over days holds what most say
    own = {e["of"]: e for e in rows[0]["each"]}
    assert own["day3"]["low"] < 1.8 < own["day3"]["high"]
    assert rows[0]["logs"] > 3.0 * rows[1]["logs"] / 5.0 and rows[0]["trials"] > rows[0]["logs"] / 2


def test_two_logs_that_differ_are_both_marked():
    """Nothing tells which of two is wrong."""
    rows = tabled(*recorded({1: np.array([0.8, 0.0, 0.0])}, seed=0, logs=2))
    assert rows[0]["apart"] == ["day0", "day1"]


def test_what_looks_alike_can_be_exchanged():
    rows = tabled(*recorded({}, seed=1))
    assert [other["name"] for other in rows[1]["like"]] == ["n2"] and not rows[0]["like"]
    assert rows[1]["like"][0]["correlation"] < -0.9


def test_logs_of_one_machine_are_rarely_marked():
    """Of 100 tables at a level of 0.01 each: one on average, five in less than one of 200."""
    marked = sum(any(r["apart"] for r in tabled(*recorded({}, seed))) for seed in range(100, 200))
    assert marked <= 5


def test_one_log_goes_by_its_trials():
    numbers, evidence, names, _ = recorded({4: np.array([1.5, 0.0, 0.0])}, seed=2)
    rows = tabled(numbers, evidence, names, names)
    assert rows[0]["logs"] is None and len(rows[0]["each"]) == len(names)
    assert set(rows[0]["apart"]) >= {"day4/t0", "day4/t1", "day4/t2"}


def test_a_log_apart_is_a_warning():
    report, evidence = {"warnings": ["before"]}, {"audit": []}
    rows = tabled(*recorded({3: np.array([0.8, 0.0, 0.0])}, seed=0))
    add_numbers(report, evidence, rows, [f"day{k}" for k in range(LOGS)])
    assert len(report["warnings"]) == 2 and "The log day3 contradicts" in report["warnings"][1]
    assert evidence["audit"][0]["severity"] == "warn"
    add_numbers(report, evidence, rows, ())
    assert len(report["warnings"]) == 2
    assert report["numbers"][0]["value"] == pytest.approx(rows[0]["value"])
