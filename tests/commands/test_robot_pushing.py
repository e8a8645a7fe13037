"""`adaptsim robot` on a run of the push, with Drake as the robot in another process; the figures of
`adaptsim adapt`.
"""

import csv
import errno
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from adaptsim_jax.adaptation.episode import AdaptationEpisode
from adaptsim_jax.adaptation.phase2 import best_of
from adaptsim_jax.cli import main
from adaptsim_jax.commands import phase2
from adaptsim_jax.commands import robot_session as command
from adaptsim_jax.core import files
from adaptsim_jax.core.store import RunFolder
from adaptsim_jax.tasks.pushing import planar as pushing_planar
from adaptsim_jax.tasks.pushing.measured import read_policy

pytestmark = pytest.mark.slow
SIZES = (
    "phase1.trajectories=4",
    "phase1.parallel=2",
    "phase1.horizon=2",
    "phase1.updates=1",
    "phase1.batch=8",
    "phase1.capacity=12",
    "phase1.archive=12",
    "phase1.hidden=[16]",
    "phase1.reuse.first=60",
    "phase1.reuse.most=90",
    "phase1.reuse.least=20",
    "phase1.reuse.capacity=12",
    "phase1.reuse.together=2",
    "task.trials=200",
    "task.tests=6",
    "task.hidden=[16]",
    "task.training={block=20,updates=5,batch=16,capacity=200}",
)
WORLD = "0.3,1e5,0.15,0.1"  # OOD-4
ROBOT = Path(__file__).with_name("drake_robot.py")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "push"
    sizes = [word for size in SIZES for word in ("--set", size)]
    assert (
        main(["train", "pushing", "--run", str(folder), "--preset", "paper-pushing", *sizes]) == 0
    )
    return folder


def robot(*arguments):
    return main(["robot", *map(str, arguments)])


