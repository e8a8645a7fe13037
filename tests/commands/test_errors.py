"""Exit codes, and one line for whatever a person gets wrong."""

import errno
import os
import signal
import subprocess
import sys
import types

import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.commands import parser
from adaptsim_jax.commands.parser import check_task
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.registry import TASKS


def refused(capsys, *arguments):
    """The one line on standard error, without the program's name."""
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("adaptsim: ") and captured.err.count("\n") == 1
    return captured.err.removeprefix("adaptsim: ").rstrip("\n")


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["trian"], "unknown command 'trian'; did you mean 'train'?"),
        (["xyz"], "unknown command 'xyz'; known: demo, train"),
        (
            ["--seed", "3", "train"],
            "'--seed' stands before the command; write 'adaptsim COMMAND --seed'",
        ),
        (["effects", "pushin"], "unknown task 'pushin'; did you mean 'pushing'?"),
        (["parity", "pushin"], "unknown task 'pushin'; did you mean 'pushing'?"),
        (["effects", "pushin"], "unknown task 'pushin'; did you mean 'pushing'?"),
        (["effects", "--name", "colomb"], "unknown effect 'colomb'; did you mean 'coulomb'?"),
        (["effects", "--jsn"], "unknown argument '--jsn'; did you mean '--json'?"),
        (["effects", "--seed", "-1"], "not a whole number from 0"),
        (["effects", "--seed", "1.5"], "'1.5' is not a whole number from 0"),
        (["train", "pendulum"], "the following arguments are required: --run"),
    ],
)
def test_words_that_are_not_known(capsys, arguments, says):
    assert says in refused(capsys, *arguments)


def test_the_tasks_that_commands_know_are_those_that_there_are():
    assert {"pendulum", "pushing", "scooping"} <= set(TASKS)
    for task in TASKS:
        assert check_task(task) == task


def test_help_and_version(capsys):
    assert main(["--help"]) == 0
    assert main([]) == 0
    assert main(["train", "--help"]) == 0
    assert main(["--version"]) == 0
    assert capsys.readouterr().err == ""


def raising(error):
    def run(_args):
        raise error

    return run


@pytest.fixture
def command(monkeypatch):
    """Makes `adaptsim doctor` do something else."""

    def replace(run):
        module = types.SimpleNamespace(EXAMPLES="", arguments=lambda parser: None, run=run)
        monkeypatch.setattr(parser.importlib, "import_module", lambda _name: module)

    return replace


@pytest.mark.parametrize(
    "error, code, says",
    [
        (BadInput("a.csv: row 3: text; write a number"), 2, "a.csv: row 3: text; write a number"),
        (BadInput("two\nlines"), 2, "two lines"),
        (BadInput("there are 0\x1e0, q\u20281"), 2, "there are 0\\x1e0, q\\u20281"),
        (
            OSError(errno.ENOSPC, "No space left", "f"),
            2,
            "f: no space left on the disk; free some and run again",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", "f"),
            2,
            "f: Permission denied; name a file or",
        ),
        (
            FileNotFoundError(errno.ENOENT, "No such file", "f"),
            2,
            "f: no such file or folder; check the name",
        ),
        (RuntimeError("broken"), 1, "failed: RuntimeError: broken; this is a fault of the program"),
        (OSError(errno.EIO, "Input/output error", "f"), 1, "failed: f: Input/output error"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
)
def test_exit_codes(capsys, command, error, code, says):
    command(raising(error))
    assert main(["doctor"]) == code
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("adaptsim: ") and says in lines[-1]
    assert code == 1 or len(lines) == 1
    assert (code == 1) == (len(lines) > 1)  # a fault of the program comes with its traceback


def test_ctrl_c_says_how_to_go_on(capsys, command):
    def run(args):
        args.resume_hint = "continue with: adaptsim train pendulum --run r --resume"
        raise KeyboardInterrupt

    command(run)
    assert main(["doctor"]) == 130
    assert "continue with: adaptsim train pendulum --run r --resume" in capsys.readouterr().err


@pytest.mark.parametrize("buffered", ["", "1"])
def test_a_reader_that_goes_away_is_no_fault(buffered, tmp_path):
    """The work that is left is done, and the exit code is its own."""
    done = tmp_path / "done"
    code = (
        "import sys, pathlib; from adaptsim_jax import cli; import adaptsim_jax.commands.effects\n"
        "effects = adaptsim_jax.commands.effects.run\n"
        f"run = lambda args: (effects(args), pathlib.Path({str(done)!r}).write_text('whole'))[0]\n"
        "adaptsim_jax.commands.effects.run = run\n"
        "sys.exit(cli.main(['effects']))"
    )
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.run(
        [sys.executable, "-c", code],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": buffered},
    )
    os.close(writer)
    assert process.returncode == 0 and process.stderr == "" and done.exists()


def test_results_to_a_full_disk_are_one_line():
    if not os.path.exists("/dev/full"):
        pytest.skip("this system has no /dev/full")
    code = "import sys; from adaptsim_jax.cli import main; sys.exit(main(['effects']))"
    with open("/dev/full", "w") as full:
        process = subprocess.run(
            [sys.executable, "-c", code], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert process.returncode == 2
    assert process.stderr.startswith("adaptsim: ") and "no space left" in process.stderr
    assert process.stderr.count("\n") == 1


# Where tests run in the background of a shell SIGINT is ignored, and children inherit that. Set in
# the child: to fork with `preexec_fn` beside JAX's threads is warned of.
HEED = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_of_a_real_process(sent):
    code = HEED + (
        "import sys, time, types; from adaptsim_jax import cli; from adaptsim_jax.commands import "
        "parser\n"
        "def run(args):\n    args.resume_hint = 'go on'; print('ready', flush=True); "
        "time.sleep(60)\n"
        "module = types.SimpleNamespace(EXAMPLES='', arguments=lambda p: None, run=run)\n"
        "parser.importlib.import_module = lambda name: module\n"
        "sys.exit(cli.main(['doctor']))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(sent)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130 and err == "adaptsim: stopped; go on\n"


def test_ctrl_c_while_modules_are_loaded_is_quiet():
    """SIGINT as the command line's first module is looked for: no traceback, ended by the
    signal.
    """
    code = HEED + (
        "import os, sys\n"
        "class Impatient:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'adaptsim_jax.cli':\n            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Impatient())\n"
        "from adaptsim_jax.__main__ import run\n"
        "sys.exit(run())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == -signal.SIGINT and done.stdout == done.stderr == ""
    plain = subprocess.run(
        [sys.executable, "-m", "adaptsim_jax", "--version"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert plain.returncode == 0 and plain.stdout.startswith("adaptsim_jax ") and plain.stderr == ""


def test_numpys_warnings_do_not_reach_a_user():
    code = (
        "import numpy as np, adaptsim_jax.cli as cli\n"
        "cli.main = lambda: int(np.nanmean(np.array([])) > 0)\n"
        "from adaptsim_jax.__main__ import run\n"
        "print(run())"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout.strip(), ran.stderr) == ("0", "")
