"""What `adaptsim adapt` shows of scooping: how trials end over iterations, and films of them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.faces import AdaptFace, AdaptView, Look
from adaptsim_jax.tasks.scooping import hydro
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.config import checked

SYMBOLS = {"mu": "μ piece", "e": "e (Pa)", "g": "shape", "h": "h (m)"}


def clips_of(config: Any, policies: Any, target: np.ndarray) -> list[Any]:
    """A clip of each of `policies [P]`: what it does in the target, without an error of
    execution.
    """
    from adaptsim_jax.tasks.scooping.film import ScoopClip

    act, options = scooping.make_policy(config), checked(config)

    @jax.jit
    @jax.vmap
    def run(one):
        action, params = act(one, jnp.zeros(2)), jnp.asarray(target, jnp.float32)
        return action, hydro.rollout(params, action, options, config.numerics)

    actions, scoops = run(policies)
    clips = []
    for i, (pitch, rate, distance) in enumerate(np.asarray(actions)):
        angle = f"{np.degrees(pitch):.1f} deg, {rate:+.2f} rad/s"
        text = f"iteration {i}: {angle}, {1e3 * distance:.0f} mm"
        piece, tip = np.asarray(scoops.piece[i]), np.asarray(scoops.tip[i])
        clips.append(ScoopClip(piece, tip, target, bool(scoops.success[i] > 0.5), text))
    return clips


def shown(view: AdaptView) -> Look:
    """The start that holds the best visit."""
    from adaptsim_jax.report.figures_comparison import axes_of
    from adaptsim_jax.tasks.scooping import film

    clips = clips_of(view.config, view.policies, view.values)
    iterations, heads = view.picked(len(clips))
    rewards = view.of_start(view.result.history.reward)
    figure = film.scoops_over_iterations(
        [clips[i] for i in iterations],
        heads,
        [float(rewards[i]) for i in iterations],
        view.params,
        axes_of(view.task.space, SYMBOLS),
        target=list(view.values),
    )
    notes = ()
    if (count := view.trials_reported()) is not None:
        notes = (f"scoops are corrected by those made before, the best policy's by all {count}",)
    visits = [0, view.best] if view.best else [0]
    return Look(figure, lambda: [clips[i] for i in visits], notes)


def before_after(config: Any, both: Any, target: np.ndarray) -> Look:
    """The scoops of two policies, before and after adaptation."""
    from adaptsim_jax.tasks.scooping import film

    clips = clips_of(config, both, target)
    figure = film.film_strips(clips, ("before", "after"))
    return Look(figure, lambda: clips, ends=tuple(film.ending(clip) for clip in clips))


def scene() -> Any:
    from adaptsim_jax.tasks.scooping.film import SCENE

    return SCENE


ADAPT = AdaptFace("scoops", shown, scene, before_after, as_compared=lambda config: config.correct)
