"""What real data and real days do, from the command line: told with what to write, before a model is judged."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from adaptsim_jax.cli import main
from tests.sysid.arm_files import arm, write


def refused(capsys, *words):
    """What `adaptsim` says of a command that it refuses, in its one line."""
    assert main([str(w) for w in words]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("adaptsim:")]
    assert len(told) == 1
    return told[0]


def comma(x):
    return '"' + f"{x:.6f}".replace(".", ",") + '"'


def joined(c):
    """Two topics on one time axis by an outer join."""
    rows = [{k: f"{c[k][i]:.7g}" for k in names} | {"time": f"{c['time'][i] + late:.4f}"}
            for i in range(len(c["time"])) for late, names in ((0.0, ("q1", "q2")), (0.0013, ("tau1", "tau2")))]  # fmt: skip
    return {k: [row.get(k, "") for row in rows] for k in ("time", "q1", "q2", "tau1", "tau2")}


EPOCH = 1.7e9
SPOILED = {
    "joined": (joined, "as topics joined by time do"),
    "commas": (lambda c: {k: [comma(v) for v in x] for k, x in c.items()}, "decimal comma"),
    "float32": (lambda c: c | {"time": (c["time"] + EPOCH).astype(np.float32)}, "save it as float64"),
    "ms": (lambda c: c | {"time": 1e3 * c["time"]}, 'time = "ms"'),
    "us": (lambda c: c | {"time": 1e6 * c["time"]}, 'time = "us"'),
    "ns": (lambda c: c | {"time": 1e9 * (c["time"] + EPOCH)}, 'time = "ns"'),
    "back": (lambda c: c | {"time": np.where(c["time"] > 1.0, c["time"] - 0.5, c["time"])}, "time runs backwards"),
    "needed": (lambda c: c | {"q2": ["nan"] * len(c["time"])}, "column q2 holds no number"),
    "hole": (lambda c: c | {"tau1": np.where(c["time"] == 0.5, np.nan, c["tau1"])}, "column tau1 is nan"),
    "swapped": (lambda c: c | {"tau1": c["tau2"], "tau2": c["tau1"]}, "exchange columns tau1 and tau2"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_log_is_refused_with_a_mend(tmp_path, capsys, name):
    spoil, says = SPOILED[name]
    data = write(tmp_path / "data", [spoil(c) for c in arm()])
    assert says in refused(capsys, "diagnose", data, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_data_folder_is_no_place_for_the_report(tmp_path, capsys):
    data = write(tmp_path / "data", arm(count=2))
    assert "is the folder of the recordings" in refused(capsys, "diagnose", data, "--out", data)
    assert sorted(p.name for p in data.iterdir()) == ["00.csv", "01.csv", "meta.toml"]


def test_trials_to_leave_out_are_checked(tmp_path, capsys):
    data = write(tmp_path / "data", arm(count=2))
    assert "no trial is named '07'" in refused(capsys, "diagnose", data, "--out", tmp_path / "o", "--without", "07")
    assert "leave some" in refused(capsys, "diagnose", data, "--out", tmp_path / "o", "--without", "00,01")


@pytest.mark.parametrize("code", [
    "import os, jax.numpy as jnp\nfrom adaptsim_jax.cli import main\nprint(jnp.ones(3).sum())\n"
    "pid = os.fork()\nif pid == 0: os._exit(main(['train', 'pendulum', '--run', 'r']))\n"
    "raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))",
])  # fmt: skip
def test_a_forked_worker_is_told_of_in_the_place_of_hanging(tmp_path, code):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert done.returncode == 2 and "get_context('spawn')" in done.stderr and not (tmp_path / "r").exists()


def test_double_precision_is_put_off_and_an_ascii_pipe_is_written_to(tmp_path):
    env = os.environ | {"JAX_ENABLE_X64": "1", "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(sys.path)}
    code = (
        "import sys; from adaptsim_jax.cli import main; code = main(['effects', 'pendulum'])\n"
        "print('a\xb7b'); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=env)
    assert (
        done.returncode == 0 and "a\\xb7b" in done.stdout and "JAX_ENABLE_X64 is set and is not heeded" in done.stderr
    )


@pytest.mark.slow
def test_blank_velocities_are_left_out_with_a_note(tmp_path):
    nothing = lambda c: {k: [""] * len(c["time"]) for k in ("v1", "v2")}
    data = write(tmp_path / "data", [c | nothing(c) for c in arm()])
    assert main(["diagnose", str(data), "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert any("v1, v2 held no number in 00.csv" in note for note in report["notes"]) and report["warnings"] == []
