"""An environment's task as the registry holds it: `env.toml`, or the cart-pole where nothing is
said.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.episodes import ActingPolicy
from adaptsim_jax.environments.policies import acting_of
from adaptsim_jax.environments.setting import EnvironmentConfig, Setting
from adaptsim_jax.environments.task import environment_setting, play_in, task_of
from adaptsim_jax.report.film import Moment, Scene, Stage
from adaptsim_jax.space import Gaussian
from adaptsim_jax.tasks.base import AdaptFace, AdaptView, Look, Task, TaskKind

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
    return float(jnp.nanmean(score(jax.random.split(key, episodes))))


def clips_of(view: AdaptView) -> list[Any]:
    """An episode of the first and one of the best policy, from the same start in the same
    target.
    """

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


def scene() -> Scene:
    """How episodes are filmed."""
    return SCENE


ADAPT = AdaptFace("returns", shown, scene)


# ---------------------------------------------------------------- films
#
# Episodes of policies in a target, on film: places of a model's joints over time.

FPS = 25.0  # frames a second of a film, as near as whole steps go


def filmed_episode(
    setting: Setting, acting: ActingPolicy, policy: Any, target: str
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """`(qpos [T, nq], mocap [T, 3 n], s a row, the model's bytes)` of one episode of `policy` in
    the target, from a start that is the same for all policies.
    """
    play, values = play_in(setting, setting.targets[target])

    @jax.jit
    def run(policy):
        world = play.world(values)
        live = play.reset(world, jax.random.key(0))

        def step(carry, key):
            live, memory = carry
            action, memory = acting.act(key, policy, memory, live)
            after = play.step(world, live, action)
            data = setting.sim.data(after.state)
            return (after, memory), (data.qpos, data.mocap_pos.reshape(-1), after.done)

        keys = jax.random.split(jax.random.key(1), setting.sim.length)
        return jax.lax.scan(step, (live, acting.start(policy)), keys)[1]

    qpos, mocap, done = map(np.asarray, run(jax.tree.map(jnp.asarray, policy)))
    over = np.flatnonzero(done > 0)
    end = int(over[0]) + 1 if len(over) else len(qpos)
    return qpos[:end], mocap[:end], setting.sim.dt, model_bytes(setting.sim.native)


@dataclass(frozen=True)
class EpisodeClip:
    """One episode: places `qpos [T, nq]` and `mocap [T, 3 n]`, a row each `dt` s; the model's bytes
    (mjb); a line of text.
    """

    qpos: Any
    mocap: Any
    dt: Any
    model: Any
    text: str


def clip_of(
    qpos: np.ndarray, mocap: np.ndarray, dt: float, model: np.ndarray, text: str
) -> EpisodeClip:
    """A clip at its own speed, as near to 25 frames a second as whole steps go."""
    every = max(1, round(1.0 / (FPS * dt)))
    return EpisodeClip(qpos[::every], mocap[::every], every * dt, model, text)


def moments(clip: EpisodeClip) -> list[Moment]:
    """Every row."""
    return [Moment(r, float(clip.dt) * r, str(clip.text)) for r in range(len(clip.qpos))]


def drawing(clip: EpisodeClip) -> Callable[[Moment], Any]:
    """The joints' coordinates over time with a line at the moment, where nothing can be
    rendered.
    """
    from matplotlib.figure import Figure

    from adaptsim_jax.report import figures as look

    figure = Figure(figsize=(4.8, 3.6), dpi=100, facecolor="white")
    ax = figure.add_axes((0.14, 0.14, 0.8, 0.74))
    ax.plot(float(clip.dt) * np.arange(len(clip.qpos)), clip.qpos, linewidth=1.2)
    ax.set_xlabel("s")
    ax.set_ylabel("coordinates (m, rad)")
    figure.text(0.14, 0.93, str(clip.text), fontsize=11, color=look.INK)
    line = ax.axvline(0.0, color=look.INK, linewidth=0.8)

    def draw(moment: Moment) -> Any:
        line.set_xdata([moment.time] * 2)
        return figure

    return draw


def stage(clip: EpisodeClip) -> Stage:
    """The model by its first camera, or a free one that sees all of it."""
    model = model_of_bytes(clip.model)

    def place(data: Any, row: int) -> None:
        data.qpos[:] = clip.qpos[row]
        data.mocap_pos[:] = clip.mocap[row].reshape(data.mocap_pos.shape)

    return Stage(model, place, lambda row: 0 if model.ncam else -1, band=True)


def model_bytes(model: Any) -> np.ndarray:
    """A compiled model as bytes (mjb)."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer


def model_of_bytes(raw: np.ndarray) -> Any:
    """The compiled model of `model_bytes`."""
    with tempfile.NamedTemporaryFile(suffix=".mjb", delete=False) as file:
        file.write(np.asarray(raw, np.uint8).tobytes())
    try:
        return mujoco.MjModel.from_binary_path(file.name)
    finally:
        os.unlink(file.name)


SCENE = Scene(
    home=f"{__name__}:SCENE",
    name="policies",
    clip=EpisodeClip,
    size=(480, 360),
    hold=12,
    fps=lambda clips: 1.0 / float(clips[0].dt),
    moments=moments,
    drawing=drawing,
    side="coordinates over time",
    stage=stage,
)


# Phase 1 at a fifth of the pendulum's size: a trajectory costs eleven episodes, and eight more that
# scale its reward
TRAIN = {
    "every": 5,
    "phase1": {
        "trajectories": 1000,
        "parallel": 50,
        "horizon": 10,
        "updates": 400,
        "capacity": 10000,
        "archive": 2000,
        "hidden": [64, 64],
        "guided": 0.3,
    },
    "hyper": {"delta": 0.2, "shrink": 0.8, "gain": 2.0},
}


def make_environment(config: EnvironmentConfig) -> Task:
    """The task of `config`; its policy is trained by its `preparation`. BadInput names a field, a
    target or a key at fault.
    """
    return task_of(environment_setting(config))


TASK = TaskKind(EnvironmentConfig, make_environment, train=TRAIN, adapt=ADAPT)
