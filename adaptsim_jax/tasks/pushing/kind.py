"""The push as the registry holds it: what of a mended model it takes, and what `adaptsim adapt`
shows of it, table tops over iterations and films.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput, brief
from adaptsim_jax.mend.model_toml import RENEW, read_form
from adaptsim_jax.tasks.base import AdaptFace, AdaptView, Look, TaskKind
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.engines import BACKENDS, PARITY
from adaptsim_jax.tasks.pushing.model import PAPER, PARAMETERS
from adaptsim_jax.tasks.pushing.one_shot import as_deployed, make_pushing_one_shot
from adaptsim_jax.tasks.pushing.robot import PushSessions
from adaptsim_jax.tasks.pushing.slide import NEUTRAL
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing
from adaptsim_jax.tasks.pushing.trial import make_guide, make_simulator

if TYPE_CHECKING:
    from adaptsim_jax.tasks.pushing.figures import Push

OWN = ("friction", "mass", "coefficients")


def of_model(table: Table, where: str) -> Table:
    """Options `friction`, `coefficients`, `mended` and `fitted` of a model file's table. Under
    `left_out` the names of effects that are of the measurement alone (a camera that is late or
    turned) and so none of the simulator's. Raises BadInput with the key.
    """
    form = read_form(table, where, OWN)
    if (mass := form.own.get("mass", PAPER.mass)) != PAPER.mass:
        raise BadInput(
            f"{where}: mass = {brief(mass)}; policies are trained for a bottle of {PAPER.mass} kg "
            "only"
        )
    for name in PARAMETERS:
        if name not in form.declared:
            raise BadInput(f"{where}: [declared] has no number '{name}'; {RENEW}")
    fitted = [form.declared[name].value for name in PARAMETERS]
    mended, left_out = {}, []
    for effect in form.effects:
        of_slide = {name: p.value for name, p in effect.parameters.items() if name in NEUTRAL}
        mended |= of_slide
        if not of_slide:
            left_out.append(effect.name)
    options = {key: form.own[key] for key in ("friction", "coefficients") if key in form.own}
    return options | {"mended": mended, "fitted": fitted, "left_out": left_out}


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


TASK = TaskKind(
    PushingConfig,
    make_pushing,
    make_pushing_one_shot,
    of_model=of_model,
    adapt=ADAPT,
    robot=PushSessions(),
    symbols=SYMBOLS,
    backends=BACKENDS,
    parity=PARITY,
)
