"""An environment at work: what lies between a policy and a model, and episodes of a policy in a world.

Actions may come late or scaled, observations with noise. Of an episode its return is kept, and what of
it an adaptation observes.
"""  # noqa: E501

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.fields import INTERFACE, ModelField
from adaptsim_jax.environments.simulated import Physics, SimulatedTask


class Live(NamedTuple):
    """An environment at work: its own `state`, actions so far `[L, A]` (the newest first), `key` of
    what is drawn, `obs [O]` as the policy sees it, `reward []`, `done []`, and steps so far `time
    []`.
    """

    state: Any
    actions: Array
    key: Array
    obs: Array
    reward: Array
    done: Array
    time: Array


class SteppedModel(NamedTuple):
    """A model with its fields in place, and its interface: what steps need, computed once an
    episode.
    """

    model: Any
    delay: Array  # in steps
    scale: Array
    noise: Array


class Play(NamedTuple):
    """`world(values [F]) -> SteppedModel`, `reset(world, key) -> Live`, `step(world, live, action [A]) ->
    Live`; pure, of one sample.
    """  # noqa: E501

    sim: SimulatedTask
    fields: tuple[ModelField, ...]
    world: Callable[[Array], SteppedModel]
    reset: Callable[[SteppedModel, Array], Live]
    step: Callable[[SteppedModel, Live, Array], Live]


