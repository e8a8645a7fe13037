"""Phase 1 into a run folder, in chunks that can be killed and resumed to the same bits, and Phase 2
out of it.
"""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import (
    Phase1,
    Phase1Config,
    Phase1Hyper,
    Phase1State,
    archive_size,
    make_phase1,
)
from adaptsim_jax.adaptation.phase1_config import check_hyper
from adaptsim_jax.adaptation.phase2 import Phase2Result, adapt, draw_starts
from adaptsim_jax.core import config, process, store
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import MAX_SEED, BadInput
from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.core.store import RunFolder
from adaptsim_jax.tasks.base import Preparation, Task
from adaptsim_jax.tasks.registry import TASKS, make_task

# ---------------------------------------------------------------- what a task learns once
#
# What a task learns once, before Phase 1 (`Task.preparation`): made, kept beside a run or beside
# compiled programs, and read back.

FOLDER = "prepared"
MAX_PREPARED = 64  # preparations kept beside compiled programs; the oldest go


def prepared(
    task: Task,
    seed: int = 0,
    folder: str | os.PathLike | None = None,
    report: Report = silent,
    make: bool = True,
) -> Task:
    """`task` with what it learns once, where it learns anything.

    Args:
        seed: With the task's own digest it says what was learned.
        folder: Of the run that keeps it; None: it is kept with the compiled programs, for whoever
                asks for the same.
        make: False where it must be there already.

    Returns:
        The task, ready. BadInput where it is not there and may not be made.
    """
    made = task.preparation
    if made is None:
        return task
    return made.ready(learned(task, made, seed, folder, report, make))


def learned(
    task: Task,
    made: Preparation,
    seed: int,
    folder: str | os.PathLike | None,
    report: Report = silent,
    make: bool = True,
) -> Any:
    """What `made` learns, as `prepared` finds or makes it: a pytree of arrays."""
    digest = _digest(task, seed)
    shared = process.cache_folder() / FOLDER / digest[:32]
    own = None if folder is None else Path(folder) / FOLDER
    like = jax.eval_shape(made.blank, jax.random.key(0))
    for place in [p for p in (own, shared) if p is not None and (p / store.MANIFEST).exists()]:
        if store.read_manifest(place)["config_hash"] != digest:
            if place == own:
                raise BadInput(
                    f"{folder}: the environment (or JAX, which traces it) was changed since its "
                    "policy was trained; train in another folder"
                )
            continue
        tree, _ = store.load_checkpoint(place, like, task=task.name)
        if place == shared:
            _report_reuse(place)
            if own is not None:
                keep(own, task, tree, seed)
        return tree
    if not make:
        raise BadInput(
            f"{folder}: its policy was not trained yet; run `adaptsim train` with --resume first"
        )
    cached = os.environ.get("JAX_ENABLE_COMPILATION_CACHE") != "false"
    places = [p for p in (own, shared if cached else None) if p is not None]
    kept = None
    if places:
        so_far = places[0].with_name(f"{places[0].name}-so-far")
        kept = store.Kept(so_far, task.name, digest)
    tree = made.make(jax.random.key(seed), report, kept)
    for place in places:
        keep(place, task, tree, seed)
    if kept is not None:
        kept.clear()
    return tree


def _digest(task: Task, seed: int) -> str:
    """Of all that what `task` learns once depends on."""
    assert task.preparation is not None
    return config.digest({"task": task.name, "seed": seed, "of": task.preparation.digest()})


def _report_reuse(place: Path) -> None:
    """A line: the policy is that of an earlier run, trained for the same."""
    trained = datetime.fromtimestamp((place / store.MANIFEST).stat().st_mtime)
    print(
        f"prepared: the policy trained on {trained:%Y-%m-%d %H:%M} is taken again, for the "
        "environment, its fields, the training and the seed are the same (to train anew, remove "
        f"{place})",
        file=sys.stderr,
    )


def keep(place: Path, task: Task, tree: Any, seed: int) -> None:
    """Write what `task` learned once with `seed` into the folder `place`, where `learned` finds
    it.
    """
    store.save_checkpoint(place, tree, task=task.name, step=0, config_hash=_digest(task, seed))
    if place.name != FOLDER:
        others = sorted(place.parent.glob("*/" + store.MANIFEST), key=lambda p: p.stat().st_mtime)
    else:
        others = []
    for old in others[:-MAX_PREPARED]:
        for part in old.parent.iterdir():
            part.unlink(missing_ok=True)
        old.parent.rmdir()


@dataclass(frozen=True)
class TrainConfig:
    """Everything that a run needs to be run again.

    seed: Of the run. every: Rounds between checkpoints. task: Options of the task, see its config
        class.
    phase1: Sizes. hyper: Rates.
    """

    seed: int = 0
    every: int = 20
    task: Table = field(default_factory=dict)
    phase1: Phase1Config = field(default_factory=Phase1Config)
    hyper: Phase1Hyper = field(default_factory=Phase1Hyper)

    def __post_init__(self):
        if not 0 <= self.seed <= MAX_SEED:
            raise BadInput(f"seed = {self.seed}: give a whole number from 0 to {MAX_SEED}")
        check_hyper(self.hyper)


class Trained(NamedTuple):
    """A run as Phase 2 needs it: `state` after `rounds` rounds of training."""

    phase1: Phase1
    hyper: Phase1Hyper
    state: Phase1State
    rounds: int


