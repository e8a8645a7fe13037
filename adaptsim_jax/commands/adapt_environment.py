"""What `adaptsim adapt` shows of an environment: returns over iterations, and a film of the first
and the best policy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adaptsim_jax.commands.task_parts import AdaptPart

NOMINAL = "told the file's own values, mean of 8 episodes"


def show(
    trained: Any,
    options: dict[str, Any],
    found: dict[str, Any],
    result: Any,
    out: Path,
    video: bool,
) -> list[str]:
    """Draw `returns.png` into `out`, and `policies.mp4` where a film is wanted; returns lines for a
    person, one a file.
    """
    import numpy as np
    from matplotlib.ticker import MaxNLocator

    from adaptsim_jax.report import figures as look

    scores = np.asarray(result.history.score)
    figure, (ax,) = look.new_figure(4.6, 2.9)
    for start, row in enumerate(scores, 1):
        ax.plot(
            range(len(row)),
            row,
            marker="o",
            markersize=3,
            linewidth=1.4,
            label=f"AdaptSim, start {start}",
        )
    ax.axhline(
        at_nominal(trained.phase1.task, options),
        color=look.INK,
        linestyle="--",
        linewidth=1.0,
        label=NOMINAL,
    )
    look.quiet(ax)
    ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    ax.set_xlabel("iteration")
    ax.set_ylabel(f"return in {found['target']['name']}")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=7)
    lines = [f"written: {look.save(figure, out / 'returns.png')}"]
    if video:
        path, how = filmed(options, found, result, out)
        lines.append(f"written: {path}, {how}")
    return lines


def at_nominal(task: Any, options: dict[str, Any], episodes: int = 8) -> float:
    """Mean return of the policy for the file's own values where `task` rolls out, of as many
    `episodes`.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from adaptsim_jax.core import config
    from adaptsim_jax.environments.config import EnvironmentConfig
    from adaptsim_jax.environments.kind import environment_setting
    from adaptsim_jax.space import Gaussian

    setting = environment_setting(config.from_table(EnvironmentConfig, options, "env.toml"))
    values = jnp.asarray([f.nominal for f in setting.fields[: task.space.dim]], jnp.float32)
    mean = jnp.clip(task.space.unit(values), 0.0, 1.0)
    init_key, train_key, key = jax.random.split(jax.random.key(0), 3)
    told = Gaussian(mean, jnp.full(mean.shape, setting.config.spread))
    policy = jax.jit(task.train)(train_key, told, task.init_policy(init_key))
    score = jax.jit(jax.vmap(lambda k: task.rollout(k, policy, values).score))
    return float(np.nanmean(score(jax.random.split(key, episodes))))


def filmed(
    options: dict[str, Any], found: dict[str, Any], result: Any, out: Path
) -> tuple[Path, str]:
    """An episode of the first and one of the best policy, from the same start in the same
    target.
    """
    import jax
    import numpy as np

    from adaptsim_jax.adaptation.phase2 import chosen_visit
    from adaptsim_jax.adaptation.prepared import learned
    from adaptsim_jax.core import config
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.store import RunFolder
    from adaptsim_jax.environments.config import EnvironmentConfig
    from adaptsim_jax.environments.film import filmed_episode
    from adaptsim_jax.environments.kind import environment_setting
    from adaptsim_jax.environments.task import acting_of, task_of
    from adaptsim_jax.report.env_video import clip_of, write_env_video

    setting = environment_setting(config.from_table(EnvironmentConfig, options, found["run"]))
    name, made = found["target"]["name"], task_of(setting).preparation
    if setting.sim.native is None or name not in setting.targets:
        raise BadInput(
            "--video: films an environment with a MuJoCo model, in a target that env.toml names; "
            "leave --video out"
        )
    run = RunFolder.open(found["run"])
    prepared = learned(task_of(setting), made, run.config.get("seed", 0), run.path, make=False)  # type: ignore[arg-type]
    acting = acting_of(setting, prepared.learned)
    start, best = map(int, chosen_visit(result.history, setting.config.doubt))
    policies = [jax.tree.map(lambda x, i=i: x[start, i], result.history.policy) for i in (0, best)]
    takes = [filmed_episode(setting, acting, policy, name) for policy in policies]
    means = np.asarray(result.history.score)[start, [0, best]]
    texts = [
        f"iteration {i}, return {score:.1f}" for i, score in zip((0, best), means, strict=True)
    ]
    clips = [clip_of(*take, text=text) for take, text in zip(takes, texts, strict=True)]
    return write_env_video(clips, out)


PART = AdaptPart(show)
