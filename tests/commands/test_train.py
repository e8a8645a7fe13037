"""A tiny run by the command line: killed and resumed to the same bits, adapted, and told robot
trials.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.files import LOCK
from adaptsim_jax.mechanisms.double_pendulum import linear as model
from tests.commands.test_errors import HEED
from tests.mechanisms.linear_motion import linear_trajectory

pytestmark = pytest.mark.slow
SIZES = (
    "phase1.trajectories=240",
    "phase1.parallel=10",
    "phase1.updates=4",
    "phase1.hidden=[16]",
    "phase1.capacity=1000",
    "phase1.archive=1000",
    "phase1.horizon=5",
    "every=2",
)
SET = [word for size in SIZES for word in ("--set", size)]


def train(folder, *more):
    return ["train", "pendulum", "--run", str(folder), *more]


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """A run without interruption."""
    folder = tmp_path_factory.mktemp("runs") / "straight"
    assert main(train(folder, "--seed", "3", *SET)) == 0
    return folder


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != LOCK  # it says who wrote, and when
    }


def kill_after(command, done):
    """Run the command in a process of its own and SIGKILL it as soon as `done()`; True if it was
    killed.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "adaptsim_jax.cli", *command], stdout=subprocess.DEVNULL
    )
    try:
        while process.poll() is None and not done():
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        return process.wait() == -signal.SIGKILL
    finally:
        process.kill()


def test_killed_and_resumed_it_ends_with_the_same_bits(straight, tmp_path):
    folder = tmp_path / "run"
    metrics = folder / "metrics.jsonl"

    def rows(count):
        return lambda: metrics.exists() and metrics.read_bytes().count(b"\n") >= count

    # before any checkpoint, just after metrics were written and before their checkpoint, and again
    # later
    assert kill_after(train(folder, "--seed", "3", *SET), (folder / "config.toml").exists)
    assert kill_after(train(folder, "--resume"), rows(1))
    assert kill_after(train(folder, "--resume"), rows(9))
    assert main(train(folder, "--resume")) == 0
    assert contents(folder) == contents(straight)


