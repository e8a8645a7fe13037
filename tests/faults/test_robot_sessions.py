"""Sessions of `adaptsim robot` on odd days: a robot that trips, a record taken back, folders that
move, two writers at once.
"""

import json
import shutil
import tomllib

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.files import one_writer
from tests.commands.test_train import SET, contents, robot, write_trial

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    assert main(["train", "pendulum", "--run", str(folder), *SET]) == 0
    return folder


@pytest.fixture
def session(run, tmp_path):
    folder = tmp_path / "robot"
    assert robot("new", run, "--dir", folder, "--starts", "2", "--iterations", "1") == 0
    return folder


def trial(session, out, rows=None):
    write_trial(out, tomllib.loads((session / "policy.toml").read_text())["policy"]["gain"])
    if rows:
        out.write_text("\n".join(out.read_text().split("\n")[:rows]) + "\n")
    return out


def test_a_robot_that_trips_a_record_taken_back_and_a_second_writer(session, tmp_path, capsys):
    first = contents(session)
    assert robot("record", trial(session, tmp_path / "trip.csv", 600), "--dir", session) == 2
    assert "robot record --failed" in capsys.readouterr().err
    assert robot("record", "--failed", "--dir", session) == 0
    out = capsys.readouterr().out
    assert "trial 1 of 4 failed: no return; with it 1 more of the same start are given up" in out
    assert robot("next", "--dir", session) == 0 and "trial 3 of 4" in capsys.readouterr().out
    assert robot("next", "--dir", session, "--json") == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert (answer["told"], answer["of"], answer["done"], answer["best_return"]) == (
        2,
        4,
        False,
        None,
    )
    assert (
        answer["policy"] == str(session / "policy.toml")
        and "m2" in answer["params"]
        and "trial 3 of 4" in err
    )
    assert robot("undo", "--dir", session) == 0
    assert robot("next", "--dir", session) == 0
    assert contents(session) == first
    assert (
        robot("undo", "--dir", session) == 2
        and "nothing was recorded yet" in capsys.readouterr().err
    )
    assert robot("record", trial(session, tmp_path / "good.csv"), "--dir", session) == 0
    before = contents(session)
    with one_writer(session):
        assert robot("undo", "--dir", session) == 2
    assert (
        "another process is writing there" in capsys.readouterr().err
        and contents(session) == before
    )
    for _ in range(2):
        robot("record", "--failed", "--dir", session)
    capsys.readouterr()
    assert robot("next", "--dir", session) == 0 and "best return" in capsys.readouterr().out


def test_two_that_resume_one_run(run, capsys):
    before = contents(run)
    with one_writer(run):
        assert main(["train", "pendulum", "--run", str(run), "--resume"]) == 2
    assert "another process is writing there" in capsys.readouterr().err and contents(run) == before


def test_nothing_was_finished(session, capsys):
    for _ in range(2):
        assert robot("record", "--failed", "--dir", session) == 0
    assert robot("next", "--dir", session) == 0
    assert (
        "none of them was finished" in capsys.readouterr().out
        and not (session / "best.toml").exists()
    )


def test_folders_that_move(run, tmp_path, capsys):
    there = tmp_path / "there"
    shutil.copytree(run, there / "run")
    assert (
        robot("new", there / "run", "--dir", there / "s", "--starts", "1", "--iterations", "1") == 0
    )
    there.rename(tmp_path / "here")
    session = tmp_path / "here" / "s"
    assert (
        robot("next", "--dir", session) == 0
    )  # both together: told by the way from one to the other
    (tmp_path / "here" / "run").rename(tmp_path / "run")
    capsys.readouterr()
    assert robot("next", "--dir", session) == 2 and "--run RUN" in capsys.readouterr().err
    assert robot("next", "--dir", session, "--run", tmp_path / "run") == 0
    assert robot("record", trial(session, tmp_path / "a.csv"), "--dir", session) == 0
    assert main(["train", "pendulum", "--run", str(tmp_path / "other"), "--seed", "9", *SET]) == 0
    capsys.readouterr()
    assert robot("next", "--dir", session, "--run", tmp_path / "other") == 2
    assert "was trained on, or anew" in capsys.readouterr().err


SPOILED = {
    "ms": (lambda t: t * [1e3, 1, 1, 1, 1, 1, 1], "milliseconds"),
    "preroll": (
        lambda t: np.r_[np.c_[np.arange(-1, 0, 1e-3), np.tile(t[0, 1:], (1000, 1))], t],
        "before it was let go",
    ),
    "hole": (lambda t: t[(t[:, 0] < 0.4) | (t[:, 0] > 1.2)], "nothing was recorded from"),
    "degrees": (lambda t: t * [1, 57.29578, 57.29578, 57.29578, 57.29578, 1, 1], "degrees"),
    "speeds": (lambda t: t * [1, 1, 1, 57.29578, 57.29578, 1, 1], "column v1"),
    "exchanged": (
        lambda t: t[:, [0, 1, 2, 3, 4, 6, 5]],
        "the torques of joint 1 and joint 2 look swapped",
    ),
    "mNm": (lambda t: t * [1, 1, 1, 1, 1, 1e3, 1e3], "those of links of 1 m and 1 kg; write N m"),
    "nan": (lambda t: np.where(np.arange(len(t))[:, None] == 30, np.nan, t), "nan"),
}


def test_spoiled_trials_are_refused_and_a_turn_is_no_matter(session, tmp_path, capsys):
    good = trial(session, tmp_path / "good.csv")
    table = np.loadtxt(good, delimiter=",", skiprows=1)
    head = good.read_text().split("\n")[0]

    def save(path, t):
        return np.savetxt(path, t, delimiter=",", header=head, comments="", fmt="%.12g")

    before = contents(session)
    for name, (spoil, says) in SPOILED.items():
        save(tmp_path / f"{name}.csv", spoil(table))
        capsys.readouterr()
        assert robot("record", tmp_path / f"{name}.csv", "--dir", session) == 2, name
        assert says in capsys.readouterr().err, name
        assert contents(session) == before
    flipped = table.copy()
    flipped[:, 1:3] = np.angle(np.exp(1j * flipped[:, 1:3]))
    returns = []
    for name, t in (("plus", table + np.eye(7)[1] * 2 * np.pi), ("flip", flipped), ("good", table)):
        save(tmp_path / f"{name}.csv", t)
        assert robot("record", tmp_path / f"{name}.csv", "--dir", session) == 0
        returns.append(float(capsys.readouterr().out.split("return ")[1].split()[0].rstrip(",")))
        assert robot("undo", "--dir", session) == 0
    np.testing.assert_allclose(returns, returns[-1], rtol=1e-4)