def traced(hyper: Phase1Hyper) -> Phase1Hyper:
    """The same with float32 arrays as leaves, so that a changed value is not a changed program."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), hyper)


def train_run(config: TrainConfig, run: RunFolder, progress: Callable[..., None]) -> Trained:
    """Phase 1 of `run.task`, from the run's checkpoint if it has one; writes metrics and
    checkpoints as it goes.

    `progress(done, total, note)` is called between chunks. A chunk is `every` rounds, or the
    largest number below that divides the run, so that one compiled program serves all of it.
    """
    phase1 = _phase1_of(config, run, progress)
    hyper = traced(config.hyper)
    state, done = run.restore(jax.jit(phase1.init)(jax.random.key(config.seed)))
    total = phase1.config.rounds
    if not 0 <= done <= total:
        raise BadInput(
            f"{run.path}: the checkpoint is of round {done}, but the run has {total}; train anew"
        )
    size = largest_divisor(min(config.every, total), total, done)
    advance = jax.jit(phase1.run, donate_argnums=0)
    while done < total:
        state, info = advance(state, hyper, jnp.arange(done, done + size))
        rows = metric_rows(phase1, info, done)
        run.append_metrics(rows)
        done += size
        run.save(state, done)
        progress(done, total, f"reward {rows[-1]['final_reward']:.2f}")
    return Trained(phase1, hyper, state, done)


def load_run(run: RunFolder) -> Trained:
    """A finished or half-finished run, to adapt with; BadInput where it has no checkpoint."""
    config = configs.from_table(TrainConfig, run.config, str(run.path / "config.toml"))
    phase1 = _phase1_of(config, run)
    state, rounds = run.load(jax.eval_shape(phase1.init, jax.random.key(config.seed)))
    if rounds == 0:
        raise BadInput(
            f"{run.path}: nothing was trained yet; run `adaptsim train` with --resume first"
        )
    return Trained(phase1, traced(config.hyper), state, rounds)


def adapt_run(
    trained: Trained, key: jax.Array, target: Any, *, starts: int = 2, iterations: int = 10
) -> Phase2Result:
    """Phase 2 in `target: [D]` (physical values) from `starts` members of the run's S_E."""
    phase1 = trained.phase1
    start_key, run_key = jax.random.split(key)
    chosen = draw_starts(
        start_key,
        trained.state.archive,
        archive_size(phase1, trained.rounds),
        starts,
        phase1.task.first,
    )

    def found(k, w, s, t, h):
        plan = StepPlan(iterations, h.delta, h.shrink)
        return adapt(k, phase1.task, phase1.bdq, w, s, t, plan)

    weights = trained.state.learner.target
    return jax.jit(found)(run_key, weights, chosen, jnp.asarray(target, jnp.float32), trained.hyper)


def _phase1_of(
    config: TrainConfig, run: RunFolder, progress: Callable[..., None] | None = None
) -> Phase1:
    """progress: of what the task learns first; None where that must be there already."""
    task = make_task(run.task, config.task, str(run.path / "config.toml"))
    task = prepared(task, config.seed, run.path, progress or silent, make=progress is not None)
    return make_phase1(task, config.phase1)


def metric_rows(phase1: Phase1, info: Any, done: int) -> list[Table]:
    """One row a round for `metrics.jsonl`; adaptation steps are counted as transitions stored."""
    columns = {
        name: jax.device_get(values)
        for name, values in info._asdict().items()
        if values is not None
    }
    per_round = phase1.config.parallel * phase1.config.horizon
    count = len(columns["reward"])
    return [
        {"round": done + i + 1, "adaptation_steps": (done + i + 1) * per_round}
        | {name: float(values[i]) for name, values in columns.items()}
        for i in range(count)
    ]


PRESETS_FILE = Path(__file__).with_name("presets.toml")
PRESETS = (
    "paper-pendulum",
    "paper-pushing",
    "native-pushing",
    "mjx-pushing",
    "hydro-scooping",
    "mjx-scooping",
)
"""Those that --preset takes: the part behind the hyphen is the task."""


def presets_of(task: str) -> list[str]:
    """Those of one task."""
    return [name for name in PRESETS if name.endswith(f"-{task}")]


def preset(name: str) -> TrainConfig:
    """The configuration called `name` in `presets.toml`."""
    tables = configs.read(PRESETS_FILE)
    whole: Table = {}
    chain = [name]
    while base := tables[chain[-1]].get("base"):
        chain.append(base)
    for each in reversed(chain):
        table = {key: value for key, value in tables[each].items() if key != "base"}
        whole = configs.over(whole, table) | {"task": table.get("task", whole.get("task", {}))}
    return configs.from_table(TrainConfig, whole, f"preset '{name}'")


def default_config(task: str) -> TrainConfig:
    """What `adaptsim train TASK` starts from."""
    if task in ("pushing", "scooping"):
        return preset(task)
    if task not in TASKS:
        return TrainConfig()
    return configs.from_table(TrainConfig, dict(TASKS[task].train), f"task {task}, train")


def table_of(path: str | Path, task: str, where: str) -> Table:
    """The config of `task` in a file: a run's, or a bare table. `where` names the file in a
    BadInput.
    """
    table = configs.read(path)
    if not isinstance(table.get("config"), dict):
        return table
    if table.get("task", task) != task:
        raise BadInput(f"{where}: is of task '{table['task']}', not '{task}'; name another file")
    return store.config_in(table, Path(path).parent)


def with_defaults(task: str, table: Table) -> Table:
    """`table` over the task's default config, key by key. A run's own config is whole and stays as
    it is.
    """
    if {f.name for f in fields(TrainConfig)} <= set(table):
        return table
    return configs.over(configs.to_table(default_config(task)), table)
