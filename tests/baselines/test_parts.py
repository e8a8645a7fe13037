"""A comparison that fails late keeps what is done, and goes on there to the same results."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.baselines import compare_exact as exact
from adaptsim_jax.baselines import compare_learned as learned
from adaptsim_jax.baselines import compare_steps as steps
from adaptsim_jax.baselines.arena import Visits
from adaptsim_jax.baselines.compare import compared
from adaptsim_jax.baselines.compare_steps import Deployed
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.results import FOLDER, ComparisonParts, parts_of, row
from adaptsim_jax.cli import main
from tests.baselines.probe import probe_task


class Broken(Exception):
    """What a method fails with."""


class Counted:
    """A method that counts its calls, and fails at those whose number is in `fails`."""

    def __init__(self, result, *fails):
        self.result, self.fails, self.calls = result, fails, 0

    def __call__(self, *given):
        self.calls += 1
        if self.calls in self.fails:
            raise Broken
        return self.result(*given) if callable(self.result) else self.result


def kept(out: Path) -> list[str]:
    return sorted(p.stem for p in (out / FOLDER).glob("*/*.json"))


def test_a_part_is_made_once_and_gone_after_all_is_written(tmp_path):
    parts, make = (
        parts_of(tmp_path, "pendulum", CompareConfig()),
        Counted({"mean": None, "curve": [1.5, 0.1]}),
    )
    assert (
        parts.of("udr", make) == parts.of("udr", make) == {"mean": None, "curve": [1.5, 0.1]}
        and make.calls == 1
    )
    (parts.folder / "udr.json").write_text('{"mean": ')  # cut off by what no program can help
    assert parts.of("udr", make) == make.result and make.calls == 2
    other = parts_of(tmp_path, "pendulum", CompareConfig(iterations=11))
    assert other.get("udr") is None
    other.put("oracle", 1.0)
    parts.drop()
    assert kept(tmp_path) == ["oracle"]  # of another configuration, whose work is not lost
    other.drop()
    assert list(tmp_path.iterdir()) == []


def test_other_methods_are_the_same_comparison_and_without_a_folder_nothing_is_kept(
    tmp_path, capsys
):
    parts_of(tmp_path, "pendulum", CompareConfig(methods=("udr",))).put("udr", [1])
    assert "going on" not in capsys.readouterr().err
    assert parts_of(tmp_path, "pendulum", CompareConfig(methods=("adaptsim",))).get("udr") == [1]
    assert f"{tmp_path / FOLDER} holds 1 part of" in capsys.readouterr().err
    assert parts_of(str(tmp_path), "pendulum", CompareConfig()).get("udr") == [1]
    make = Counted([1])
    for _ in range(2):
        assert ComparisonParts().of("udr", make) == [1]
    assert make.calls == 2


def test_the_command_goes_on_after_a_late_failure_to_the_same_results(
    tmp_path, monkeypatch, capsys
):
    curves = np.random.default_rng(0).uniform(0.0, 1.0, (2, 3))
    first, second = Counted(curves), Counted(curves, 1)
    monkeypatch.setattr(exact, "EXACT", {"adaptsim": first, "sysid_point": second})
    best: Any = SimpleNamespace(mean=np.zeros((1, 2)))
    ends = exact.Bounds(best, *np.array([[2.0], [1.0], [1.0]]))
    monkeypatch.setattr(exact, "find_bounds", lambda *given: ends)

    def rows(method, names, arena, bounds, made):
        return [row(method, n, made, oracle=1.0, target_trials=3) for n in names]

    monkeypatch.setattr(exact, "visiting_rows", rows)
    command = [
        "compare",
        "pendulum",
        "--seeds",
        "2",
        "--settings",
        "wd",
        "--methods",
        "adaptsim,sysid-point,udr",
    ]
    out = tmp_path / "out"
    assert main([*command, "--out", str(out)]) == 1
    assert (
        f"what was done is kept in {out / FOLDER}; the same command goes on there"
        in capsys.readouterr().err
    )
    assert kept(out) == ["adaptsim"] and not (out / "results.json").exists()
    assert main([*command, "--out", str(out)]) == 0
    assert (first.calls, second.calls) == (1, 2) and not (out / FOLDER).exists()
    found = json.loads((out / "results.json").read_text())["rows"]
    assert found[:2] == [
        row(m, "wd", curves, oracle=1.0, target_trials=3) for m in ("adaptsim", "sysid_point")
    ]
    assert found[2]["method"] == "udr"


def test_learned_policies_keep_each_method_and_the_oracle(tmp_path, monkeypatch):
    visits = Visits(None, np.arange(1, 3), np.array([[[[0.1, 0.3]]]]))
    first, second = Counted(visits), Counted(visits, 1)
    monkeypatch.setattr(learned, "LEARNED", {"udr": first, "adaptsim": second})
    arena = SimpleNamespace(fresh=[], failed=np.zeros(1, int), made=np.ones(1, int))
    monkeypatch.setattr(learned, "Arena", lambda *given: arena)
    oracle = Counted(np.array([0.5, 0.75], np.float32))
    task = replace(probe_task(), settings={"wd": {"a": 1.5, "b": 20.0}})
    one = SimpleNamespace(
        task=task,
        scored=np.zeros((1, 1)),
        engine="e",
        world=lambda *a, **k: SimpleNamespace(name="w"),
        oracle=oracle,
        simulator="s",
        reward_unit="r",
        oracle_means="o",
    )
    config = CompareConfig(methods=("udr", "adaptsim", "oracle"), seeds=1)

    def run(out):
        return compared(learned.LearnedComparison(one, ["wd"], config), out=out)  # type: ignore[arg-type]

    with pytest.raises(Broken):
        run(tmp_path)
    assert kept(tmp_path) == ["oracle-rewards", "udr"]
    rows, about = run(tmp_path)
    assert (first.calls, second.calls, oracle.calls) == (1, 2, 1)
    whole = run(None)
    assert rows == whole[0] and about | {"digest": ""} == whole[1]


def test_policies_over_many_steps_keep_each_seed_of_each_method(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    returns = {
        (s, m): rng.uniform(1.0, 2.0, (1, 2)).astype(np.float32)
        for s in range(3)
        for m in ("udr", "oracle")
    }
    returns[2, "adaptsim"] = returns[1, "adaptsim"] = returns[0, "adaptsim"] = np.array(
        [[np.nan, 1.5]], np.float32
    )
    asked, fails = [], [(1, "oracle")]

    def deployed_by(method, run):
        seed = int(run.seeds[0])
        asked.append((seed, method))
        if fails and fails[0] == (seed, method):
            fails.pop()
            raise Broken
        return Deployed(np.arange(2), returns[seed, method])

    trained = Counted(lambda task, made, seed, *rest: seed)
    setting = SimpleNamespace(
        config=SimpleNamespace(policy="knows"),
        targets={"dry": SimpleNamespace(engine="mujoco", values=np.ones(1))},
        sim=SimpleNamespace(name="cart", native=None),
        fields=[SimpleNamespace(name="mass")],
        space=SimpleNamespace(dim=2),
    )
    for name, thing in (
        ("deployed_by", deployed_by),
        ("StepsArena", lambda *given: None),
        ("learned", trained),
        (
            "task_of",
            lambda s: SimpleNamespace(
                name="environment", preparation=SimpleNamespace(digest=lambda: "d")
            ),
        ),
    ):
        monkeypatch.setattr(steps, name, thing)
    config = CompareConfig(methods=("udr", "adaptsim"), seeds=3)

    def run(out, config=config):
        return compared(steps.StepsComparison(setting, ["dry"], config), out=out)  # type: ignore[arg-type]

    with pytest.raises(Broken):
        run(tmp_path)
    assert kept(tmp_path) == ["seed-0-adaptsim", "seed-0-oracle", "seed-0-udr", "seed-1-udr"]
    asked.clear()
    found = run(tmp_path)
    assert asked == [(1, "oracle"), (1, "adaptsim"), (2, "udr"), (2, "oracle"), (2, "adaptsim")]
    assert trained.calls == 4  # seed 0's policy is not asked for again
    whole = run(None)
    assert found[0] == whole[0] and found[0][1]["at"]["0"] is None
    asked.clear()
    run(tmp_path, CompareConfig(methods=("udr",), seeds=2, seed=1))  # seeds are parts of their own
    assert asked == []
