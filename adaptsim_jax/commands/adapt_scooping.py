"""What `adaptsim adapt` shows of scooping: how trials end over iterations, and a film of the first
and the best policy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.commands.adapt_pushing import picked, visits_of
from adaptsim_jax.commands.task_parts import AdaptPart

MOMENTS = (0.35, 0.5, 1.0)  # s, that the figure shows of a trial


def adapt(
    trained: Any, options: dict[str, Any], key: Any, target: Any, starts: int, iterations: int
) -> Any:
    """Phase 2 in `target [D]`; where the task corrects what is deployed, with the visits and the
    corrections of `compare`. The best policy is that of the visit with the highest return,
    corrected by all scoops that were made.
    """
    from adaptsim_jax.adaptation.training import adapt_run
    from adaptsim_jax.core import config
    from adaptsim_jax.tasks.scooping.task import ScoopingConfig

    if not config.from_table(ScoopingConfig, options, "config, [task]").correct:
        return adapt_run(trained, key, target, starts=starts, iterations=iterations)
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.adaptation.phase2 import draw_starts
    from adaptsim_jax.adaptation.training import archive_size
    from adaptsim_jax.baselines.arena import Arena, lanes
    from adaptsim_jax.baselines.tour import tour
    from adaptsim_jax.tasks.registry import make_one_shot

    one, phase1 = make_one_shot("scooping", options), trained.phase1
    arena = Arena(one, one.world(one.engine), np.asarray(target)[None])
    start_key, run_key = jax.random.split(key)
    batch = lanes(1, np.array([jax.random.bits(run_key)]), starts, label=1)
    first = draw_starts(
        start_key, trained.state.archive, archive_size(phase1, trained.rounds), starts
    )

    def each(x):
        return jnp.broadcast_to(x, (starts, *jnp.shape(x)))

    weights, hyper = each(trained.state.learner.target), jax.tree.map(each, trained.hyper)
    return as_deployed(arena, batch, tour(arena, batch, phase1, weights, hyper, first, iterations))


def as_deployed(arena: Any, batch: Any, found: Any) -> Any:
    """A `Phase2Result` of a tour of one target and seed, its policies told of the scoops that they
    are corrected by.
    """
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.adaptation.episode import Episode
    from adaptsim_jax.adaptation.phase2 import Phase2Result, best_visit

    told = [found.memory.deployed(policies, i) for i, policies in enumerate(found.policies)]
    policies = jax.tree.map(lambda *x: jnp.stack(x, 1), *told)
    history = Episode(
        found.means, policies, found.obs, found.scores, found.rewards, found.actions[:, :-1]
    )
    start, visit = map(int, best_visit(found.scores))
    last = jax.tree.map(lambda x: x[start], found.memory.deployed(found.policies[visit]))
    reward = arena.score(batch.where[:1], jax.tree.map(lambda x: x[None], last))[0]
    return Phase2Result(
        last, found.means[start, visit], found.scores[start, visit], reward, history
    )


def show(
    trained: Any,
    options: dict[str, Any],
    found: dict[str, Any],
    result: Any,
    out: Path,
    video: bool,
) -> list[str]:
    """Draw the start that holds the best visit into `out`; returns lines for a person, one a
    file.
    """
    from adaptsim_jax.adaptation.phase2 import best_visit
    from adaptsim_jax.core import config
    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_pushing import axes_of
    from adaptsim_jax.report.figures_scooping import scoops_over_iterations
    from adaptsim_jax.tasks.scooping.task import ScoopingConfig

    task, made = trained.phase1.task, config.from_table(ScoopingConfig, options, found["run"])
    reward = np.asarray(result.history.reward)
    start, best = map(int, best_visit(result.history.score))
    target = np.array(list(found["target"]["params"].values()))
    clips = clips_of(made, visits_of(result, start), target)
    shown = picked(len(clips), best)
    heads = [f"iteration {i}" + (" (best)" if i == best else "") for i in shown]
    figure = scoops_over_iterations(
        [clips[i] for i in shown],
        heads,
        [float(reward[start, i]) for i in shown],
        np.asarray(task.space.physical(result.history.mean[start])),
        axes_of(task.space, task.name),
        moments=MOMENTS,
        target=target.tolist(),
    )
    lines = [f"written: {look.save(figure, out / 'scoops.png')}"]
    if result.policy.told is not None:
        count = int(np.sum(result.policy.told.used))
        lines.insert(
            0, f"scoops are corrected by those made before, the best policy's by all {count}"
        )
    if video:
        from adaptsim_jax.report.scoop_video import write_scoop_video

        visits = [0, best] if best else [0]
        path, how = write_scoop_video([clips[i] for i in visits], out)
        lines.append(f"written: {path}, {how}")
    return lines


def clips_of(made: Any, policies: Any, target: np.ndarray) -> list[Any]:
    """A clip `ScoopClip` of each of `policies [P]`: what it does in the target, without an error of
    execution.
    """
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.report.scoop_video import ScoopClip
    from adaptsim_jax.tasks.scooping import hydro
    from adaptsim_jax.tasks.scooping import task as scooping

    act, options = scooping.make_policy(made), scooping.checked(made)

    @jax.jit
    @jax.vmap
    def run(one):
        action = act(one, jnp.zeros(2))
        return action, hydro.rollout(
            jnp.asarray(target, jnp.float32), action, options, made.numerics
        )

    actions, scoops = run(policies)
    clips = []
    for i, (pitch, rate, distance) in enumerate(np.asarray(actions)):
        text = f"iteration {i}: {np.degrees(pitch):.1f} deg, {rate:+.2f} rad/s, {1e3 * distance:.0f} mm"
        piece, tip = np.asarray(scoops.piece[i]), np.asarray(scoops.tip[i])
        clips.append(ScoopClip(piece, tip, target, bool(scoops.success[i] > 0.5), text))
    return clips


PART = AdaptPart(show, adapt)
