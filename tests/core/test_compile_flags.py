"""Flags for XLA that the command line sets, and when it leaves them alone."""

import os
import subprocess
import sys

import pytest

from adaptsim_jax.core import process

NOTHING_SET = {name: value for name, value in os.environ.items() if name != process.NAME}


def ended(code: str, **more: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=NOTHING_SET | more
    )


def test_this_xla_takes_the_flags_and_gives_the_same_numbers():
    """An unknown flag ends the process, so that one must compile something."""
    code = (
        "from adaptsim_jax.core import process; print(process.small_steps()); import jax, "
        "jax.numpy as jnp;print(jax.jit(lambda x: jax.lax.fori_loop(0, 50, lambda i, x: "
        "jnp.sin(x) + x[::-1], x))(jnp.ones(3))[0])"
    )
    flagged, plain = ended(code), ended(code.replace("process.small_steps()", "True"))
    assert flagged.returncode == 0, flagged.stderr
    assert flagged.stdout.split()[0] == "True"
    assert float(flagged.stdout.split()[1]) == pytest.approx(
        float(plain.stdout.split()[1]), rel=1e-5
    )


def test_the_users_own_flags_stay(monkeypatch):
    monkeypatch.setenv(process.NAME, "")
    assert not process.small_steps()
    assert os.environ[process.NAME] == ""


def test_another_jaxlib_gets_none_and_the_user_is_informed(monkeypatch, capsys):
    monkeypatch.delenv(process.NAME, raising=False)
    monkeypatch.setattr(process.metadata, "version", lambda name: "9.1.0")
    assert not process.small_steps()
    assert process.NAME not in os.environ
    said = capsys.readouterr().err
    assert "jaxlib 9.1.0" in said and said.count("\n") == 1
