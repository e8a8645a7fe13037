"""Policies over many steps: the protocol `Trainer`, and PPO in worlds drawn from a box.

One program trains what differs only in numbers. A policy may know E's mean (every world is told to
it). It may be one for all of Omega that is told nothing (UDR). It may be one at a single point
(nominal values, an oracle in its target).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.environments.episodes import ActingPolicy, Live, Play, episode
from adaptsim_jax.learners.ppo import PPO, PPOConfig, PPOHyper, PPOState, Unroll, carried, make_ppo
from adaptsim_jax.space import Space

# ---------------------------------------------------------------- planning
#
# Predictive sampling: no training, the policy is the simulator with E's mean (Howell et al. 2022,
# "Predictive sampling").
#
# At every step the plan so far and noisy copies of it are rolled out in the simulator from where
# the target is. The best is gone on with, and its first action made.


@dataclass(frozen=True)
class PlannerConfig:
    """samples: plans tried at each step. horizon: Steps ahead. knots: Of a plan, between which
    actions are interpolated. noise: Standard deviation of what is added to them.
    """

    samples: int = 16
    horizon: int = 40
    knots: int = 6
    noise: float = 0.5

    def __post_init__(self):
        if min(self.samples, self.horizon, self.knots) < 2 or not self.noise > 0:
            raise BadInput(
                f"planner: {self}: give at least 2 samples, steps and knots, and a noise above 0"
            )


def make_planner(play: Play, space: Space, config: PlannerConfig) -> ActingPolicy:
    """Plans by the whole state of the target, in the world at `policy.mean` (unit coordinates
    `[D]`, other fields nominal).
    """
    A, H, K = play.sim.action_dim, config.horizon, config.knots
    at = jnp.linspace(0.0, K - 1.0, H)
    knots = jnp.arange(K)[None]
    weights = jnp.clip(1.0 - jnp.abs(at[:, None] - knots), 0.0, 1.0)  # [H, K]
    moved = jnp.clip(1.0 - jnp.abs(knots.T + (K - 1.0) / (H - 1.0) - knots), 0.0, 1.0)
    moved = moved / moved.sum(1, keepdims=True)
    rest = jnp.asarray([f.nominal for f in play.fields[space.dim :]], jnp.float32)

    def start(policy):
        return jnp.zeros((K, A))

    def act(key, policy, plan, live: Live):
        world = play.world(jnp.concatenate([space.physical(policy.mean), rest]))
        noise = config.noise * jax.random.normal(key, (config.samples, K, A))
        plans = jnp.clip(plan[None] + noise.at[0].set(0.0), -1.0, 1.0)

        def worth(one):
            def step(carry, action):
                live, on = carry
                live = play.step(world, live, action)
                return (live, on * (1.0 - live.done)), on * live.reward

            return jax.lax.scan(step, (live, jnp.ones(())), weights @ one)[1].sum()

        best = plans[jnp.argmax(jnp.nan_to_num(jax.vmap(worth)(plans), nan=-jnp.inf))]
        return best[0], moved @ best

    return ActingPolicy(start, act)


class Worlds(NamedTuple):
    """Where a trainer's worlds are drawn: unit coordinates between low and high `[D]`; known `[]`:
    1 where the policy is told them, 0 where it is told the middle of Omega. rest `[R]`: Values of
    the fields that are not of Omega, the same for all.
    """

    low: Array
    high: Array
    known: Array
    rest: Array


class Trainer(NamedTuple):
    """How policies are trained, as pure functions that the caller jits; `train` may be vmapped over
    states and worlds.

    * `init(key) -> learned`, a pytree of arrays: all that training leaves, such as weights and the
      optimiser's state
    * `begin(key, learned) -> state`: ready to train from there
    * `train(key, state, worlds, rounds) -> (state, info)`: `rounds`, static, of training on
    * `learned(state) -> learned`; `policy(learned) -> policy`, any pytree
    * `act(policy, obs [O], mean [D]) -> action [A]` in [-1, 1]; mean: E's, -1 to 1 over Omega
    * `value(policy, obs [O], mean [D]) -> []`, more where more is expected from there on, in a unit
      of its own
    * `returns(key, policy, worlds, mix [2], count) -> [count]` of episodes, `count` static: actions
      are `mix[0]` times the policy's and `mix[1]` times random ones. None: it is not evaluated
    """

    init: Callable[[Array], Any]
    begin: Callable[[Array, Any], Any]
    train: Callable[..., tuple[Any, Any]]
    learned: Callable[[Any], Any]
    policy: Callable[[Any], Any]
    act: Callable[[Any, Array, Array], Array]
    value: Callable[[Any, Array, Array], Array]
    returns: Callable[..., Array] | None = None


@dataclass(frozen=True)
class PPOTraining:
    """PPO at work: steps of environments in all, `parallel` of them at once, an update after each
    has made `unroll` steps.

    decay: The learning rate falls to this share of its start. stagger: Episodes end at different
    times, so that an update sees all of them. Else all begin together.
    """

    steps: int = 3_000_000
    parallel: int = 256
    unroll: int = 40
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    epochs: int = 4
    minibatches: int = 8
    decay: float = 0.1
    stagger: bool = True
    hyper: PPOHyper = field(default_factory=PPOHyper)

    def __post_init__(self):
        check_counts(self, ("steps", "parallel", "unroll"), "training.")
        if self.parallel * self.unroll % self.minibatches:
            raise BadInput(
                f"training: {self.parallel} environments of {self.unroll} steps do not divide into "
                f"{self.minibatches} minibatches"
            )

    @property
    def rounds(self) -> int:
        return max(1, self.steps // (self.parallel * self.unroll))


class TrainerState(NamedTuple):
    """The learner, environments `[B]` with the values `[B, F]` and the mean that the policy is given `[B, D]`,
    discounted and plain rewards so far `[B]`, updates so far and in all; rates, which are arguments
    so that one compiled program serves all of them.
    """  # noqa: E501

    ppo: PPOState
    live: Live
    values: Array
    mean: Array
    carried: Array
    gained: Array
    number: Array
    rounds: Array
    hyper: PPOHyper


class Fresh(NamedTuple):
    """Environments `[B]` at the start of an episode, their values `[B, F]`, and the means `[B, D]`
    that their policy is given.
    """

    live: Live
    values: Array
    mean: Array


class TrainerInfo(NamedTuple):
    """Of each update: mean return of the episodes that ended in it (not a number where none did),
    reward of a step, the exploration's standard deviation, KL. lost: `[2]`, shares of steps whose
    reward is no number though the observation is, and whose observation is none. where: `[O]`, the
    observation at the first of the former, if there is one.
    """

    episode: Array
    reward: Array
    spread: Array
    kl: Array
    lost: Array
    where: Array


@dataclass(frozen=True)
class WorldsPPO:
    """PPO in the worlds of `play`, whose first fields are those of `space` (Omega)."""

    play: Play
    space: Space
    config: PPOTraining
    ppo: PPO

    def draw(self, key, worlds: Worlds):
        """Values `[F]` of a world, and the mean `[D]` that the policy is given."""
        u = worlds.low + (worlds.high - worlds.low) * jax.random.uniform(key, (self.space.dim,))
        values = jnp.concatenate([self.space.physical(u), worlds.rest])
        return values, worlds.known * (2.0 * u - 1.0)

    def fresh_one(self, key, worlds):
        """A fresh environment in a fresh world."""
        world_key, reset_key = jax.random.split(key)
        values, mean = self.draw(world_key, worlds)
        return self.play.reset(self.play.world(values), reset_key), values, mean

    def begin(self, key, learned) -> TrainerState:
        """Nothing is simulated yet: the first round puts fresh environments in place of these."""
        B, D = self.config.parallel, self.space.dim
        centre, rest = jnp.full(D, 0.5), jnp.zeros(len(self.play.fields) - D)
        middle = Worlds(centre, centre, jnp.ones(()), rest)
        keys = jax.random.split(key, B)
        blank = jax.eval_shape(jax.vmap(self.fresh_one, (0, None)), keys, middle)
        live, values, mean = jax.tree.map(lambda x: _blank(key, x), blank)
        if self.config.stagger:
            live = live._replace(time=jax.random.randint(key, (B,), 0, self.play.sim.length))
        zero = jnp.zeros(B)
        rates = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), self.config.hyper)
        count = jnp.zeros((), jnp.int32)
        return TrainerState(
            learned, live, values, mean, zero, zero, count, count + self.config.rounds, rates
        )

    def started(self, key, state: TrainerState, worlds: Worlds) -> tuple[TrainerState, Fresh]:
        """The state of a round at its start, and what takes the place of episodes that end."""
        keys = jax.random.split(key, self.config.parallel)
        fresh = Fresh(*jax.vmap(self.fresh_one, (0, None))(keys, worlds))
        first = jnp.broadcast_to(state.number == 0, (self.config.parallel,))
        live = _choose(first, fresh.live, state.live)._replace(time=state.live.time)
        values = jnp.where(first[:, None], fresh.values, state.values)
        mean = jnp.where(first[:, None], fresh.mean, state.mean)
        return state._replace(live=live, values=values, mean=mean), fresh

    def rolled(self, key, state: TrainerState, fresh: Fresh):
        """`unroll` steps of all environments: `(live, gained, over)` at their end, and rows
        `[unroll, B, ...]`.
        """
        world, actor = jax.vmap(self.play.world)(state.values), self.ppo.actor(state.ppo)

        def step(carry, key):
            live, gained, over = carry
            action, log_prob = self.ppo.act(key, actor, live.obs, state.mean)
            after = jax.vmap(self.play.step)(world, live, action)
            reward = jnp.where(jnp.isfinite(after.reward), after.reward, 0.0)
            seen = jnp.isfinite(after.obs).all(-1)
            lost = jnp.stack([seen & ~jnp.isfinite(after.reward), ~seen], -1)
            sound = ~lost.any(-1)
            obs_after = jnp.where(seen[:, None], after.obs, live.obs)
            ended = jnp.maximum(after.done, 1.0 - sound)
            cut = (after.time >= self.play.sim.length) * (1.0 - ended)
            stop = jnp.maximum(ended, cut) > 0
            total = gained + reward
            row = (live.obs, action, log_prob, reward, obs_after, ended, cut, total, stop, lost)
            # for the rest of this batch; then it begins once more, in a fresh world
            live = _choose(stop, fresh.live, after)
            return (live, jnp.where(stop, 0.0, total), over | stop), row

        begun = (state.live, state.gained, jnp.zeros(self.config.parallel, bool))
        return jax.lax.scan(step, begun, jax.random.split(key, self.config.unroll))

    def one_round(self, key, state: TrainerState, worlds: Worlds):
        """Steps of all environments, and an update from them."""
        config = self.config
        fresh_key, act_key, learn_key = jax.random.split(key, 3)
        state, fresh = self.started(fresh_key, state, worlds)
        (live, gained, over), rows = self.rolled(act_key, state, fresh)
        obs, action, log_prob, reward, obs_after, ended, cut, totals, stops, lost = rows
        # what is over begins anew, in another world
        cut = cut.at[-1].set(jnp.maximum(cut[-1], over * (1.0 - ended[-1])))
        extra = jnp.broadcast_to(state.mean, (config.unroll, *state.mean.shape))
        batch = Unroll(obs, extra, action, log_prob, reward, obs_after, ended, cut, state.carried)
        hyper, share = state.hyper, jnp.clip(state.number / state.rounds, 0.0, 1.0)
        rate = hyper.learning_rate * (1.0 - (1.0 - config.decay) * share)
        hyper = replace(hyper, learning_rate=rate)
        learned, info = self.ppo.update(learn_key, state.ppo, batch, hyper)
        _, discounted = carried(batch, hyper.discount)
        over_column = over[:, None]
        state = state._replace(
            ppo=learned,
            live=_choose(over, fresh.live, live),
            values=jnp.where(over_column, fresh.values, state.values),
            mean=jnp.where(over_column, fresh.mean, state.mean),
            carried=jnp.where(over, 0.0, discounted),
            gained=jnp.where(over, 0.0, gained),
            number=state.number + 1,
        )
        ended_return = jnp.sum(totals * stops) / jnp.sum(stops)
        first = jnp.argmax(lost[..., 0].reshape(-1))
        where = obs_after.reshape(-1, obs_after.shape[-1])[first]
        shares = lost.mean((0, 1))
        return state, TrainerInfo(ended_return, reward.mean(), info.spread, info.kl, shares, where)

    def returns(self, key, policy, worlds: Worlds, mix, count: int) -> Array:
        """Returns `[count]` of episodes in worlds of their own, see `Trainer`."""

        def act(key, mean, memory, live):
            noise = jax.random.uniform(key, (self.play.sim.action_dim,), minval=-1.0)
            return mix[0] * self.ppo.deployed(policy, live.obs, mean) + mix[1] * noise, memory

        def one(key):
            world_key, key = jax.random.split(key)
            values, mean = self.draw(world_key, worlds)
            steps, _ = episode(key, self.play, ActingPolicy(lambda p: (), act), mean, values)
            return steps.reward.sum()

        return jax.vmap(one)(jax.random.split(key, count))


def make_ppo_trainer(play: Play, space: Space, config: PPOTraining, obs_dim: int) -> Trainer:
    """PPO in the worlds of `play`, whose first fields are those of `space` (Omega)."""
    sizes = (config.hidden, config.activation, config.epochs, config.minibatches)
    ppo = make_ppo(PPOConfig(obs_dim, play.sim.action_dim, space.dim, *sizes))
    made = WorldsPPO(play, space, config, ppo)

    def train(key, state, worlds, rounds):
        def on(state, _):
            return made.one_round(jax.random.fold_in(key, state.number), state, worlds)

        return jax.lax.scan(on, state, None, rounds)

    functions = (ppo.init, made.begin, train, lambda state: state.ppo, ppo.actor)
    return Trainer(*functions, ppo.deployed, ppo.value, made.returns)


def _blank(key: Array, like: jax.ShapeDtypeStruct) -> Array:
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return jax.random.split(key, like.shape)
    return jnp.zeros(like.shape, like.dtype)


def _choose(on: Array, a: Any, b: Any) -> Any:
    """Of pytrees `[B, ...]`: `a` where `on [B]`, else `b`."""

    def one(x, y):
        return jnp.where(on.reshape(*on.shape, *(1,) * (x.ndim - on.ndim)), x, y)

    return jax.tree.map(one, a, b)
