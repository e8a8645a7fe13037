"""Phase 1 over anyone's simulator and trainer, from the host.

Two functions stand for a program that JAX cannot trace: Gymnasium, Isaac Lab, mjlab, a C++ engine.
Trajectories of Phase 1 take their steps together, so that a simulator is asked for many trials at
once. Task policies are reused between near means of E (paper, appendix A1), each is kept on disk,
and what is learned is compiled as in `phase1`: with the same keys it is the same Phase 1.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import qmc

from adaptsim_jax.adaptation import reuse
from adaptsim_jax.adaptation.asktell import Asked, Session
from adaptsim_jax.adaptation.episode import AdaptationEpisode, Visit, as_seen
from adaptsim_jax.adaptation.phase1 import Phase1, Phase1Config, Phase1State, make_phase1
from adaptsim_jax.adaptation.reuse import ReuseConfig
from adaptsim_jax.adaptation.training import TrainConfig, Trained, metric_rows, traced
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.core.files import atomic_file, one_writer, output_folder
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.core.store import CONFIG, RunFolder
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Task, scaled_reward

TASK = "host"
FAR = 10.0  # standard deviations that an observation is held within
HOST_CONFIG = TrainConfig(
    every=1,
    phase1=Phase1Config(
        trajectories=400,
        parallel=20,
        capacity=4000,
        archive=4000,
        reuse=ReuseConfig(threshold=0.25),
    ),
)
"""What `train_host` starts from: fewer trajectories than where they are compiled."""

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class HostSimulation:
    """A simulator and a trainer as Phase 1 calls them.

    Args:
        space: Omega, `D` parameters that the simulator may be given.
        train: `(ranges) -> policy`. ranges: `{name: (low, high)}` in each parameter's unit, E's
            mean and `spread` of Omega's range to either side. policy: `{name: array}`, such as a
            network's weights; it is kept on disk as NPZ and never asked for twice.
        returns: `(policy, parameters [B, D], seed) -> (returns [B], observations [B, O])`: one
            trial of the policy in each of the simulators with these parameters (ordered as
            `space.names`); more is better. observations: what a real trial shows, too, in any
            units. With one seed trials shall begin alike, so that luck with a start is no merit.
        targets: Where targets are drawn from, a box around Omega; None: Omega.
        spread: See `train`.
        references: Policies trained at means spread over Omega before all else. In a target the
            best of them earns the reward 1, their mean 0.
        doubt: Variance of a return by luck, over that by E's mean; above 0 what is deployed is
            chosen by smoothed returns.
    """

    space: Space
    train: Callable[[dict[str, tuple[float, float]]], Arrays]
    returns: Callable[[Arrays, np.ndarray, int], tuple[Any, Any]]
    targets: Space | None = None
    spread: float = 0.05
    references: int = 8
    doubt: float = 0.0


class HostTrained(NamedTuple):
    """A run of `train_host`. trained: As `Session` takes it. theirs: The two functions, with the
    policies so far. share: Of the time of Phase 1 that went into them, by name.
    """

    trained: Trained
    theirs: "Theirs"
    share: dict[str, float]


class HostSession(Session):
    """`Session` of a run of `train_host`: `ask().policy` is what `train` returned for E's mean,
    and `tell(score, observation)` takes an observation as `returns` gives it.
    """

    def __init__(self, run: HostTrained, *, starts: int = 2, iterations: int = 10, seed: int = 0):
        self.theirs = run.theirs
        super().__init__(run.trained, starts=starts, iterations=iterations, seed=seed)

    def tell(self, score: float, observation: Any) -> bool:
        """What the trial came to; whether it is the best so far."""
        return super().tell(score, self.theirs.scaled(np.asarray(observation, np.float32)))

    def _asked(self, mean: Array, policy: Any) -> Asked:
        return super()._asked(mean, policy)._replace(policy=self.theirs.policy(policy))


def train_host(
    simulation: HostSimulation,
    run: str | Path,
    config: TrainConfig = HOST_CONFIG,
    progress: Report = silent,
) -> HostTrained:
    """Phase 1 of a simulator and a trainer that JAX knows nothing of (paper, Algorithm 1).

    Args:
        run: Its folder. A run that was stopped goes on from its last round, a finished one is read;
            policies that were trained lie in `policies/`, one NPZ each.
        config: Seed, sizes and rates. `phase1.reuse.threshold` D is the distance, in shares of
            Omega's ranges, within which means of E share a policy: it says how many are trained.
            `every`: rounds between checkpoints.
        progress: `(done, total, note)`, the note says what share of the time is the user's.

    Returns:
        What a `HostSession` adapts with. The share of the time that went into `train` and `returns`
        is printed and in `metrics.jsonl`, too.

    Raises:
        BadInput: Where the functions return something else, or the run was started otherwise.
    """
    folder = _folder(simulation, Path(run), config)
    with one_writer(folder.path):
        theirs = Theirs(simulation, output_folder(folder.path / "policies"))
        phase1 = make_phase1(_task(simulation, theirs.obs_dim), _sizes(config.phase1))
        return _trained(phase1, theirs, folder, config, progress)


def _trained(phase1, theirs, folder, config, progress) -> HostTrained:
    hyper, total = traced(config.hyper), phase1.config.rounds
    programs = _Programs.of(phase1)
    first = jax.jit(phase1.init)(jax.random.key(config.seed))
    state, done = folder.restore(first._replace(pool=_first_pool(phase1, theirs)))
    while done < total:
        state, info = _round(programs, theirs, state, hyper, done)
        (row,) = metric_rows(phase1, jax.tree.map(lambda x: x[None], info), done)
        folder.append_metrics([row | theirs.lap()])
        done += 1
        if done % config.every == 0 or done == total:
            folder.save(state, done)
        progress(done, total, f"reward {row['final_reward']:.2f}, {_said(_shares(folder))}")
    share = _shares(folder)
    print(f"{folder.path}: {_said(share)}")
    return HostTrained(Trained(phase1, hyper, state, done), theirs, share)


def _shares(folder: RunFolder) -> dict[str, float]:
    """Of the time of all rounds so far."""
    rows = folder.read_metrics()
    whole = sum(row["seconds"] for row in rows)
    return {name: sum(row[name] for row in rows) / whole for name in ("train", "returns")}


def _said(share: dict[str, float]) -> str:
    parts = ", ".join(f"{name} {100 * part:.0f} %" for name, part in share.items())
    return f"{100 * sum(share.values()):.0f} % of the time in your functions ({parts})"


# ---------------------------------------------------------------- the user's functions


class Theirs:
    """The two functions of a simulation, checked and timed.

    folder: Where policies are kept, one NPZ for each mean of E, and `shown.npz`, what observations
    are scaled by.
    """

    def __init__(self, simulation: HostSimulation, folder: Path):
        self.simulation, self.folder = simulation, folder
        self._seconds, self._since = {"train": 0.0, "returns": 0.0}, time.monotonic()
        self._held: dict[str, Arrays] = {}
        sobol = qmc.Sobol(simulation.space.dim, rng=1)
        self.references = sobol.random(simulation.references).astype(np.float32)  # [R, D]
        self._shown = self._kept("shown", self._look)

    @property
    def obs_dim(self) -> int:
        """Of an observation."""
        return len(self._shown["mean"])

    def scaled(self, obs: np.ndarray) -> np.ndarray:
        """`obs [..., O]` in its spread over policies and simulators of Omega."""
        mean, spread = self._shown["mean"], self._shown["spread"]
        return np.clip(np.nan_to_num((obs - mean) / spread), -FAR, FAR)

    def policy(self, mean: Any) -> Arrays:
        """What was trained for E at `mean [D]` (unit coordinates); now, where it was not yet."""
        mean = np.asarray(mean, np.float32)
        return self._kept(hashlib.sha256(mean.tobytes()).hexdigest()[:20], partial(self._new, mean))

    def returns(
        self, means: Any, parameters: np.ndarray, seed: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns `[B]` and observations `[B, O]` of the policies trained at `means [B, D]`, each
        in its own simulator, of `parameters [B, D]`. One call for those that share a policy.
        """
        different, which = np.unique(np.asarray(means), axis=0, return_inverse=True)
        rows = [np.flatnonzero(which.reshape(-1) == i) for i in range(len(different))]
        pairs = zip(different, rows, strict=True)
        found = [self._tried(self.policy(mean), parameters[row], seed) for mean, row in pairs]
        order = np.argsort(np.concatenate(rows))
        score, obs = (np.concatenate(part)[order] for part in zip(*found, strict=True))
        return score, obs

    def _tried(self, policy: Arrays, parameters: np.ndarray, seed: int):
        with self._timed("returns"):
            score, obs = self.simulation.returns(policy, parameters, seed)
        score, obs = np.asarray(score, np.float32), np.asarray(obs, np.float32)
        B = len(parameters)
        if score.shape != (B,) or obs.ndim != 2 or len(obs) != B:
            raise BadInput(
                f"returns: gave shapes {score.shape} and {obs.shape} for {B} simulators; return "
                f"({B},) returns and ({B}, O) observations"
            )
        return score, obs

    def _new(self, mean: np.ndarray) -> Arrays:
        space, spread = self.simulation.space, self.simulation.spread
        low, high = (space.physical(np.clip(mean + way * spread, 0.0, 1.0)) for way in (-1, 1))
        ranges = zip(map(float, low), map(float, high), strict=True)
        with self._timed("train"):
            policy = self.simulation.train(dict(zip(space.names, ranges, strict=True)))
        if not isinstance(policy, Mapping) or not policy:
            raise BadInput(
                f"train: returned {type(policy).__name__}; return a policy as {{name: array}}"
            )
        return {name: np.asarray(value) for name, value in policy.items()}

    def _look(self) -> Arrays:
        """Mean and spread of observations, of the references in as many simulators each."""
        space, count = self.simulation.space, len(self.references)
        rng = np.random.default_rng(0)
        u = rng.uniform(size=(4 * count * count, space.dim)).astype(np.float32)
        means = np.repeat(self.references, 4 * count, 0)
        obs = self.returns(means, np.asarray(space.physical(u)), 0)[1]
        if not np.isfinite(obs).all():
            raise BadInput(
                "returns: observations are not finite within Omega; give a failed trial's last "
                "sound values, or narrow the ranges"
            )
        spread, rounding = obs.std(0), 1e-5 * np.abs(obs).max(0)
        return {"mean": obs.mean(0), "spread": np.where(spread > rounding, spread, np.inf)}

    def _kept(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Arrays called `name`: from memory, the disk, or made and written."""
        path = self.folder / f"{name}.npz"
        if name not in self._held:
            if not path.exists():
                made = make()
                with atomic_file(path) as file:
                    np.savez(file, **made)
            with np.load(path, allow_pickle=False) as file:
                self._held[name] = dict(file)
        return self._held[name]

    def lap(self) -> dict[str, float]:
        """Seconds since the last lap, in each of the functions and in all."""
        lap = self._seconds | {"seconds": time.monotonic() - self._since}
        self._seconds, self._since = dict.fromkeys(self._seconds, 0.0), time.monotonic()
        return lap

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        begun = time.monotonic()
        yield
        self._seconds[name] += time.monotonic() - begun


# ---------------------------------------------------------------- a round


class _Programs(NamedTuple):
    """What of a round is compiled."""

    phase1: Phase1
    begin: Callable
    lend: Callable
    settle: Callable
    move: Callable
    learn: Callable

    @classmethod
    def of(cls, phase1: Phase1) -> "_Programs":
        config, space = phase1.config.reuse, phase1.task.space

        def move(state, hyper, round_number, begun, dists, obs, number):
            act, plan, _ = phase1.exploring(state, hyper, round_number)
            keys = reuse.visit_keys(begun, number)[:, 2]
            see = jax.vmap(as_seen, (0, 0, 0, None))
            seen = see(keys, dists.mean, obs, plan.noise)
            return seen, *reuse.move(begun, space, act, plan, dists, seen, number)

        def learn(key, state, hyper, number, episodes, reused):
            epsilon = phase1.exploring(state, hyper, number)[2]
            return phase1.learn(key, state, hyper, number, episodes, epsilon, reused)

        def settle(pool, means, loan):
            return reuse.settle(pool, config, means, loan.policy, loan)

        return cls(
            phase1,
            jax.jit(phase1.begin),
            jax.jit(lambda pool, means: reuse.lend(pool, config, means, means)),
            jax.jit(settle),
            jax.jit(move),
            jax.jit(learn),
        )


def _round(programs: _Programs, theirs: Theirs, state: Phase1State, hyper: Any, number: int):
    """`parallel` exploring trajectories, and what is learned from them: `(state, info)`."""
    act_key, learn_key = jax.random.split(jax.random.fold_in(state.key, number))
    seed = int(jax.random.randint(jax.random.fold_in(act_key, 0), (), 0, 2**31 - 1))
    begun = programs.begin(act_key, hyper)
    targets = np.asarray(begun.targets)
    scores = [
        theirs.returns(np.tile(m, (len(targets), 1)), targets, seed)[0] for m in theirs.references
    ]
    bounds = jnp.stack([jnp.nanmax(jnp.stack(scores), 0), jnp.nanmean(jnp.stack(scores), 0)], -1)
    dists, pool, visits, actions, budgets = begun.dists, state.pool, [], [], []
    for i in range(programs.phase1.config.horizon + 1):
        loan = programs.lend(pool, dists.mean)
        score, obs = theirs.returns(loan.policy, targets, seed)
        pool = programs.settle(pool, dists.mean, loan)
        seen, action, after = programs.move(
            state, hyper, number, begun, dists, theirs.scaled(obs), i
        )
        reward = jax.vmap(scaled_reward)(jnp.asarray(score), bounds)
        visits.append(Visit(dists.mean, loan.policy, seen, jnp.asarray(score), reward))
        actions.append(action)
        budgets.append(loan.budget)
        dists = after
    episodes = AdaptationEpisode(
        *jax.tree.map(lambda *x: jnp.stack(x, 1), *visits), action=jnp.stack(actions[:-1], 1)
    )
    new = jnp.stack(budgets).astype(jnp.float32).mean()
    state = state._replace(pool=pool)
    return programs.learn(learn_key, state, hyper, number, episodes, (new, 1.0 - new))


def _first_pool(phase1: Phase1, theirs: Theirs) -> reuse.Pool:
    """The references are the first anchors."""
    means, config = jnp.asarray(theirs.references), phase1.config.reuse
    pool = reuse.empty_pool(config, means.shape[1], means[0])
    own = jnp.full(len(means), -1), jnp.ones(len(means), jnp.int32)
    return reuse.settle(pool, config, means, means, reuse.Loan(means, *own))


# ---------------------------------------------------------------- what a run is


def _sizes(config: Phase1Config) -> Phase1Config:
    """Each policy is trained once, and lent as it is."""
    once = replace(config.reuse, first=1, most=1, least=1, together=1)
    return replace(config, reuse=once)


def _task(simulation: HostSimulation, obs_dim: int) -> Task:
    """The task of what runs on the host: its policies are means of E, its trajectories what was
    told.
    """
    space = simulation.space

    def there(*_):
        raise BadInput("a host's simulation is run by `train_host`, not in compiled programs")

    return Task(
        name=TASK,
        space=space,
        targets=simulation.targets or space,
        obs_dim=obs_dim,
        settings={},
        init_policy=lambda key: jnp.full(space.dim, 0.5),
        train=lambda key, dist, policy: dist.mean,
        train_many=lambda keys, dists, policies, trials: dists.mean,
        rollout=there,
        observe=lambda told: told[1],
        score=lambda told: told[0],
        reference=there,
        reward=there,
        doubt=simulation.doubt,
    )


def _folder(simulation: HostSimulation, path: Path, config: TrainConfig) -> RunFolder:
    """The run, new or to go on with. BadInput where sizes make no sense or it was started
    otherwise.
    """
    check_counts(simulation, ("references",), "HostSimulation: ", ";")
    if not config.phase1.reuse.threshold > 0:
        raise BadInput(
            "phase1.reuse.threshold = 0: each visit would train a policy; give a distance in "
            "shares of Omega's ranges, such as 0.25"
        )
    if simulation.references > config.phase1.reuse.capacity:
        raise BadInput(
            f"HostSimulation: {simulation.references} references, and phase1.reuse.capacity is "
            f"{config.phase1.reuse.capacity}; give fewer"
        )
    boxes = {"omega": simulation.space, "targets": simulation.targets or simulation.space}
    named = {box: [configs.to_table(p) for p in s.parameters] for box, s in boxes.items()}
    numbers = {name: getattr(simulation, name) for name in ("spread", "references", "doubt")}
    table = configs.to_table(replace(config, task=named | numbers))
    start = RunFolder.resume if (path / CONFIG).exists() else RunFolder.create
    return start(path, table, task=TASK)