def test_a_finished_run_resumed_stays_as_it_is(straight, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(straight, folder)
    assert main(train(folder, "--resume", "--seed", "3")) == 0
    assert contents(folder) == contents(straight)


@pytest.mark.parametrize(
    "more, says",
    [
        ([], "holds a run already; add --resume"),
        (["--resume", "--seed", "4"], "seed: 3 there, 4 asked"),
        (["--resume", "--set", "hyper.delta=0.2"], "hyper.delta: 0.1 there, 0.2 asked"),
        (
            ["--resume", "--set", "hyper.dleta=0.2"],
            "unknown key 'hyper.dleta'; did you mean 'delta'?",
        ),
        (["--resume", "--config", "none.toml"], "none.toml: no such file"),
    ],
)
def test_what_does_not_fit_the_run_is_named(straight, capsys, more, says):
    before = contents(straight)
    assert main(train(straight, *more)) == 2
    assert says in capsys.readouterr().err
    assert contents(straight) == before


def test_bad_input_before_anything_is_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for more, says in (
        (["--set", "task.observatoin=late"], "did you mean 'observation'"),
        (["--set", "phase1.parallel=7"], "do not divide into rounds of 7"),
        (["--set", "every=two"], "key 'every' is 'two'; a value of type int"),
    ):
        assert main(train(tmp_path / "run", *more)) == 2
        assert says in capsys.readouterr().err
        assert not (tmp_path / "run").exists()
    assert main(train(tmp_path / "file" / "run")) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_run_from_the_config_of_another(straight, tmp_path):
    folder = tmp_path / "again"
    assert main(train(folder, "--config", str(straight / "config.toml"))) == 0
    assert contents(folder) == contents(straight)


def adapt(straight, out, *more):
    return ["adapt", str(straight), "--iterations", "3", "--out", str(out), *more]


def test_adapt_to_a_setting_and_to_the_same_numbers_in_a_file(straight, tmp_path):
    (tmp_path / "mine.toml").write_text("m1 = 1.8\nm2 = 0.3\nb1 = 1.5\nb2 = 1.5\n")
    results = []
    for target, out in (("ood-1", "a"), (str(tmp_path / "mine.toml"), "b")):
        assert main(adapt(straight, tmp_path / out, "--target", target)) == 0
        results.append(json.loads((tmp_path / out / "result.json").read_text()))
    assert results[0]["target"] == {
        "name": "ood-1",
        "params": {"m1": 1.8, "m2": 0.3, "b1": 1.5, "b2": 1.5},
    }
    assert results[1]["target"]["name"] == "mine"
    assert (
        results[0]["best"] == results[1]["best"] and results[0]["history"] == results[1]["history"]
    )
    history = [[visit["reward"] for visit in start] for start in results[0]["history"]]
    assert np.shape(history) == (2, 4) and results[0]["trials"] == 8
    assert results[0]["best"]["reward"] == np.max(history)
    assert np.shape(results[0]["best"]["policy"]["gain"]) == (2, 4)


@pytest.mark.parametrize(
    "target, says",
    [
        ("odd-1", "unknown target 'odd-1', and no such file; did you mean 'ood-1'?"),
        ("m1 = 1.8\nm2 = 0.3\nb1 = 1.5", "parameter 'b2' is missing"),
        ("m1 = 1.8\nm2 = 0.3\nb1 = 1.5\nb2 = 1.5\nb3 = 1", "unknown parameter 'b3'"),
        ("m1 = -1.8\nm2 = 0.3\nb1 = 1.5\nb2 = 1.5", "m1 = -1.8 kg is outside its physical range"),
        ("m1 = '1'\nm2 = 0.3\nb1 = 1.5\nb2 = 1.5", "is not a finite number"),
        ("m1 = 1.8\nm2 = nan\nb1 = 1.5\nb2 = 1.5", "is not a finite number"),
        ("params = 3", "'params' is not a table"),
        ("m1 = ", "not TOML"),
    ],
)
def test_bad_targets(straight, tmp_path, capsys, target, says):
    if "=" in target:
        (tmp_path / "t.toml").write_text(target)
        target = str(tmp_path / "t.toml")
    assert main(adapt(straight, tmp_path / "out", "--target", target)) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_runs_that_cannot_be_adapted(straight, tmp_path, capsys):
    torn = tmp_path / "torn"
    shutil.copytree(straight, torn)
    for payload in (torn / "checkpoint").rglob("*.npz"):  # the last one, and the one before
        payload.write_bytes(payload.read_bytes()[:-20])
    other = tmp_path / "other"
    shutil.copytree(straight, other)
    config = other / "config.toml"
    config.write_text(re.sub(r'version = "\d+\.\d+', 'version = "0.9', config.read_text()))
    for folder, says in (
        (tmp_path / "none", "no such run folder"),
        (tmp_path, "not a run folder"),
        (torn, "the checkpoint is torn"),
        (other, "written by adaptsim_jax 0.9"),
    ):
        assert main(adapt(folder, tmp_path / "out", "--target", "wd")) == 2
        error = capsys.readouterr().err
        assert says in error and error.count("\n") == 1


def robot(*arguments):
    return main(["robot", *map(str, arguments)])


def write_trial(path, gain, target=(1.8, 0.3, 1.5, 1.5)):
    """What a logger of a robot with those parameters would write."""
    A, B = model.linearized(np.array(target, np.float32))
    time = np.arange(0.0, 2.6, 0.001)
    x, u = linear_trajectory(A, B, gain, model.START, time)
    table = np.column_stack([time, x, u])
    np.savetxt(path, table, delimiter=",", header="time,q1,q2,v1,v2,tau1,tau2", comments="")


def test_a_session_with_a_robot(straight, tmp_path, capsys):
    folder = tmp_path / "robot"
    assert robot("new", straight, "--dir", folder, "--starts", "1", "--iterations", "2") == 0
    scores = []
    for trial in range(3):
        gain = tomllib.loads((folder / "policy.toml").read_text())["policy"]["gain"]
        write_trial(tmp_path / f"{trial}.csv", gain)
        assert robot("record", tmp_path / f"{trial}.csv", "--dir", folder) == 0
        out = capsys.readouterr().out
        assert f"trial {trial + 1} of 3" in out
        scores.append(float(out.partition("return ")[2].split()[0].rstrip(",")))
        assert robot("next", "--dir", folder) == 0
    out = capsys.readouterr().out
    assert "all 3 trials are told" in out and f"best return {max(scores):.6g}" in out
    assert (folder / "best.toml").exists()
    assert robot("record", tmp_path / "0.csv", "--dir", folder) == 2
    assert "all 3 trials are told" in capsys.readouterr().err


def test_what_a_session_refuses(straight, tmp_path, capsys):
    folder = tmp_path / "robot"
    assert robot("new", straight, "--dir", folder, "--starts", "1", "--iterations", "2") == 0
    write_trial(
        tmp_path / "a.csv", tomllib.loads((folder / "policy.toml").read_text())["policy"]["gain"]
    )
    assert robot("record", tmp_path / "a.csv", "--dir", folder) == 0
    (tmp_path / "bad.csv").write_text("time,q1\n0,0\n")
    capsys.readouterr()
    before = contents(folder)
    for arguments, says in (
        (("nwe", straight), "unknown step 'nwe'; did you mean 'new'?"),
        (("new",), "RUN is missing"),
        (("new", straight), "holds a session already"),
        (("record", tmp_path / "a.csv"), "was told already, as trial 1"),
        (("record", tmp_path / "bad.csv"), "bad.csv"),
        (("record", tmp_path / "none.csv"), "none.csv"),
    ):
        assert robot(*arguments, "--dir", folder) == 2
        error = capsys.readouterr().err
        assert says in error and error.count("\n") == 1
        assert contents(folder) == before
    assert robot("next", "--dir", tmp_path / "nothing") == 2
    assert "no session here" in capsys.readouterr().err


def test_a_session_keeps_the_policy_it_began_with(straight, tmp_path, capsys):
    """A run trained anew in the same folder is another adaptation policy."""
    run, folder = tmp_path / "run", tmp_path / "robot"
    shutil.copytree(straight, run)
    assert robot("new", run, "--dir", folder, "--starts", "1", "--iterations", "2") == 0
    gain = tomllib.loads((folder / "policy.toml").read_text())["policy"]["gain"]
    write_trial(tmp_path / "a.csv", gain)
    shutil.rmtree(run)
    assert main(train(run, "--seed", "4", *SET)) == 0
    capsys.readouterr()
    before = contents(folder)
    for arguments in (("next",), ("record", tmp_path / "a.csv")):
        assert robot(*arguments, "--dir", folder) == 2
        error = capsys.readouterr().err
        assert (
            f"{run}: was trained on, or anew, since the session" in error and error.count("\n") == 1
        )
    assert contents(folder) == before
    shutil.rmtree(run)
    shutil.copytree(straight, run)
    assert robot("record", tmp_path / "a.csv", "--dir", folder) == 0


def test_ctrl_c_while_training_can_be_resumed(straight, tmp_path):
    folder = tmp_path / "run"
    code = HEED + "import sys; from adaptsim_jax.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *train(folder, "--seed", "3", *SET)]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    ) as process:
        while process.poll() is None and not Path(folder, "metrics.jsonl").exists():
            time.sleep(0.001)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate()
    assert process.returncode == 130
    assert error.splitlines()[-1].startswith(
        "adaptsim: stopped; continue with: adaptsim train pendulum --run "
    )
    assert main(train(folder, "--resume")) == 0
    assert contents(folder) == contents(straight)


@pytest.mark.parametrize(
    "reward, said",
    [(0.0, "no visit earned a reward"), (0.2, ""), (None, "no return is a number")],
)
def test_adapt_says_where_no_visit_earned_a_reward(reward, said, capsys):
    from adaptsim_jax.commands.adapt import _show

    visits = [{"reward": 0.0 if reward else reward, "params": {}}, {"reward": reward, "params": {}}]
    target = {"name": "wet", "params": {}}
    _show(
        {
            "target": target,
            "best": {"reward": reward, "params": {}},
            "trials": 2,
            "history": [visits],
        }
    )
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  no ")]
    assert len(lines) == bool(said) and all(said in line for line in lines)
