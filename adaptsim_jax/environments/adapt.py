"""What `adaptsim adapt` shows of an environment: returns over iterations, and a film of the first
and the best policy.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.config import EnvironmentConfig
from adaptsim_jax.environments.policies import acting_of
from adaptsim_jax.environments.task import environment_setting, task_of
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.faces import AdaptFace, AdaptView, Look

NOMINAL = "told the file's own values, mean of 8 episodes"
EPISODES = 8


def shown(view: AdaptView) -> Look:
    """Returns of all starts, beside that of the policy for the file's own values."""
    from matplotlib.ticker import MaxNLocator

    from adaptsim_jax.report import figures as look

    figure, (ax,) = look.new_figure(4.6, 2.9)
    for start, row in enumerate(np.asarray(view.result.history.score), 1):
        mark = {"marker": "o", "markersize": 3, "linewidth": 1.4}
        ax.plot(range(len(row)), row, label=f"AdaptSim, start {start}", **mark)
    nominal = at_nominal(view.task, view.config)
    ax.axhline(nominal, color=look.INK, linestyle="--", linewidth=1.0, label=NOMINAL)
    look.style_axes(ax)
    ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    ax.set_xlabel("iteration")
    ax.set_ylabel(f"return in {view.target}")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=7)
    return Look(figure, lambda: clips_of(view))


def at_nominal(task: Task, config: EnvironmentConfig, episodes: int = EPISODES) -> float:
    """Mean return of the policy for the file's own values where `task` rolls out, of as many
    `episodes`.
    """
    setting = environment_setting(config)
    values = jnp.asarray([f.nominal for f in setting.fields[: task.space.dim]], jnp.float32)
    mean = jnp.clip(task.space.unit(values), 0.0, 1.0)
    init_key, train_key, key = jax.random.split(jax.random.key(0), 3)
    nominal = Gaussian(mean, jnp.full(mean.shape, setting.config.spread))
    policy = jax.jit(task.train)(train_key, nominal, task.init_policy(init_key))
    score = jax.jit(jax.vmap(lambda k: task.rollout(k, policy, values).score))
    return float(np.nanmean(score(jax.random.split(key, episodes))))


def clips_of(view: AdaptView) -> list[Any]:
    """An episode of the first and one of the best policy, from the same start in the same
    target.
    """
    from adaptsim_jax.environments.film import clip_of, filmed_episode

    setting = environment_setting(view.config)
    if setting.sim.native is None or view.target not in setting.targets:
        raise BadInput(
            "--video: films an environment with a MuJoCo model, in a target that env.toml names; "
            "leave --video out"
        )
    acting = acting_of(setting, view.prepared(task_of(setting)).learned)
    scores = view.of_start(view.result.history.score)
    clips = []
    for i in (0, view.best):
        policy = jax.tree.map(lambda x, i=i: x[i], view.policies)
        take = filmed_episode(setting, acting, policy, view.target)
        clips.append(clip_of(*take, text=f"iteration {i}, return {scores[i]:.1f}"))
    return clips


def scene() -> Any:
    from adaptsim_jax.environments.film import SCENE

    return SCENE


ADAPT = AdaptFace("returns", shown, scene)
