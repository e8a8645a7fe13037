"""A log reader of another package: one file and one entry point."""

import importlib.util
import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs import read, readers
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.read import read_log
from tests.logs.arm_files import arm
from tests.logs.measured_files import csv_text

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_robot" / "my_robot" / "jsonl.py"


@pytest.fixture
def installed(monkeypatch):
    """The example's reader, as installing it would make it known."""
    spec = importlib.util.spec_from_file_location("jsonl_example", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setitem(__import__("sys").modules, "jsonl_example", module)
    point = EntryPoint("jsonl", "jsonl_example:READER", "adaptsim.log_readers")
    monkeypatch.setitem(readers.READERS.others, "jsonl", point)


def written(folder, count=2):
    """Trials of an arm as objects by line."""
    folder.mkdir()
    trials = arm(count=count)
    for k, c in enumerate(trials):
        rows = zip(*(c[n] for n in ("time", "q1", "q2", "tau1", "tau2")), strict=True)
        lines = [
            json.dumps({"time": t, "angles": [a, b], "torques": [u, w]}) for t, a, b, u, w in rows
        ]
        (folder / f"{k:02d}.jsonl").write_text("\n".join(lines))
    return trials


def test_it_is_read_as_any_log(tmp_path, installed):
    trials = written(tmp_path / "logs")
    log = read_log(tmp_path / "logs", ("shoulder", "elbow"))
    assert [t.name for t in log.trials] == ["00", "01"] and log.input_kind == "torque"
    np.testing.assert_allclose(log.trials[1].q[:, 1], trials[1]["q2"])
    one = read_log(tmp_path / "logs" / "00.jsonl", ("shoulder", "elbow"))
    np.testing.assert_allclose(one.trials[0].u[:, 0], trials[0]["tau1"])


def test_it_goes_with_meta_toml_and_tables(tmp_path, installed):
    trials = written(tmp_path / "logs")
    (tmp_path / "logs" / "table.csv").write_text(csv_text(trials[0]))
    meta = 'task = "mechanism"\n[units]\nangle = "deg"\n[trials]\nexclude = ["01"]\n'
    (tmp_path / "logs" / "meta.toml").write_text(meta)
    (tmp_path / "logs" / "01.jsonl").write_text("torn")  # what is left out is not looked at
    log = read_log(tmp_path / "logs", ("shoulder", "elbow"))
    assert sorted(t.name for t in log.trials) == ["00", "table"]
    for trial in log.trials:
        np.testing.assert_allclose(trial.q[:, 0], np.radians(trials[0]["q1"]), atol=1e-9)


def test_a_damaged_line_is_refused_and_init_knows_the_columns(tmp_path, installed):
    written(tmp_path / "logs", count=1)
    begun = begin(tmp_path / "logs", None, None, {})
    assert begun.log is not None and begun.log.joint_names == ("joint1", "joint2")
    path = tmp_path / "logs" / "00.jsonl"
    path.write_text(path.read_text().replace('"angles"', '"angels"', 1))
    with pytest.raises(BadInput, match=r"00\.jsonl: line 1"):
        read_log(tmp_path / "logs")


def test_without_it_the_message_names_what_is_read(tmp_path):
    written(tmp_path / "logs", count=1)
    with pytest.raises(BadInput, match=r"holds no \.csv, \.npz"):
        read_log(tmp_path / "logs")
    with pytest.raises(BadInput, match=r"ends in \.csv, \.npz, \.bag"):
        read.read_raw(tmp_path / "logs" / "00.jsonl", read.LogMeta())
