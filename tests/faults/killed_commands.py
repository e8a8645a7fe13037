"""`train`, `adapt` and `robot record` of a small pendulum, whole processes killed at random moments
(every other one by SIGTERM, as schedulers do) and called again.

    # kills, seed; exit status 1 and a line at the first that lost anything
    python -m tests.faults.killed_commands FOLDER 75 0

After each kill the same call is made again until it ends by itself. Then its files must be those of
a call that nobody killed, to the bit. A moment is drawn from the time that the command takes.
(`sweep` has a test of its
own: `SWEEP_KILLS=25 pytest tests/sweep/test_run.py -k killed`.)
"""

import random
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

from adaptsim_jax.cli import STOPPED
from adaptsim_jax.core.files import LOCK
from tests.commands.test_train import SET, contents, write_trial

CALLS = ("train", "adapt", "record")


def start(*words: object) -> subprocess.Popen:
    command = [sys.executable, "-m", "adaptsim_jax.cli", *(str(word) for word in words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def run(*words: object) -> str:
    process = start(*words)
    said = process.communicate()[0]
    if process.returncode:
        raise ValueError(f"{' '.join(map(str, words))}: {said}")
    return said


def files(folder: Path) -> dict[str, bytes]:
    """All but the lock, which the dead do not hold."""
    return {name: data for name, data in contents(folder).items() if Path(name).name != LOCK}


def same(there: Path, straight: Path, what: str) -> None:
    a, b = files(there), files(straight)
    wrong = sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))
    if wrong:
        raise ValueError(f"{what}: differ or are missing: {', '.join(wrong[:5])}")


def policy(session: Path) -> list:
    return tomllib.loads((session / "policy.toml").read_text())["policy"]["gain"]


class Call:
    """One command in a folder of its own: words(folder) to call it, ready(folder) before,
    ended(folder) whether it has.
    """

    def __init__(self, words: Callable, ready: Callable, ended: Callable, seconds: float):
        self.words, self.ready, self.ended, self.seconds = words, ready, ended, seconds


def calls(base: Path) -> dict[str, tuple[Call, Path]]:
    """What is killed, and the folder that a call which nobody killed has left."""
    base.mkdir(parents=True, exist_ok=True)
    made, adapted = base / "run", base / "adapted"

    def train(f):
        return [
            "train",
            "pendulum",
            "--run",
            f,
            "--seed",
            3,
            *SET,
            *(["--resume"] if (f / "config.toml").exists() else []),
        ]

    def adapt(f):
        return ["adapt", made, "--target", "ood-1", "--out", f]

    began = time.monotonic()
    run(*train(made))
    took = time.monotonic() - began
    run(*adapt(adapted))
    asked, told, trial = base / "asked", base / "told", base / "trial.csv"
    run("robot", "new", made, "--dir", asked, "--starts", 1, "--iterations", 2)
    write_trial(trial, policy(asked))
    shutil.copytree(asked, told)

    def record(f):
        return ["robot", "record", trial, "--dir", f]

    run(*record(told))

    def fresh(f):
        return shutil.rmtree(f, ignore_errors=True)

    def new_session(f: Path) -> None:
        fresh(f)
        shutil.copytree(asked, f)

    return {
        "train": (Call(train, fresh, lambda f: False, took), made),
        "adapt": (Call(adapt, fresh, lambda f: (f / "result.json").exists(), took), adapted),
        "record": (Call(record, new_session, lambda f: files(f) == files(told), took), told),
    }


def campaign(base: Path, kills: int, seed: int) -> dict[str, int]:
    """Kills of each command that hit it while it ran. ValueError at the first that lost
    anything.
    """
    draw, hits = random.Random(seed), dict.fromkeys(CALLS, 0)
    known = calls(base)
    for name, (call, straight) in known.items():
        folder = base / f"killed-{name}"
        call.ready(folder)
        while hits[name] < kills // len(known):
            process = start(*call.words(folder))
            time.sleep(draw.uniform(0.0, call.seconds))
            by = (signal.SIGKILL, signal.SIGTERM)[hits[name] % 2]
            process.send_signal(by)
            said = process.communicate()[0]
            hit = process.returncode in (-by, STOPPED)
            hits[name] += hit
            if not hit and process.returncode:
                raise ValueError(f"{name}, after {hits[name]} kills: {said}")
            if not hit or call.ended(
                folder
            ):  # it has written all: whole, and as it should be; then from the beginning
                same(folder, straight, f"{name}, after {hits[name]} kills")
                call.ready(folder)
        if not call.ended(folder):
            run(*call.words(folder))
        same(folder, straight, f"{name}, at the end")
    return hits


if __name__ == "__main__":
    try:
        print(campaign(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
    except ValueError as error:
        sys.exit(str(error))
