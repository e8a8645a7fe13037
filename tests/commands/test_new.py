"""`adaptsim new` writes files that run; `adaptsim completion` knows every command and option."""

import subprocess
import sys

import mujoco
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.completion import options_of
from adaptsim_jax.sysid.io.read import read_with_model


@pytest.mark.parametrize("kind, tells", [("effect", "0.1"), pytest.param("task", "reward", marks=pytest.mark.slow)])
def test_a_file_of_python_runs(kind, tells, tmp_path, capsys):
    assert main(["new", kind, "cable_drag", "--dir", str(tmp_path)]) == 0
    assert f"next: python {tmp_path / 'cable_drag.py'}" in capsys.readouterr().out
    done = subprocess.run(
        [sys.executable, "-W", "error", "cable_drag.py"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert tells in done.stdout


def test_a_mechanism_is_one_that_logs_can_be_read_with(tmp_path):
    assert main(["new", "mechanism", "arm", "--dir", str(tmp_path)]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert (model.nq, model.nu) == (2, 2)
    rows = "".join(f"{0.01 * k:.2f},0.1,0.2,0,0\n" for k in range(30))
    (tmp_path / "log.csv").write_text("time,q_shoulder,q_elbow,tau_shoulder,tau_elbow\n" + rows)
    _, log = read_with_model(tmp_path / "log.csv", tmp_path / "arm.xml")
    assert log.joint_names == ("shoulder", "elbow")


def test_nothing_is_overwritten_and_names_are_checked(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text("mine")
    assert main(["new", "mechanism", "arm", "--dir", str(tmp_path)]) == 2
    assert (tmp_path / "arm.xml").read_text() == "mine"
    assert main(["new", "effect", "My-Effect", "--dir", str(tmp_path)]) == 2
    assert main(["new", "effect", "lambda", "--dir", str(tmp_path)]) == 2
    assert "letters in lower case" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_holds_all(shell, capsys):
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    for name in SUMMARIES:
        for option in options_of(name):
            assert name in text and option.removeprefix("--" if shell == "fish" else "") in text


def test_bash_completes(capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    ask = 'COMP_WORDS=(adaptsim {}); COMP_CWORD={}; _adaptsim; echo "${{COMPREPLY[@]}}"\n'
    script += ask.format("dia", 1) + ask.format("train pend", 2) + ask.format("diagnose --with", 2)
    found = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True).stdout
    assert found.split("\n")[:3] == ["diagnose", "pendulum", "--without"]
