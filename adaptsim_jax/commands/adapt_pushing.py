"""What `adaptsim adapt` deploys of the push, and shows: table tops over iterations, and a film of
the first and the best policy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.commands.task_parts import AdaptPart

COLUMNS = 6
GOALS = ((0.78, 0.05), (0.93, -0.06))  # m: a near one on the left and a far one on the right


def adapt(
    trained: Any, options: dict[str, Any], key: Any, target: Any, starts: int, iterations: int
) -> Any:
    """Phase 2 in `target [D]`, as it is deployed."""
    from adaptsim_jax.adaptation.training import adapt_run

    return deployed(
        options, adapt_run(trained, key, target, starts=starts, iterations=iterations), target
    )


def deployed(options: dict[str, Any], result: Any, target: Any) -> Any:
    """`result` with its policies and rewards as they are deployed: corrected by the pushes made
    before, and the best visit's policy by all that were made, where the task does that (`correct`).
    """
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.core import config
    from adaptsim_jax.tasks.pushing import deployed as after
    from adaptsim_jax.tasks.pushing.task import PushingConfig

    made = config.from_table(PushingConfig, options, "config, [task]")
    if not made.correct or not made.show_goal:
        return result
    aim, history = jnp.asarray(target, jnp.float32), result.history
    policies, every = jax.jit(lambda h: after.deployed(h, aim, made))(history)
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), policies)
    best = jax.tree.map(lambda x: x[None], result.policy._replace(told=every))
    together = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), flat, best)
    rewards = jax.jit(lambda p: after.tested(p, aim, made))(together)
    history = history._replace(policy=policies, reward=rewards[:-1].reshape(history.reward.shape))
    return result._replace(
        policy=result.policy._replace(told=every), reward=rewards[-1], history=history
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
    from adaptsim_jax.report import figures_pushing as draw
    from adaptsim_jax.tasks.pushing.task import PushingConfig

    task, made = trained.phase1.task, config.from_table(PushingConfig, options, found["run"])
    start, best = map(int, best_visit(result.history.score))
    target = np.array(list(found["target"]["params"].values()))
    goals, actions, tracks, rewards = pushes_of(made, visits_of(result, start), target)
    shown = picked(len(tracks), best)
    panels = [
        [[draw.Push(goals[g], tracks[i, g], rewards[i, g])] for i in shown]
        for g in range(len(goals))
    ]
    params = np.asarray(task.space.physical(result.history.mean[start]))
    figure = draw.pushes_over_iterations(
        panels,
        [[f"iteration {i}" + (" (best)" if i == best else "") for i in shown]],
        params,
        draw.axes_of(task.space, task.name),
        patch=float(target[3]),
        target=target.tolist(),
    )
    lines = [f"written: {look.save(figure, out / 'pushes.png')}"]
    if result.policy.told is not None:
        made_so_far = int(np.sum(result.policy.told.used))
        lines.insert(
            0,
            f"actions are corrected by the pushes made before, the best policy's by all "
            f"{made_so_far}",
        )
    if video:
        visits = [(0, "first"), (best, "best")] if best else [(0, "best")]
        takes = [
            (f"iteration {i} ({word})", actions[i, g], goals[g])
            for g in range(len(goals))
            for i, word in visits
        ]
        path, how = filmed(made, target, takes, out)
        lines.append(f"written: {path}, {how}")
    return lines


def picked(count: int, best: int) -> list[int]:
    """The first, the last and evenly between them; the best takes the place of the one nearest to
    it.
    """
    shown = sorted({round(i) for i in np.linspace(0, count - 1, min(COLUMNS, count))})
    if best not in shown:
        last = len(shown) - 1
        shown[min(range(len(shown)), key=lambda k: (abs(shown[k] - best), k in (0, last)))] = best
    return shown


def visits_of(result: Any, start: int) -> Any:
    """The policies `[I + 1]` of one start's visits."""
    import jax

    return jax.tree.map(lambda x: x[start], result.history.policy)


def pushes_of(made: Any, policies: Any, target: np.ndarray) -> tuple[np.ndarray, ...]:
    """Goals `[G, 2]`, and for each of `policies [P]`: actions `[P, G, 2]`, tracks `[P, G, T, 2]`,
    rewards `[P, G]`.
    """
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.tasks.pushing import task as pushing
    from adaptsim_jax.tasks.pushing.simulator import make_guide, make_simulator

    simulate = make_guide(made) or make_simulator(made)
    goals, act = jnp.asarray(GOALS), pushing.make_policy(made)

    @jax.jit
    def run(policies):
        actions = jax.vmap(lambda p: act(p, goals))(policies)

        def one(a):
            return simulate(jnp.asarray(target, jnp.float32), a)

        tracks = jax.vmap(jax.vmap(one))(actions)
        return actions, tracks, pushing.push_reward(tracks[..., -1, :], goals[None])

    return tuple(map(np.asarray, (goals, *run(policies))))


def filmed(
    made: Any, target: np.ndarray, takes: list[tuple[str, np.ndarray, np.ndarray]], out: Path
) -> tuple[Path, str]:
    """Pushes (who, action, goal) in the MuJoCo scene, on film; its path, and what drew it."""
    from adaptsim_jax.report.push_video import Clip, write_push_video
    from adaptsim_jax.tasks.pushing.engines.registry import make_backend
    from adaptsim_jax.tasks.pushing.model import START, PushOptions

    actions, count = np.stack([action for _, action, _ in takes]), len(takes)
    scene = make_backend("native", PushOptions(friction=made.friction, duration=made.duration))
    states, _ = scene.simulate(np.tile(target, (count, 1)), actions, np.tile(START, (count, 1)))
    clips = []
    for (who, action, goal), state in zip(takes, states, strict=True):
        apart = 100 * np.linalg.norm(state[-1, :2] - goal)
        clips.append(
            Clip(state, action, goal, float(target[3]), f"{who}: {apart:.0f} cm from the goal")
        )
    return write_push_video(clips, out)


PART = AdaptPart(show, adapt)
