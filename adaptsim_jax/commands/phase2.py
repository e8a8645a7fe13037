"""Phase 2 as the commands run it: as a task deploys its policies, and what there is to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.episode import AdaptationEpisode
from adaptsim_jax.adaptation.phase1 import archive_size
from adaptsim_jax.adaptation.phase2 import Phase2Result, best_visit, chosen_visit, draw_starts
from adaptsim_jax.adaptation.training import adapt_run, learned
from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.store import RunFolder
from adaptsim_jax.report.figures import save
from adaptsim_jax.report.film import write_film
from adaptsim_jax.tasks.base import AdaptView
from adaptsim_jax.tasks.registry import TASKS, make_one_shot


def phase2(
    task: str,
    trained: Any,
    options: Table,
    key: Any,
    target: Any,
    starts: int,
    iterations: int,
) -> Phase2Result:
    """Phase 2 in `target [D]` (physical), its policies and rewards as they are deployed."""
    face = TASKS[task].adapt
    if face is None:
        return adapt_run(trained, key, target, starts=starts, iterations=iterations)
    made = config.from_table(TASKS[task].config, options, "config, [task]")
    if face.as_compared(made):
        return as_compared(task, trained, options, key, target, starts, iterations)
    result = adapt_run(trained, key, target, starts=starts, iterations=iterations)
    return face.deployed(made, result, target)


def as_compared(
    task: str,
    trained: Any,
    options: Table,
    key: Any,
    target: Any,
    starts: int,
    iterations: int,
) -> Phase2Result:
    """Phase 2 with the visits and the corrections of `compare`. The best policy is that of the
    visit with the highest return, corrected by all trials that were made.
    """
    from adaptsim_jax.baselines.adapting import LanePolicies, adaptation_trace
    from adaptsim_jax.baselines.arena import Arena, lanes

    one, phase1 = make_one_shot(task, options), trained.phase1
    arena = Arena(one, one.world(one.engine), np.asarray(target)[None])
    start_key, run_key = jax.random.split(key)
    batch = lanes(1, np.array([jax.random.bits(run_key)]), starts, label=1)
    used = archive_size(phase1, trained.rounds)
    first = draw_starts(start_key, trained.state.archive, used, starts)

    def each(x):
        return jnp.broadcast_to(x, (starts, *jnp.shape(x)))

    weights, hyper = each(trained.state.learner.target), jax.tree.map(each, trained.hyper)
    policies = LanePolicies(phase1, weights, hyper)
    found = adaptation_trace(arena, batch, policies, first, iterations)
    return _as_deployed(arena, batch, found)


def _as_deployed(arena: Any, batch: Any, found: Any) -> Phase2Result:
    """A trace of one target and seed, each policy with the trials that it is corrected by."""
    corrected = [found.memory.deployed(policies, i) for i, policies in enumerate(found.policies)]
    policies = jax.tree.map(lambda *x: jnp.stack(x, 1), *corrected)
    history = AdaptationEpisode(
        found.means, policies, found.obs, found.scores, found.rewards, found.actions[:, :-1]
    )
    start, visit = map(int, best_visit(found.scores))
    last = jax.tree.map(lambda x: x[start], found.memory.deployed(found.policies[visit]))
    reward = arena.score(batch.where[:1], jax.tree.map(lambda x: x[None], last))[0]
    return Phase2Result(
        last, found.means[start, visit], found.scores[start, visit], reward, history
    )


def write_look(
    run: RunFolder, task: Any, target: tuple[str, Any], result: Phase2Result, out: Path, film: bool
) -> list[str]:
    """Draw the start that holds the best visit into `out`, and film it; lines for a person, notes
    and a file each. target: Its name and values `[D]`.
    """
    kind = TASKS[run.task]
    made = config.from_table(kind.config, run.config.get("task", {}), str(run.path))
    start, best = map(int, chosen_visit(result.history, task.doubt))

    def prepared(task):
        seed = run.config.get("seed", 0)
        return learned(task, task.preparation, seed, run.path, make=False)

    adapt = kind.adapt
    assert adapt is not None  # its caller asks
    look = adapt.shown(AdaptView(task, made, *target, result, start, best, prepared))
    picture = save(look.figure, out / f"{adapt.picture}.png")
    lines = [*look.notes, f"written: {picture}"]
    if film:
        path, how = write_film(adapt.scene(), look.clips(), out)
        lines.append(f"written: {path}, {how}")
    return lines