def contents(folder):
    """Bytes of every file but the lock, which holds the second at which a command began."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def pushed(folder, out):
    """The pushes of actions.csv, made in Drake by another process."""
    robot = [sys.executable, str(ROBOT), str(folder / "actions.csv"), str(out), "--params", WORLD]
    subprocess.run(robot, check=True, env=dict(os.environ, PYTHONPATH=str(ROBOT.parents[2])))
    return out


def straight(folder, out, length=0.2, turn=1.0):
    """Tracks of bottles that slide `length` m along `turn` times their pushes' angles, whatever
    speed was asked.
    """
    time = np.arange(0, 1.34, 1 / 30)
    with open(folder / "actions.csv", newline="") as file:
        asked = [(row["trial"], float(row["angle"])) for row in csv.DictReader(file)]
    far = length * np.clip(time - 0.25, 0, 1)
    rows = [
        f"{n},{t:.4f},{0.56 + s * np.cos(turn * a):.5f},{s * np.sin(turn * a):.5f}"
        for n, a in asked
        for t, s in zip(time, far, strict=True)
    ]
    out.write_text("\n".join(["trial,time,x,y", *rows, ""]))
    return out


def seen_by_hand(folder, record):
    """Goals `[2, 2]`, six points `[2, 6, 2]` and rewards `[2]` from the two files, by other means
    than the package's.
    """
    asked = np.loadtxt(folder / "actions.csv", delimiter=",", skiprows=1)
    rows = np.loadtxt(record, delimiter=",", skiprows=1)
    times = [0.22, 0.43, 0.65, 0.87, 1.08, 1.30]
    points = []
    for number in asked[:, 0]:
        time, x, y = rows[rows[:, 0] == number, 1:].T
        points.append(np.stack([np.interp(times, time, x), np.interp(times, time, y)], -1))
    apart = np.linalg.norm(np.array(points)[:, -1] - asked[:, 1:3], axis=1)
    return asked[:, 1:3], np.array(points), np.maximum(0, 1 - apart / 0.2)


def next_mean(folder, goals, points):
    """Unit mean `[4]` that the learned adaptation policy goes to after that, from the session's
    state on disk.
    """
    session = command.open_session(folder)
    state, _ = command.load(session)
    phase1 = session.trained.phase1
    seen = (np.concatenate([points, goals[:, None]], 1) - [0.85, 0.0]) / [0.15, 0.1]
    obs = np.concatenate([2 * state.mean - 1, seen.reshape(-1)])
    action = np.asarray(
        phase1.bdq.greedy(session.trained.state.learner.target, obs.astype(np.float32))
    )
    step = float(session.trained.hyper.delta) * np.array([-1.0, 1.0, 0.0])[action]
    return np.clip(np.asarray(state.mean) + step, 0, 1), phase1.task.space


def test_a_session_with_drake_as_the_robot(run, tmp_path, capsys):
    """Two iterations: what is told is the files' own reward and six points, and the next parameters
    are the policy's for these.
    """
    pytest.importorskip("pydrake")
    folder, scores, visited = tmp_path / "robot", [], []
    assert robot("new", run, "--dir", folder, "--starts", "1", "--iterations", "1") == 0
    assert "2 iterations of 2 pushes" in capsys.readouterr().out
    for iteration in range(2):
        record = pushed(folder, tmp_path / f"{iteration}.csv")
        goals, points, rewards = seen_by_hand(folder, record)
        assert np.ptp(points[:, :, 0]) > 0.05  # the robot did push
        expected, space = next_mean(folder, goals, points)
        visited.append(tomllib.loads((folder / "policy.toml").read_text())["params"])
        assert robot("record", record, "--dir", folder) == 0
        said = capsys.readouterr().out
        assert f"iteration {iteration + 1} of 2: return {rewards.mean():.3f}"[:-1] in said
        assert f"trial {2 * iteration + 2}: came to {points[1, -1, 0]:.3f}"[:-1] in said
        scores.append(rewards.mean())
        assert robot("next", "--dir", folder) == 0
        if iteration == 0:
            now = tomllib.loads((folder / "policy.toml").read_text())["params"]
            np.testing.assert_allclose(
                list(now.values()),
                space.physical(expected.astype(np.float32)),
                rtol=1e-4,
                atol=1e-6,
            )
    out = capsys.readouterr().out
    assert "all 2 iterations are told" in out and f"best return {max(scores):.3f}"[:-1] in out
    best = tomllib.loads((folder / "best.toml").read_text())
    assert best["params"] == visited[int(np.argmax(scores))]
    table = np.loadtxt(folder / "best_actions.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(
        read_policy(folder / "best.toml")(table[:, 1:3]), table[:, 3:], atol=1e-5
    )
    assert robot("record", record, "--dir", folder) == 2
    assert "all 2 iterations are told" in capsys.readouterr().err


def test_what_is_refused_leaves_the_session_as_it_was(run, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "robot"
    assert robot("new", run, "--dir", folder, "--starts", "2", "--iterations", "1") == 0
    first = straight(folder, tmp_path / "first.csv")
    (tmp_path / "mm.csv").write_text(first.read_text().replace(",0.", ",560."))
    (tmp_path / "torn.csv").write_text("\n".join([*first.read_text().splitlines()[:-10], ""]))
    before = contents(folder)
    capsys.readouterr()

    def refuse(name, says):
        assert robot("record", tmp_path / name, "--dir", folder) == 2
        error = capsys.readouterr().err
        assert says in error and str(tmp_path / name) in error and error.count("\n") == 1
        assert contents(folder) == before

    refuse("mm.csv", "looks like mm: write metres")
    refuse("torn.csv", "trial 2: ends at 1 s")
    refuse("none.csv", "check the path")
    straight(folder, tmp_path / "mirrored.csv", turn=-1.0)
    refuse("mirrored.csv", "another frame?")
    # a disk that fills, or a process that dies, between the push and its last byte: told again, it
    # comes to the same
    with monkeypatch.context() as patch:

        def full(*_):
            return (_ for _ in ()).throw(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

        patch.setattr(files.os, "replace", full)
        assert robot("record", first, "--dir", folder) == 2
        assert "no space left" in capsys.readouterr().err
    assert contents(folder) == before
    assert robot("record", first, "--dir", folder) == 0
    assert robot("next", "--dir", folder) == 0
    before = contents(folder)
    refuse("first.csv", "was told already, as iteration 1")
    (tmp_path / "again.csv").write_text(first.read_text() + "\n")
    refuse("again.csv", "trial 1 was told already; name the file of 3 and 4")
    asked = (folder / "actions.csv").read_text()
    (folder / "actions.csv").unlink()
    assert robot("next", "--dir", folder) == 0  # asked again, it says the same
    assert (folder / "actions.csv").read_text() == asked
    # after as many iterations as were wanted, the other start has its turn
    assert robot("record", straight(folder, tmp_path / "second.csv", 0.3), "--dir", folder) == 0
    assert "next start: mu" in capsys.readouterr().out
    state, history = command.load(command.open_session(folder))
    np.testing.assert_array_equal(state.mean, state.starts.mean[1])
    assert [push["trial"] for visit in history for push in visit["pushes"]] == [1, 2, 3, 4]


def three_visits(trained, *_, **__):
    """What Phase 2 gives, of three untrained policies of which the second is the best: to draw,
    without the compiling.
    """
    task = trained.phase1.task
    policies = jax.vmap(task.init_policy)(jax.random.split(jax.random.key(0), 3))
    means, score = jnp.linspace(0.2, 0.6, 12).reshape(1, 3, 4), jnp.array([[0.2, 0.6, 0.4]])
    policies, obs, action = (
        jax.tree.map(lambda x: x[None], policies),
        jnp.zeros((1, 3, 2)),
        jnp.zeros((1, 2, 4)),
    )
    return best_of(AdaptationEpisode(means, policies, obs, score, score, action))


def test_adapt_leaves_a_figure_and_films_the_pushes_that_it_found(
    run, tmp_path, capsys, monkeypatch
):
    taken = []
    monkeypatch.setattr(phase2, "adapt_run", three_visits)
    monkeypatch.setattr(
        phase2,
        "write_film",
        lambda scene, clips, folder: taken.extend(clips) or (folder / "p", "how"),
    )
    assert main(["adapt", str(run), "--target", "wd", "--out", str(tmp_path), "--video"]) == 0
    said = capsys.readouterr().out
    with Image.open(tmp_path / "pushes.png") as figure:
        assert (
            figure.width > 800
            and figure.height > 600
            and len(np.unique(np.asarray(figure.convert("L")))) > 20
        )
    assert (
        f"written: {tmp_path / 'pushes.png'}" in said and f"written: {tmp_path / 'p'}, how" in said
    )
    # two policies at two goals, in the scene that the planar model is a twin of
    assert [clip.text[:18] for clip in taken] == ["iteration 0 (first", "iteration 1 (best)"] * 2
    assert all(clip.patch == pytest.approx(0.05) for clip in taken)
    params = jnp.array([0.1, 1e5, 0.6, 0.05])
    for clip in taken:
        end = pushing_planar.rollout(params, jnp.asarray(clip.action))[-1]
        np.testing.assert_allclose(clip.state[-1, :2], end, atol=0.02)
        apart = 100 * np.linalg.norm(clip.state[-1, :2] - clip.goal)
        assert f": {apart:.0f} cm from the goal" in clip.text


def test_there_is_no_film_of_the_pendulum(tmp_path, capsys):
    RunFolder.create(tmp_path / "run", {"seed": 0}, task="pendulum")
    assert main(["adapt", str(tmp_path / "run"), "--target", "wd", "--video"]) == 2
    assert "there is no film of task 'pendulum'; leave --video out" in capsys.readouterr().err
