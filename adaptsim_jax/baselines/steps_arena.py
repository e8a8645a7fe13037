"""Where methods meet targets of many steps: the arena of `arena.py` for tasks whose trial is an
episode of a policy.

A visit's own trials and the episodes that score it are rolled out together. What a method is given
is its own trials alone.
"""

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import Observed, TrialBatch
from adaptsim_jax.environments.episodes import Play, look, make_play
from adaptsim_jax.environments.episodes import episode as one_episode
from adaptsim_jax.environments.policies import Prepared, Tuned, acting_of, network_acting
from adaptsim_jax.environments.setting import Setting, environment
from adaptsim_jax.environments.task import longest_delay, play_in, ready


class One(NamedTuple):
    """What `learned.py` asks of a task: The task itself, episodes of a visit; nothing is mended or
    probed.
    """

    task: Any
    trials: int
    remember: None = None
    probe: None = None


class Rolled(NamedTuple):
    """Of a batch of policies: `obs [B, C]` and return `score [B]` of their own trials, and the mean
    return of the tests `[B]`.
    """

    obs: np.ndarray
    score: np.ndarray
    tests: np.ndarray


class StepsArena:
    """The named targets of an environment's task, with the policy of one seed. `tests`: episodes
    that score a policy.

    own: of each visit the returns of its own trials `[B]`; scored: of each scoring the means over
    the tests `[B]`. programs: What was compiled for the same setting, names and sizes with another
    seed's policy, by name. It serves all of them, because what a seed learned is an argument.
    """

    def __init__(
        self,
        setting: Setting,
        prepared: Prepared,
        names: list[str],
        tests: int,
        seed: int,
        programs: dict[Hashable, Any] | None = None,
    ):
        self._programs = {} if programs is None else programs
        self.setting, self.prepared, self.names = setting, prepared, names
        self.tests, self.seed = tests, seed
        self.one = One(ready(setting, prepared), setting.config.trials)
        self.targets = np.array(
            [setting.targets[name].values[: setting.space.dim] for name in names], np.float32
        )
        self.failed, self.made = np.zeros(len(names), int), np.zeros(len(names), int)
        self.own: list[np.ndarray] = []
        self.scored: list[np.ndarray] = []
        self._train = self.program("train", lambda task, *of: jax.vmap(task.train)(*of))
        self.plays = {
            name: self.shared(("play", name), partial(play_in, setting, setting.targets[name]))
            for name in names
        }
        self._last: tuple[Any, Rolled] | None = None

    @property
    def all_values(self) -> list[np.ndarray]:
        """Of each target `[F]`, fields that Omega lacks included."""
        return [self.setting.targets[name].values for name in self.names]

    @property
    def obs_dim(self) -> int:
        return int(self.setting.trainer.policy(self.prepared.learned).mean.shape[0])

    def whole_play(self) -> Play:
        """The simulator with all fields that any target has as arguments."""
        setting = self.setting
        sim = environment(setting.env, setting.fields, setting.config.length)
        return make_play(sim, setting.fields, longest_delay(setting.fields, *self.all_values))

    def shared(self, name: Hashable, make: Callable[[], Any]) -> Any:
        """What `make` makes, once for all seeds."""
        if name not in self._programs:
            self._programs[name] = make()
        return self._programs[name]

    def program(self, name: Hashable, function: Callable) -> Callable:
        """`function(task, *args)`, compiled once for all seeds."""
        setting = self.setting

        def made():
            return jax.jit(lambda prepared, *args: function(ready(setting, prepared), *args))

        return partial(self.shared(name, made), self.prepared)

    def train(self, keys, dists, policies):
        """Policies `[B, ...]` trained on `dists [B]`."""
        return self._train(keys, dists, policies)

    def untrained(self, keys):
        """Policies `[B, ...]` as the task starts them."""
        return jax.vmap(self.one.task.init_policy)(keys)

    def visit(self, keys, where: np.ndarray, policies) -> Observed:
        """Run each policy in its target `where [B]` for a visit's trials, and observe them."""
        rolled = self._last_rolled(where, policies)
        self.own.append(rolled.score)
        np.add.at(self.made, where, self.one.trials)
        np.add.at(self.failed, where, np.where(np.isfinite(rolled.score), 0, self.one.trials))
        nothing: Any = None  # an episode has no trials of its own to mend by
        return Observed(rolled.obs, rolled.score, TrialBatch(nothing, nothing, nothing))

    def score(self, where: np.ndarray, policies) -> np.ndarray:
        """Mean return `[B]` of the tests, the same starts for every policy."""
        tests = self._last_rolled(where, policies).tests
        self.scored.append(tests)
        return tests

    def _last_rolled(self, where, policies) -> Rolled:
        if self._last is not None and _same(self._last[0], policies):
            return self._last[1]
        parts = {}
        for t in np.unique(where):
            rows = np.flatnonzero(where == t)
            some = jax.tree.map(lambda x, rows=rows: jnp.asarray(x)[rows], policies)
            parts[t] = (rows, self._rolled(self.names[t], some))
        columns = [
            np.zeros((len(where), *np.shape(part)[1:]), np.float32)
            for part in next(iter(parts.values()))[1]
        ]
        for rows, part in parts.values():
            for column, values in zip(columns, part, strict=True):
                column[rows] = values
        rolled = Rolled(*columns)
        self._last = (policies, rolled)
        return rolled

    def _rolled(self, name: str, policies) -> Rolled:
        own = isinstance(policies, Tuned)
        run = self.shared(("run", name, own), lambda: jax.jit(self._runner(name, own)))
        count = len(jax.tree.leaves(policies)[0])
        visits = jax.random.fold_in(jax.random.key(self.seed), len(self.own) + 1)
        keys = jax.random.split(visits, count)
        return Rolled(*map(np.asarray, run(self.prepared, keys, policies)))

    def _runner(self, name: str, own: bool):
        (play, values), setting = self.plays[name], self.setting
        trials, tests = self.one.trials, self.tests
        fixed = jax.random.split(jax.random.key(20_000), tests)

        def run(prepared, keys, policies):
            if own:
                acting = network_acting(setting)
            else:
                acting = acting_of(setting, prepared.learned, prepared.starts)
            task = ready(setting, prepared)

            def one(key, policy):
                every = jnp.concatenate([jax.random.split(key, trials), fixed])
                return jax.vmap(
                    lambda k: look(one_episode(k, play, acting, policy, values)[0], acting)
                )(every)

            found = jax.vmap(one)(keys, policies)
            mean = jax.tree.map(lambda x: x[:, :trials].mean(1), found)
            return (
                jax.vmap(task.observe)(mean),
                jax.vmap(task.score)(mean),
                found.score[:, trials:].mean(1),
            )

        return run


def _same(a: Any, b: Any) -> bool:
    x, y = jax.tree.leaves(a), jax.tree.leaves(b)
    if len(x) != len(y):
        return False
    return all(np.array_equal(p, q) for p, q in zip(x, y, strict=True))
