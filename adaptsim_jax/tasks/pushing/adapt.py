"""What `adaptsim adapt` shows of the push: table tops over iterations, and films of pushes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.faces import AdaptFace, AdaptView, Look
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.deployed import as_deployed
from adaptsim_jax.tasks.pushing.simulator import make_guide, make_simulator

if TYPE_CHECKING:
    from adaptsim_jax.tasks.pushing.figures import Push

GOALS = ((0.78, 0.05), (0.93, -0.06))  # m: a near one on the left and a far one on the right
SYMBOLS = {"mu": "μ table", "e": "e (Pa)", "mu_p": "μ patch", "y_p": "patch y (m)"}


class ShownPushes(NamedTuple):
    """Pushes of policies [P] at goals `[G, 2]` m: actions `[P, G, 2]`, tracks `[P, G, T, 2]` m,
    rewards `[P, G]`.
    """

    goals: np.ndarray
    actions: np.ndarray
    tracks: np.ndarray
    rewards: np.ndarray

    def of(self, policy: int) -> list[Push]:
        """The pushes of a policy, a goal each, for figures."""
        from adaptsim_jax.tasks.pushing.figures import Push

        parts = zip(self.goals, self.tracks[policy], self.rewards[policy], strict=True)
        return [Push(*each) for each in parts]


def shown_pushes(config: Any, policies: Any, target: np.ndarray) -> ShownPushes:
    """What `policies [P]` do in `target [D]`."""
    simulate = make_guide(config) or make_simulator(config)
    goals, act = jnp.asarray(GOALS), pushing.make_policy(config)

    def one(action):
        return simulate(jnp.asarray(target, jnp.float32), action)

    @jax.jit
    def run(policies):
        actions = jax.vmap(lambda p: act(p, goals))(policies)
        tracks = jax.vmap(jax.vmap(one))(actions)
        return actions, tracks, pushing.push_reward(tracks[..., -1, :], goals[None])

    return ShownPushes(*map(np.asarray, (goals, *run(policies))))


def shown(view: AdaptView) -> Look:
    """The start that holds the best visit."""
    from adaptsim_jax.report.figures_comparison import axes_of
    from adaptsim_jax.tasks.pushing.figures import pushes_over_iterations

    pushes = shown_pushes(view.config, view.policies, view.values)
    iterations, heads = view.picked(len(pushes.tracks))
    figure = pushes_over_iterations(
        [[[pushes.of(i)[g]] for i in iterations] for g in range(len(GOALS))],
        [heads],
        view.params,
        axes_of(view.task.space, SYMBOLS),
        patch=float(view.values[3]),
        target=list(view.values),
    )
    notes = ()
    if (count := view.trials_reported()) is not None:
        notes = (
            f"actions are corrected by the pushes made before, the best policy's by all {count}",
        )
    visits = [(0, "first"), (view.best, "best")] if view.best else [(0, "best")]
    names = [(i, f"iteration {i} ({word})") for i, word in visits]
    return Look(figure, lambda: clips_of(view.config, view.values, pushes, names), notes)


def before_after(config: Any, both: Any, target: np.ndarray) -> Look:
    """The pushes of two policies, before and after adaptation."""
    from adaptsim_jax.tasks.pushing import figures

    pushes = shown_pushes(config, both, target)
    figure = figures.before_after({"before": pushes.of(0), "after": pushes.of(1)}, float(target[3]))
    names = [(0, "before adaptation"), (1, "after adaptation")]
    return Look(figure, lambda: clips_of(config, target, pushes, names))


def clips_of(
    config: Any, target: np.ndarray, pushes: ShownPushes, names: Sequence[tuple[int, str]]
) -> list[Any]:
    """Clips in the MuJoCo scene, a goal after the other, of policies by number, and what each is
    called.
    """
    from adaptsim_jax.tasks.pushing.engines import make_backend
    from adaptsim_jax.tasks.pushing.film import PushClip
    from adaptsim_jax.tasks.pushing.model import START, PushOptions

    takes = [(g, i, name) for g in range(len(pushes.goals)) for i, name in names]
    actions, count = np.stack([pushes.actions[i, g] for g, i, _ in takes]), len(takes)
    scene = make_backend("native", PushOptions(friction=config.friction, duration=config.duration))
    states, _ = scene.simulate(np.tile(target, (count, 1)), actions, np.tile(START, (count, 1)))
    clips = []
    for (g, _, name), state, action in zip(takes, states, actions, strict=True):
        goal = pushes.goals[g]
        off = 100 * np.linalg.norm(state[-1, :2] - goal)
        text = f"{name}: {off:.0f} cm from the goal"
        clips.append(PushClip(state, action, goal, float(target[3]), text))
    return clips


def scene() -> Any:
    from adaptsim_jax.tasks.pushing.film import SCENE

    return SCENE


ADAPT = AdaptFace("pushes", shown, scene, before_after, deployed=as_deployed)
