"""What `adaptsim adapt` shows of scooping: how trials end over iterations, and a film of the first and the best policy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.commands.adapt_pushing import axes, picked

MOMENTS = (0.35, 0.5, 1.0)  # s, that the figure shows of a trial


def show(
    trained: Any, options: dict[str, Any], found: dict[str, Any], result: Any, out: Path, video: bool
) -> list[str]:
    """Draw the start that holds the best visit into `out`; returns lines for a person, one a file."""
    from adaptsim_jax import config
    from adaptsim_jax.report import figures as look
    from adaptsim_jax.report.figures_scooping import scoops_over_iterations
    from adaptsim_jax.tasks.scooping import ScoopingConfig

    task, made = trained.phase1.task, config.from_table(ScoopingConfig, options, found["run"])
    reward = np.asarray(result.history.reward)
    start, best = np.unravel_index(np.nanargmax(reward), reward.shape)
    target = np.array(list(found["target"]["params"].values()))
    clips = clips_of(made, result, int(start), target)
    shown = picked(len(clips), int(best))
    heads = [f"iteration {i}" + (" (best)" if i == best else "") for i in shown]
    figure = scoops_over_iterations(
        [clips[i] for i in shown],
        heads,
        [float(reward[start, i]) for i in shown],
        np.asarray(task.space.physical(result.history.mean[start])),
        axes(task.space),
        moments=MOMENTS,
        target=target.tolist(),
    )
    lines = [f"written: {look.save(figure, out / 'scoops.png')}"]
    if video:
        from adaptsim_jax.report.scoop_video import write_scoop_video

        visits = [0, int(best)] if best else [0]
        path, how = write_scoop_video([clips[i] for i in visits], out)
        lines.append(f"written: {path}, {how}")
    return lines


def clips_of(made: Any, result: Any, start: int, target: np.ndarray) -> list[Any]:
    """A clip `ScoopClip` of each visit of the start: what its policy does in the target, without an error of execution."""
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.models import scooping_hydro as hydro
    from adaptsim_jax.report.scoop_video import ScoopClip
    from adaptsim_jax.tasks import scooping

    policy = jax.tree.map(lambda x: x[start], result.history.policy)
    act, options = scooping.make_policy(made), scooping.checked(made)

    @jax.jit
    @jax.vmap
    def run(one):
        action = act(one, jnp.zeros(2))
        return action, hydro.rollout(jnp.asarray(target, jnp.float32), action, options, made.numerics)

    actions, scoops = run(policy)
    clips = []
    for i, (pitch, rate, distance) in enumerate(np.asarray(actions)):
        text = f"iteration {i}: {np.degrees(pitch):.1f} deg, {rate:+.2f} rad/s, {1e3 * distance:.0f} mm"
        piece, tip = np.asarray(scoops.piece[i]), np.asarray(scoops.tip[i])
        clips.append(ScoopClip(piece, tip, target, bool(scoops.success[i] > 0.5), text))
    return clips
