"""A small sweep by the command: what it writes, that members are those of `train` and `adapt`,
failures, locks, kills.
"""

import csv
import json
import os
import random
import signal
import time

import pytest

from adaptsim_jax import sweep
from adaptsim_jax.adaptation.sweep_batch import halved
from adaptsim_jax.adaptation.sweep_folder import locked
from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from tests.sweep.small import SPEC, run, start, table, write

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """A sweep without interruption, in batches of four; each member's run folder kept."""
    folder = tmp_path_factory.mktemp("sweep")
    spec = write(folder, "keep = true\n" + SPEC)
    said = run([spec, "--out", folder / "out", "--at-once", "4"])
    assert "8 members done, 0 failed, 0 left" in said and "2 batches of 4" in said
    return folder


def test_it_leaves_a_table_and_figures(straight):
    rows = list(csv.DictReader((straight / "out" / "results.csv").read_text().splitlines()))
    assert (
        len(rows) == 8
        and rows[3]["seed"] == "1"
        and rows[3]["hyper.learner.learning_rate"] == "0.001"
    )
    found = json.loads((straight / "out" / "results.json").read_text())
    assert found["done"] == 8 and len(found["rows"][0]["curve"]) == 8
    line = next(s for s in found["summary"] if s["key"] == "hyper.delta" and s["reward"] == "wd")
    assert line["over"] == "seeds" and line["count"] == 2 and line["members"] == 4
    page = (straight / "out" / "report.html").read_text()
    assert "8 of 8 members done" in page and page.count('class="explore"') == 2


def test_a_member_is_the_run_that_train_makes_and_adapt_adapts(straight, tmp_path, capsys):
    row = json.loads((straight / "out" / "results.json").read_text())["rows"][7]
    config = straight / "out" / "runs" / "00007" / "config.toml"
    assert main(["train", "pendulum", "--run", str(tmp_path / "a"), "--config", str(config)]) == 0
    rewards = {}
    for name, folder in (("apart", tmp_path / "a"), ("kept", straight / "out" / "runs" / "00007")):
        words = [
            "--target",
            "ood-1",
            "--seed",
            "1",
            "--iterations",
            "3",
            "--out",
            str(tmp_path / name),
        ]
        assert main(["adapt", str(folder), *words]) == 0
        rewards[name] = json.loads((tmp_path / name / "result.json").read_text())["best"]["reward"]
    assert rewards["kept"] == pytest.approx(row["targets"]["ood-1"]["reward"], abs=1e-5)
    assert rewards["apart"] == pytest.approx(
        rewards["kept"], abs=1e-3
    )  # another program, trained in float32


def test_a_second_run_into_the_folder_is_refused(straight, capsys):
    words = ["sweep", str(straight / "SPEC.toml"), "--out", str(straight / "out")]
    assert main(words) == 2 and "holds a sweep already; add --resume" in capsys.readouterr().err
    with locked(straight / "out"):
        assert main([*words, "--resume"]) == 2
    assert "is held by process" in capsys.readouterr().err
    other = write(straight / "other", "keep = true\n" + SPEC.replace("0.15", "0.2"))
    assert main(["sweep", str(other), "--out", str(straight / "out"), "--resume"]) == 2
    assert "was started otherwise (grid.hyper.delta" in capsys.readouterr().err


def test_members_that_fail_are_kept_with_their_reason(tmp_path):
    text = SPEC.replace("[3e-4, 1e-3]", "[3e-4, 1e30]").replace("[0.1, 0.15]", "[0.1]")
    said = run([write(tmp_path, text), "--out", tmp_path / "out"])
    assert "2 members done, 2 failed, 0 left" in said and "were not finite from round" in said
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert [row["status"] for row in rows] == ["done", "done", "failed", "failed"]
    assert "reason" in rows[2] and rows[0]["targets"]["wd"]["reward"] is not None


def test_batches_that_raise_are_halved_down_to_the_member_that_does():
    def work(members):
        if 3 in members:
            raise RuntimeError("out of luck")
        return [(m, "done") for m in members]

    found = halved([1, 2, 3, 4, 5], work, lambda m, reason: (m, reason))
    assert found == [
        (1, "done"),
        (2, "done"),
        (3, "RuntimeError: out of luck"),
        (4, "done"),
        (5, "done"),
    ]

    def refuse(members):
        raise BadInput("no")

    with pytest.raises(BadInput):
        halved([1], refuse, lambda m, reason: None)


def test_killed_at_random_moments_it_ends_with_the_same_bits(straight, tmp_path):
    """SIGKILL, five times (SWEEP_KILLS and SWEEP_SEED say otherwise): within 4 s of the start, and
    every fourth time after a checkpoint.
    """
    spec, out = write(tmp_path, "keep = true\n" + SPEC), tmp_path / "out"
    words = [spec, "--out", out, "--at-once", "4", "--resume", "--save-every", "0"]
    rng, wanted = (
        random.Random(int(os.environ.get("SWEEP_SEED", "7"))),
        int(os.environ.get("SWEEP_KILLS", "5")),
    )
    kills, midway = 0, 0

    def saved():
        return sum(p.stat().st_mtime_ns for p in (out / "work").glob("*/manifest.json"))

    for _ in range(3 * wanted):
        before, process = saved(), start(words)
        held = time.monotonic() + 60
        while (
            kills % 4 == 1
            and process.poll() is None
            and saved() == before
            and time.monotonic() < held
        ):
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.1 if kills % 4 == 1 else 4.0))
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
        process.stdout.close()
        midway += saved() > 0
        if kills == wanted:
            break
    assert kills == wanted and midway > 0  # one of them between checkpoints of a batch
    run(words)
    assert table(out) == table(straight / "out")


@pytest.mark.slow
def test_the_public_function_sweeps_and_reads_what_is_done(tmp_path):
    spec = write(tmp_path, SPEC.split("[grid]")[0].replace('targets = ["wd", "ood-1"]', ""))
    found = sweep(spec, tmp_path / "out", at_once=2)
    assert found["done"] == 2 and (tmp_path / "out" / "results.csv").exists()

    def never(*_):
        raise AssertionError("nothing is left to be run")

    assert sweep(spec, tmp_path / "out", progress=never)["rows"] == found["rows"]
    with pytest.raises(BadInput, match="started otherwise"):
        sweep(
            write(tmp_path / "b", spec.read_text() + "\n[grid]\nhyper.delta = [0.2]\n"),
            tmp_path / "out",
        )
