"""A tiny run of Phase 1 that is stopped after its metrics and before their checkpoint, and resumed.
Kills of processes, at every moment, are in `tests/commands/test_train.py`.
"""

import pytest

from adaptsim_jax.adaptation import training
from adaptsim_jax.adaptation.training import TrainConfig, train_run
from adaptsim_jax.core import config
from adaptsim_jax.core.progress import silent
from adaptsim_jax.core.store import RunFolder
from tests.adaptation.toy import make_toy

PHASE1 = {
    "trajectories": 8,
    "parallel": 2,
    "horizon": 2,
    "updates": 1,
    "batch": 4,
    "capacity": 20,
    "archive": 20,
    "hidden": [4],
}


def contents(run):
    files = (path for path in run.path.rglob("*") if path.is_file())
    return {str(path.relative_to(run.path)): path.read_bytes() for path in files}


def test_stopped_and_resumed_it_ends_with_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "make_task", lambda *_: make_toy())
    settings = config.from_table(TrainConfig, {"every": 1, "phase1": PHASE1}, "test")
    table = config.to_table(settings)
    straight = RunFolder.create(tmp_path / "straight", table, task="toy")
    train_run(settings, straight, silent)

    stopped = RunFolder.create(tmp_path / "stopped", table, task="toy")
    save = RunFolder.save

    def killed(run, state, done):
        if done == 3:
            raise KeyboardInterrupt
        save(run, state, done)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(RunFolder, "save", killed)
        train_run(settings, stopped, silent)
    rows = stopped.metrics.read_text().splitlines()
    assert len(rows) == 3  # one more than the checkpoint has
    resumed = RunFolder.resume(stopped.path, table, task="toy")
    assert train_run(settings, resumed, silent).rounds == 4
    assert contents(resumed) == contents(straight)
