"""Healthy recordings, with and without an effect that their model lacks: read and checked; what is
said of them is a false alarm.

    # seed; 200 sets; exit status 1 where anything is said
    python -m tests.faults.healthy FOLDER 7300
    python -m tests.faults.healthy FOLDER 7300 mechanisms 10      so many of one kind

Said are refusals, warnings of the audit and of conventions, and trials that differ, which
`diagnose` tells only after its search (not run here) and only where the mended model does not
explain them. Noise, jitter, coarse encoders and missing speeds are among the sets; lost rows are
not.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from tests.generators import tosses
from tests.generators.dataset import make_datasets
from tests.generators.mechanism_worlds import MACHINES, write_world
from tests.generators.recording import write_dataset
from tests.generators.suites import null_cases, single_cases
from tests.logs.arm_files import arm, write

COUNTS = {"pendulums": 60, "arms": 20, "mechanisms": 40, "pushes": 40, "scoops": 20, "tosses": 20}
Sets = Iterator[tuple[str, Path]]


def pendulums(folder: Path, seed: int, count: int) -> Sets:
    cases = [*null_cases(count // 2, seed), *single_cases(count - count // 2, seed)]
    for case, made in zip(cases, make_datasets([case.spec for case in cases]), strict=True):
        effect = "+".join(name for name, *_ in case.spec.effects) or "nothing"
        yield (
            f"{case.name} ({effect}, {case.spec.condition})",
            write_dataset(made, folder / case.name),
        )


def arms(folder: Path, seed: int, count: int) -> Sets:
    for k in range(count):
        yield f"arm {seed + k}", write(folder / f"arm_{k}", arm(count=8, seed=seed + k))


def mechanisms(folder: Path, seed: int, count: int) -> Sets:
    for k in range(count):
        kind, machine = ("null", "single", "multi")[k % 3], list(MACHINES)[k % len(MACHINES)]
        at = write_world(folder / f"mechanism_{k}", kind, seed + k, machine=machine)
        yield f"{kind} {machine} {seed + k}", at / "recording"


def worlds_of(task: str) -> Callable[[Path, int, int], Sets]:
    """A null world for two with an effect, by the experiments' own physics."""

    def made(folder: Path, seed: int, count: int) -> Sets:
        from experiments import pushing_worlds, scooping_worlds

        worlds = {"pushes": pushing_worlds, "scoops": scooping_worlds}[task]
        kinds = list(worlds.SINGLES)
        chosen = [("null" if k % 3 == 0 else kinds[k % len(kinds)], seed + k) for k in range(count)]
        worlds.write(chosen, folder / task)
        for kind, own in chosen:
            yield f"{task} {kind} {own}", folder / task / f"{kind}-{own}"

    return made


def tossed(folder: Path, seed: int, count: int) -> Sets:
    kinds = list(tosses.SIZES)
    for k in range(count):
        name = None if k % 3 == 0 else kinds[k % len(kinds)]
        made = tosses.world((seed, k), name, tosses=12)
        yield f"tosses {name} {seed},{k}", tosses.written(folder / f"toss_{k}", *made)


MADE = {
    "pendulums": pendulums,
    "arms": arms,
    "mechanisms": mechanisms,
    "pushes": worlds_of("pushes"),
    "scoops": worlds_of("scoops"),
    "tosses": tossed,
}


def of_pendulum(source: Path) -> list[str]:
    from adaptsim_jax.logs.pendulum import read_pendulum
    from adaptsim_jax.logs.quality.audit import audit, usable
    from adaptsim_jax.logs.quality.pendulum_design import (
        WORDS,
        check_conventions,
        pendulum_trials,
    )
    from adaptsim_jax.logs.quality.trial_words import sentences

    recording = read_pendulum(source)
    checked = audit(recording)
    if checked.fault:
        return [checked.message]
    said = list(checked.warnings)
    kept = usable(recording, checked)
    said += [f.message for f in check_conventions(kept)]
    found = pendulum_trials(kept)
    return said + (list(sentences(found, WORDS)) if found is not None and found.differs else [])


def of_mechanism(source: Path) -> list[str]:
    from adaptsim_jax.attribution.conventions import check_conventions, mechanism_trials, words_of
    from adaptsim_jax.attribution.diagnose import HORIZON
    from adaptsim_jax.attribution.load import load
    from adaptsim_jax.attribution.posed import scaled
    from adaptsim_jax.logs.quality.trial_words import sentences

    machine = load(source)
    said = [f.message for f in check_conventions(machine)]
    machine = scaled(machine, HORIZON)
    found = mechanism_trials(machine)
    return said + (
        list(sentences(found, words_of(machine))) if found is not None and found.differs else []
    )


def of_trials(task: str) -> Callable[[Path], list[str]]:
    def said(source: Path) -> list[str]:
        from importlib import import_module

        room = task if task == "toss" else f"{task}.diagnosis"
        import_module(f"adaptsim_jax.tasks.{room}.read").read(source)
        return []

    return said


SAID = {
    "pendulums": of_pendulum,
    "arms": of_pendulum,
    "mechanisms": of_mechanism,
    "pushes": of_trials("pushing"),
    "scoops": of_trials("scooping"),
    "tosses": of_trials("toss"),
}


def false_alarms(folder: Path, seed: int, kind: str, count: int) -> list[str]:
    """What is said of `count` healthy sets."""
    out = []
    for name, source in MADE[kind](folder, seed, count):
        try:
            said = SAID[kind](source)
        except BadInput as error:
            said = [f"refused: {error}"]
        out += [f"{name}: {line}" for line in said]
    return out


if __name__ == "__main__":
    np.seterr(all="ignore")
    at, first, *one = sys.argv[1:]
    counts = {one[0]: int(one[1])} if one else COUNTS
    alarms = 0
    for what, many in counts.items():
        told = false_alarms(Path(at), int(first), what, many)
        alarms += len(told)
        print(f"{what}: {many} sets, {len(told)} lines said", *told, sep="\n  ", flush=True)
    sys.exit(bool(alarms))
