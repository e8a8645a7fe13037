"""A sweep over an environment: each member is the run that `train` makes and `adapt` adapts, with a
policy of its own seed, in the target's own world.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from adaptsim_jax.adaptation import sweep_run
from adaptsim_jax.adaptation.sweep_batch import MemberResult, Programs
from adaptsim_jax.adaptation.sweep_folder import SweepFolder
from adaptsim_jax.adaptation.sweep_plan import Split, make_mesh, make_plan
from adaptsim_jax.adaptation.sweep_read import read_sweep
from adaptsim_jax.adaptation.sweep_run import Held, run_sweep
from adaptsim_jax.adaptation.training import adapt_run, train_run
from adaptsim_jax.cli import main
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.store import RunFolder, read_manifest

ENV = """env = "tests.environments.cart:Cart"
references = 2
[targets.weak]
"params.push" = 1.0
[training]
steps = 800
parallel = 20
unroll = 20
hidden = [8]
[phase1]
trajectories = 4
parallel = 2
horizon = 2
updates = 2
capacity = 8
archive = 8
hidden = [8]
"""
SPEC = """task = "env.toml"
targets = ["weak"]
seeds = 2
starts = 1
iterations = 1
keep = true
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The sweep, its folder and its rows."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "env.toml").write_text(ENV)
    (folder / "spec.toml").write_text(SPEC)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ADAPTSIM_CACHE", str(folder / "cache"))
        sweep = read_sweep(folder / "spec.toml")
        made = SweepFolder.create(folder / "out", sweep, make_plan(sweep, devices=1))
        run_sweep(sweep, made)
        yield sweep, made, made.rows()


def test_a_member_is_the_run_that_train_and_adapt_make(swept, tmp_path):
    sweep, _, rows = swept
    member, row = sweep.members[1], rows[1]
    assert row["status"] == "done" and member.config.seed == 1
    folder = RunFolder.create(tmp_path / "run", configs.to_table(member.config), task="environment")
    trained = train_run(member.config, folder, lambda *told: None)
    curve = [line["final_reward"] for line in folder.read_metrics()]
    np.testing.assert_allclose(row["curve"], curve, rtol=1e-4, atol=1e-4)
    world = trained.phase1.task.world("weak")
    there = trained._replace(phase1=trained.phase1._replace(task=world))
    target = world.space.values(world.settings["weak"], "weak")
    alone = adapt_run(there, jax.random.key(1), target, starts=1, iterations=1)
    # float32 sums in another order
    rewards = row["targets"]["weak"]["rewards"]
    np.testing.assert_allclose(rewards, alone.history.reward, rtol=1e-3, atol=1e-3)


def test_a_kept_member_has_a_policy_of_its_own_and_adapts_to_what_its_row_says(swept, capsys):
    _, made, rows = swept
    runs = [made.path / f"runs/0000{i}" for i in (0, 1)]
    first, second = (read_manifest(run / "prepared")["sha256"] for run in runs)
    assert first != second
    words = ["--target", "weak", "--seed", "1", "--starts", "1", "--iterations", "1"]
    assert main(["adapt", str(runs[1]), *words]) == 0
    found = json.loads((runs[1] / "adapt-weak/result.json").read_text())
    best = rows[1]["targets"]["weak"]["reward"]
    assert found["best"]["reward"] == pytest.approx(best, abs=1e-3)


def test_members_that_do_not_fit_together_run_in_halves_that_do(swept, monkeypatch):
    """Memory is there for one member at a time."""
    sweep, made, _ = swept
    phase1 = SimpleNamespace(
        config=SimpleNamespace(rounds=1), task=SimpleNamespace(space=SimpleNamespace(dim=2))
    )
    mesh = make_mesh(Split(1, 1))

    def init(*given):
        if len(given[-1]) > 1:
            raise RuntimeError("RESOURCE_EXHAUSTED")
        return np.zeros(1)

    def advance(*given):
        return given[1], (np.zeros((1, 1)), np.ones((1, 1), bool))

    def finish(*given):
        return MemberResult(np.ones(1, bool), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((1, 0)))

    fake = Programs(phase1, mesh, 2, lambda *given: (), init, advance, finish)
    monkeypatch.setattr(sweep_run, "make_programs", lambda *given: fake)
    bare = sweep._replace(spec=replace(sweep.spec, targets=[], keep=False))
    rows = sweep_run.rows_of(Held(bare, made), made.plan.batches[0], lambda *told: None, 30.0)
    assert [row["status"] for row in rows] == ["done", "done"]
