"""Where a process runs: forks, switches of JAX, pipes of ASCII, no home, folders that cannot be
written, other versions.
"""

import errno
import json
import os
import re
import subprocess
import sys

import pytest

from adaptsim_jax import __version__
from adaptsim_jax.adaptation.sweep_folder import SweepFolder
from adaptsim_jax.cli import main
from adaptsim_jax.commands.robot_session import located
from adaptsim_jax.core import files, store
from adaptsim_jax.core.errors import BadInput
from tests.commands.test_train import SET
from tests.logs.arm_files import arm, write


@pytest.mark.parametrize(
    "code",
    [
        "import os, jax.numpy as jnp\nfrom adaptsim_jax.cli import main\nprint(jnp.ones(3).sum())\n"
        "pid = os.fork()\nif pid == 0: os._exit(main(['train', 'pendulum', '--run', 'r']))\n"
        "raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))"
    ],
)
def test_a_forked_worker_is_told_of_in_the_place_of_hanging(tmp_path, code):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert (
        done.returncode == 2
        and "get_context('spawn')" in done.stderr
        and not (tmp_path / "r").exists()
    )


def test_double_precision_is_put_off_and_an_ascii_pipe_is_written_to(tmp_path):
    env = os.environ | {
        "JAX_ENABLE_X64": "1",
        "PYTHONIOENCODING": "ascii",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    code = (
        "import sys; from adaptsim_jax.cli import main; code = main(['effects', 'pendulum'])\n"
        "print('a\xb7b'); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=env
    )
    assert (
        done.returncode == 0
        and "a\\xb7b" in done.stdout
        and "JAX_ENABLE_X64 is set and is not heeded" in done.stderr
    )


def said(code, **env):
    """The process that runs `code`, with the tests' environment and `env` (None: without)."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | env
    kept = {k: v for k, v in env.items() if v is not None}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=kept
    )


@pytest.mark.parametrize("switch", ["JAX_DEBUG_NANS", "JAX_DEBUG_INFS"])
def test_a_search_for_numbers_that_do_not_exist_is_put_off(switch):
    code = (
        "from adaptsim_jax.cli import main; code = main(['effects', 'pendulum'])\n"
        "import jax; print(jax.config.jax_debug_nans, jax.config.jax_debug_infs); raise "
        "SystemExit(code)"
    )
    done = said(code, **{switch: "True"})
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "False False"
    assert f"{switch} is set and is not heeded" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("switch", ["JAX_ENABLE_X64", "JAX_DEBUG_NANS"])
def test_a_run_is_trained_and_adapted_whatever_switches_are_set(tmp_path, switch):
    env = os.environ | {switch: "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    for words in (["train", "pendulum", "--run", "r", *SET], ["adapt", "r", "--target", "ood-1"]):
        command = [sys.executable, "-m", "adaptsim_jax", *words]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, timeout=600, env=env
        )
        assert done.returncode == 0, done.stderr


def test_without_a_home_the_cache_is_elsewhere(tmp_path):
    """As in a container whose user has neither HOME nor a name."""
    code = (
        "import pwd\n"
        "def nobody(*_): raise KeyError('no such user')\n"
        "pwd.getpwuid = pwd.getpwnam = nobody\n"
        "from adaptsim_jax.cli import main; from adaptsim_jax.core import process\n"
        "code = main(['effects', 'pendulum']); print(process.cache_folder()); raise "
        "SystemExit(code)"
    )
    bare = {
        k: None for k in ("HOME", "XDG_CACHE_HOME", "ADAPTSIM_CACHE", "JAX_COMPILATION_CACHE_DIR")
    }
    done = said(code, TMPDIR=str(tmp_path), **bare)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(str(tmp_path)) and "Traceback" not in done.stderr


@pytest.mark.parametrize("words", [("train", "pendulum", "--run"), ("diagnose", "DATA", "--out")])
def test_a_folder_that_cannot_be_written_is_told_before_any_work(
    tmp_path, capsys, monkeypatch, words
):
    data, out = write(tmp_path / "data", arm(count=3)), tmp_path / "out"
    out.mkdir()

    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(files.tempfile, "TemporaryFile", refuse)
    assert main([str(data) if w == "DATA" else w for w in words] + [str(out)]) == 2
    assert (
        f"{out}: cannot be written (Read-only file system); name a folder that you may write to"
        in capsys.readouterr().err
    )
    assert list(out.iterdir()) == []


def test_a_run_of_another_version_is_told_by_both_versions(tmp_path, capsys):
    run = store.RunFolder.create(tmp_path / "run", {"seed": 0}, task="pendulum")
    text = (run.path / "config.toml").read_text()
    (run.path / "config.toml").write_text(text.replace(f'"{store.__version__}"', '"9.8.7"'))
    assert main(["adapt", str(run.path), "--target", "wd"]) == 2
    told = capsys.readouterr().err
    assert "written by adaptsim_jax 9.8.7" in told and f"this is {store.__version__}" in told


def test_a_session_and_a_sweep_of_an_earlier_version_are_refused_by_one_line(tmp_path):
    (tmp_path / "robot.toml").write_text('schema = 1\nrun = "run"\nseed = 0\n')
    (tmp_path / "sweep.json").write_text('{"schema": 1, "version": "0.1.0", "plan": {}}')
    for read in (located, SweepFolder.load):
        this = re.escape(__version__)
        with pytest.raises(BadInput, match=rf"written by adaptsim_jax 0\.1.*this is {this}"):
            read(tmp_path)


def test_a_checkpoint_of_another_version_is_told_by_its_file(tmp_path):
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    (folder / store.MANIFEST).write_text(
        json.dumps({"package": "adaptsim_jax", "version": "9.8.7", "schema": 77})
    )
    with pytest.raises(
        BadInput, match=r"written by adaptsim_jax 9\.8\.7 \(schema 77\).*install that version"
    ):
        store.read_manifest(folder)