def make_play(
    sim: SimulatedTask,
    fields: tuple[ModelField, ...],
    longest: float = 0.0,
    physics: Physics | None = None,
) -> Play:
    """`sim` with `fields`, those of the interface among them, as arguments. longest: S, the
    greatest delay that may come.

    A delay between two steps is a mean of both actions, weighted by how near they are. Before the
    first action there is 0.
    """
    names = [field.name for field in fields]
    longest = max(longest, 0.0 if "delay" in names else sim.interface.get("delay", 0.0))
    if longest > sim.late > 0:
        raise BadInput(
            f"delay: {longest:g} s is more than the {sim.late:g} s that the model.toml's own "
            "delays leave room for; give less"
        )
    if sim.late:
        longest = 0.0
    held = int(-(-longest // sim.dt)) + 2 if longest > 0 else 1

    def own(values, name):
        nominal = sim.interface.get(name, INTERFACE[name][2])
        if name in names:
            return values[names.index(name)]
        return jnp.asarray(nominal, jnp.float32)

    def world(values):
        model = sim.edit(sim.model, fields, values)
        return SteppedModel(
            model,
            jnp.zeros(()) if sim.late else own(values, "delay") / sim.dt,
            own(values, "action_scale"),
            own(values, "observation_noise"),
        )

    def view(world, state, actions, key, time):
        obs, reward, done = sim.observed(state)
        if "observation_noise" in {*names, *sim.interface}:
            key, noise_key = jax.random.split(key)
            obs = obs + world.noise * jax.random.normal(noise_key, obs.shape)
        return Live(state, actions, key, obs, reward, done, time)

    def reset(world, key):
        state_key, key = jax.random.split(key)
        state = sim.reset(world.model, state_key)
        return view(world, state, jnp.zeros((held, sim.action_dim)), key, jnp.zeros((), jnp.int32))

    def step(world, live, action):
        actions = jnp.concatenate([jnp.clip(action, -1.0, 1.0)[None], live.actions[:-1]])
        sent = actions[0]
        if held > 1:
            near = jnp.clip(
                1.0 - jnp.abs(jnp.arange(held) - jnp.clip(world.delay, 0.0, held - 1.0)), 0.0, 1.0
            )
            sent = near @ actions
        state = sim.step(world.model, live.state, world.scale * sent, physics=physics)
        return view(world, state, actions, live.key, live.time + 1)

    return Play(sim, fields, world, reset, step)


WINDOWS, EARLY, LATE = 4, 8, 4


class ActingPolicy(NamedTuple):
    """A policy at work: `start(policy) -> memory`, `act(key, policy, memory, live) -> (action [A],
    memory)`; pure. luck: `(obs [O]) -> []`, by how much a start is worth more than others, as a
    return.
    """

    start: Callable[[Any], Any]
    act: Callable[[Array, Any, Any, Live], tuple[Array, Any]]
    luck: Callable[[Array], Array] = lambda obs: jnp.zeros(())


class Rollout(NamedTuple):
    """Of one visit, means over its episodes: return `score []`, `luck []`, which of it the start
    brought, `length []` in steps, `features [K]`.
    """

    score: Array
    luck: Array
    length: Array
    features: Array


class EpisodeSteps(NamedTuple):
    """Of one episode, `[T, ...]`: observation before each step, action, reward, and 1 while it goes
    on.
    """

    obs: Array
    action: Array
    reward: Array
    on: Array


def episode(
    key: Array, play: Play, acting: ActingPolicy, policy: Any, values: Array
) -> tuple[EpisodeSteps, Live]:
    """One episode of `policy` in the world of `values [F]`: its steps, and the environment's
    end.
    """
    reset_key, act_key = jax.random.split(key)
    world = play.world(values)
    live = play.reset(world, reset_key)

    def step(carry, key):
        live, memory, on = carry
        action, memory = acting.act(key, policy, memory, live)
        after = play.step(world, live, action)
        row = EpisodeSteps(live.obs, jnp.clip(action, -1.0, 1.0), on * after.reward, on)
        return (after, memory, on * (1.0 - after.done)), row

    keys = jax.random.split(act_key, play.sim.length)
    (live, _, _), steps = jax.lax.scan(step, (live, acting.start(policy), jnp.ones(())), keys)
    return steps, live


def look(steps: EpisodeSteps, acting: ActingPolicy) -> Rollout:
    """Features of an episode: means, spreads and step changes of each observed channel and action
    in each of four quarters. Added to them is the observation at twelve moments. Most of them are
    early, where a policy has not yet forgotten where it began.
    """
    T = steps.obs.shape[0]
    rows = jnp.concatenate([steps.obs, steps.action], -1)
    part = max(T // WINDOWS, 1)
    count = min(WINDOWS, T)

    def cut(x):
        return x[: part * count].reshape(count, part, *x.shape[1:])

    on = cut(steps.on)[..., None]
    size = jnp.maximum(on.sum(1), 1.0)
    quarters = cut(rows)
    mean = (quarters * on).sum(1) / size
    spread = jnp.sqrt((jnp.square(quarters - mean[:, None]) * on).sum(1) / size + 1e-12)
    change = jnp.abs(jnp.diff(quarters, axis=1) * on[:, 1:]).sum(1) / size
    early = np.unique(np.linspace(1, max(T // 4, 2), EARLY).astype(int))
    late = np.unique(np.linspace(T // 4, T - 1, LATE + 1).astype(int)[1:])
    moments = np.minimum(np.resize(np.concatenate([early, late]), EARLY + LATE), T - 1)
    snaps = steps.obs[moments] * steps.on[moments][:, None]
    score, length = steps.reward.sum(), steps.on.sum()
    flat = [x.reshape(-1) for x in (mean, spread, change, snaps, score / T, length / T)]
    return Rollout(score, acting.luck(steps.obs[0]), length, jnp.concatenate(flat))


def visit(
    key: Array, play: Play, acting: ActingPolicy, policy: Any, values: Array, trials: int
) -> Rollout:
    """`trials` episodes from fresh starts, averaged."""

    def one(k):
        return look(episode(k, play, acting, policy, values)[0], acting)

    if trials == 1:
        return one(key)
    return jax.tree.map(lambda x: x.mean(0), jax.vmap(one)(jax.random.split(key, trials)))


class Shown(NamedTuple):
    """How features become an observation: centre `[K]`, and principal axes `[C, K]` scaled to unit
    variance.
    """

    centre: Array
    axes: Array

    def __call__(self, features: Array) -> Array:
        """`[K] -> [C]`; near enough linear to 1, logarithmic far out."""
        x = self.axes @ jnp.clip(
            jnp.nan_to_num(features - self.centre, posinf=1e6, neginf=-1e6), -1e6, 1e6
        )
        return jnp.sign(x) * jnp.log1p(jnp.abs(x))


def whitened(features: np.ndarray, components: int) -> Shown:
    """Principal axes of `features [N, K]`, each channel to unit variance first, since units
    differ.
    """
    data = features[np.isfinite(features).all(1)].astype(np.float64)
    centre, spread = data.mean(0), data.std(0) + 1e-6
    _, sizes, axes = np.linalg.svd((data - centre) / spread, full_matrices=False)
    deviation = np.maximum(sizes / np.sqrt(len(data)), 1e-6)
    scaled = np.zeros((components, data.shape[1]))
    used = min(components, len(axes))
    scaled[:used] = axes[:used] / deviation[:used, None] / spread
    return Shown(jnp.asarray(centre, jnp.float32), jnp.asarray(scaled, jnp.float32))


# ---------------------------------------------------------------- slopes
#
# d(return)/d(E's mean), through the policy that knows E and the simulator's steps: forward mode,
# for environments without contact.
#
# Over many steps such derivatives grow without bound where the motion is unstable. They are then
# truncated: a window of so many steps counts how an action moves the states after it, and what went
# before the window counts for nothing.

EXPLODES = 10.0  # a return that would change by more than so many times itself over Omega
SHORTEST = 5  # steps of a window


class ReturnSlope(NamedTuple):
    """The mean return `score []` over the starts, its derivative by E's mean `gradient [D]` (unit
    coordinates), and the window [steps] that it was taken over; 0 where none is short enough, and
    the gradient 0.
    """

    score: float
    gradient: np.ndarray
    window: int


def make_slope(play: Play, acting: ActingPolicy, policy_of: Callable) -> Callable:
    """`slope(keys [N], mean [D], values [F], *more) -> ReturnSlope`: over N starts, with the
    longest window whose derivatives do not explode.

    Args:
        play: A simulation, not MuJoCo C. acting, policy_of: Of the task's policies,
            `policy_of(mean, *more) -> policy`.
    """

    def score(mean, key, values, window, *more):
        world, policy = play.world(values), policy_of(mean, *more)
        reset_key, act_key = jax.random.split(key)

        def step(carry, row):
            live, memory, on = carry
            key, number = row

            def held(x):
                return jnp.where(number % window == 0, jax.lax.stop_gradient(x), x)

            live = jax.tree.map(held, live)
            action, memory = acting.act(key, policy, memory, live)
            after = play.step(world, live, action)
            return (after, memory, on * (1.0 - after.done)), on * after.reward

        T = play.sim.length
        rows = (jax.random.split(act_key, T), jnp.arange(T))
        start = (play.reset(world, reset_key), acting.start(policy), jnp.ones(()))
        total = jax.lax.scan(step, start, rows)[1].sum()
        return total, total

    @jax.jit
    def every(keys, *rest):
        def one(key):
            return jax.jacfwd(lambda mean, *more: score(mean, key, *more), has_aux=True)(*rest)

        return jax.vmap(one)(keys)

    def slope(keys: Array, mean: Any, values: Any, *more: Any) -> ReturnSlope:
        window = play.sim.length
        mean, values = (jnp.asarray(x, jnp.float32) for x in (mean, values))
        while True:
            gradients, scores = (np.asarray(x) for x in every(keys, mean, values, window, *more))
            steep = np.abs(gradients).max()  # not a number, where one of them is
            if steep <= EXPLODES * (np.abs(scores).mean() + 1e-6):
                return ReturnSlope(float(scores.mean()), gradients.mean(0), window)
            if window <= SHORTEST:
                return ReturnSlope(float(scores.mean()), np.zeros(gradients.shape[1]), 0)
            window = max(window // 2, SHORTEST)

    return slope
