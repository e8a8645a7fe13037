"""What a task is to all that uses it: a frozen record of pure functions for Phase 1, Phase 2 and
the baselines, and what `adaptsim adapt` and `adaptsim robot` leave to it. What a task may do
without has a default.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.space import Parameter, Space

if TYPE_CHECKING:
    from adaptsim_jax.report.film import Scene

Array = Any
Policy = Any  # a pytree
Trajectory = Any  # a pytree
Reference = Any  # a pytree


class Episode(Protocol):
    """What a task may know of an adaptation trajectory (`adaptation/episode.py`): its visits,
    leading axes as the caller has them.
    """

    @property
    def mean(self) -> Array: ...  # [..., I + 1, D] unit coordinates

    @property
    def policy(self) -> Policy: ...

    @property
    def obs(self) -> Array: ...  # [..., I + 1, D + obs_dim], behind the mean what was observed


class Preparation(NamedTuple):
    """What a task learns once, before Phase 1, such as one policy for all of Omega.

    * `blank(key) -> prepared`: a pytree of arrays with its structure and shapes
    * `make(key, report, kept) -> prepared`: not pure, may take minutes; `report(done, total,
      note)`; kept: A `store.Kept` that holds the work while it lasts, or None
    * `ready(prepared) -> Task`: the task with it
    * digest() -> str: of all that it depends on beside the seed. It may take seconds
    """

    blank: Callable[[Array], Any]
    make: Callable
    ready: Callable[[Any], Task]
    digest: Callable[[], str]


@dataclass(frozen=True)
class Task:
    """A simulation-adaptation contextual bandit (paper, Definition 1) as pure functions.

    All functions work on one sample, are jit- and vmap-able, and consume the keys they are given.
    `params` are raw physical values, ordered as `space.names`.
    """

    name: str
    space: Space  # Omega: the box that simulation parameters stay in
    targets: Space  # where Phase 1 draws its targets from: Omega, or a wider box
    obs_dim: int
    settings: Mapping[
        str, Mapping[str, float]
    ]  # named targets: wd, ood-1 .. ood-4 (paper, table A2)
    init_policy: Callable  # (key) -> policy
    train: Callable  # (key, dist, policy) -> policy
    rollout: Callable  # (key, policy, params [D]) -> trajectory
    observe: Callable  # (trajectory) -> [obs_dim]
    score: Callable  # (trajectory) -> [], the raw return; higher is better; all a real target tells
    reference: Callable  # (params [D]) -> what rewards in this simulated target are scaled with
    reward: Callable  # (trajectory, reference) -> [], at most 1; above 0 where a policy is of use
    # (keys [P], dists [P], policies [P], trials [P]) -> policies [P]: `train` for several at once,
    # each with a budget of its own. None where training is too cheap to be worth sharing; see
    # `adaptation.reuse`.
    train_many: Callable | None = None
    # (key, policy, params [D]) -> trajectory, as `rollout` but cheaper and good enough for Phase 1
    # to learn from; None: `rollout`.
    rehearse: Callable | None = None
    # (key) -> a policy for all of Omega that `train` goes on from better than from `init_policy`;
    # None where there is none
    pretrain: Callable | None = None
    # variance of a visit's return by luck, over that by E's mean: above 0 what is deployed is
    # chosen by smoothed returns
    doubt: float = 0.0
    # E's first mean [D] (unit coordinates) in the first start of an adaptation; None: drawn
    first: Array | None = None
    # what is learned before all else, and is the same for all that Phase 1 and 2 do; None where
    # nothing is
    preparation: Preparation | None = None
    # (a setting's name, or the path of a TOML file) -> the task with rollouts in that target, which
    # has more than parameters of Omega; None: `params` say it all
    world: Callable[[str | Path], Task] | None = None
    # (policy, obs [O]) -> action [A]: of tasks whose policies are called at each step
    act: Callable | None = None
    # (obs [T, O], action [T, A], reward [T]) -> trajectory: of a measured episode of theirs
    read: Callable | None = None


MIN_SPREAD = 0.02
"""Of a target's best return: policies that differ by less are separated by luck alone."""


def scaled_reward(score: Array, bounds: Array) -> Array:
    """The reward `[]`, at most 1, of a return `[]` in a target, `bounds [2]` being the best and the
    mean return there of policies from all of Omega: 1 and 0.
    """
    spread = jnp.maximum(bounds[0] - bounds[1], MIN_SPREAD * jnp.abs(bounds[0]) + 1e-6)
    return jnp.minimum(1.0 - (bounds[0] - score) / spread, 1.0)


@cache
def tables() -> Table:
    """`settings.toml`: of each task its named targets, and boxes of parameters."""
    return tomllib.loads(Path(__file__).with_name("settings.toml").read_text())


def space_of(task: str, box: str, config: Any = None) -> Space:
    """A box of a task's parameters, `omega` or `wide`, with the ranges that `config` has."""
    rows = tables()[task][box]
    parameters = []
    for name, row in rows.items():
        low, high = getattr(config, name, row.get("range"))
        more = {key: value for key, value in row.items() if key != "range"}
        parameters.append(Parameter(name, low, high, **more))
    return Space(tuple(parameters))


COLUMNS = 6  # iterations that a figure shows at most


class AdaptView(NamedTuple):
    """An adaptation in a simulated target, as it is looked at.

    config: The task's options. target: Its name; values `[D]` physical. result: Of Phase 2. start:
    the one whose best visit is deployed. best: That visit. prepared: `(task, config) -> what the
    run learned once`, of tasks with a preparation.
    """

    task: Task
    config: Any
    target: str
    values: Any
    result: Any
    start: int
    best: int
    prepared: Callable[[Task], Any]

    def of_start(self, leaf: Any) -> Any:
        """`leaf [N, I + 1, ...]` of the history, at the start."""
        return np.asarray(leaf)[self.start]

    @property
    def policies(self) -> Any:
        """Of the start's visits `[I + 1]`."""
        return jax.tree.map(lambda x: x[self.start], self.result.history.policy)

    @property
    def params(self) -> Any:
        """Parameters `[I + 1, D]` that the start's visits were trained at, physical."""
        return np.asarray(self.task.space.physical(self.result.history.mean[self.start]))

    def picked(self, count: int) -> tuple[list[int], list[str]]:
        """Which of `count` iterations a figure shows, and their titles."""
        shown = picked(count, self.best)
        return shown, [f"iteration {i}" + (" (best)" if i == self.best else "") for i in shown]

    def trials_reported(self) -> int | None:
        """How many trials the deployed policy is corrected by; None where it is not."""
        reported = getattr(self.result.policy, "told", None)
        if reported is None:
            return None
        return int(np.sum(reported.used))


def picked(count: int, best: int) -> list[int]:
    """The first, the last and evenly between them; the best takes the place of the one nearest to
    it.
    """
    shown = sorted({round(i) for i in np.linspace(0, count - 1, min(COLUMNS, count))})
    if best not in shown:
        last = len(shown) - 1
        shown[min(range(len(shown)), key=lambda k: (abs(shown[k] - best), k in (0, last)))] = best
    return shown


class Look(NamedTuple):
    """What there is to be looked at of policies in a target: a figure, notes for a person, and how
    each trial ended, in words. The clips of a film are made when they are asked for.
    """

    figure: Any
    clips: Callable[[], list[Any]]
    notes: tuple[str, ...] = ()
    ends: tuple[str, ...] = ()


@dataclass(frozen=True)
class AdaptFace:
    """Of `adapt`.

    picture: Name of the figure's file, without suffix. shown: The adaptation. scene: How its
    trials are filmed. before_after: `(config, policies [2], target [D])`, the first and the
    deployed policy. as_compared: Whether Phase 2 makes the visits and corrections of `compare`.
    deployed: `(config, result, target [D]) -> result` with policies and rewards as they are
    deployed.
    """

    picture: str
    shown: Callable[[AdaptView], Look]
    scene: Callable[[], Scene]
    before_after: Callable[[Any, Any, Any], Look] | None = None
    as_compared: Callable[[Any], bool] = lambda config: False
    deployed: Callable[[Any, Any, Any], Any] = lambda config, result, target: result


class SessionTrials(NamedTuple):
    """How trials of a session are read again, to be diagnosed: `head` and `rows(visit)` of the file
    of actions, which of the task's options say how the trials were made, and `assemble(actions,
    files, options, folder, as_declared=, without=) -> recording`.
    """

    head: str
    rows: Callable[[Table], list[tuple]]
    options: tuple[str, ...]
    assemble: Callable


class RobotFace:
    """What `robot` says and reads of a task. `history`: of the turns recorded so far, as `remember`
    made them; `tried`: the state with the policy as the coming turn makes its trials.

    turn: What one ask and tell is called. again: A turn that the robot could not finish is asked
    again. Else its start is given up, since the policy asked of it would fail again. recorded: How
    trials are read again for `diagnose`; None where sessions are not diagnosed.
    """

    turn = "trial"
    again = True
    recorded: SessionTrials | None = None

    def opened(self, session: Any, total: int) -> str:
        """What a new session of so many turns consists of."""
        return f"session of {total} {self.turn}s"

    def policy_file(self, session: Any, policy: Any) -> Table:
        """What policy.toml holds of a policy as it is deployed, beside the parameters."""
        raise NotImplementedError

    def show(self, session: Any, tried: Any, policy: Any, history: list, done: bool) -> None:
        """Say what to do now, or when all is done what the best policy does."""
        raise NotImplementedError

    def read(self, session: Any, tried: Any, path: Any) -> Any:
        """The trajectory that was measured."""
        raise NotImplementedError

    def remember(self, session: Any, tried: Any, trajectory: Any) -> Table:
        """The entry of the history beside the score."""
        return {}

    def comment(self, session: Any, tried: Any, after: Any, trajectory: Any, done: bool) -> None:
        """What is said beside the return."""

    def deployed(self, session: Any, policy: Any, history: list) -> Any:
        """The policy as it is deployed now, mended by what was recorded."""
        return policy

    def tried(self, session: Any, policy: Any, history: list) -> Any:
        """The policy as the coming turn makes its trials with it."""
        return policy


@dataclass(frozen=True)
class TaskKind:
    """A task as the registry holds it (`tasks/registry.py`): how one is made of options, and what
    goes with it.

    config: A frozen dataclass of the task's options, all with defaults. make: `(config) -> Task`;
    BadInput says what an option would lead to. one_shot: `(config) -> OneShot`, of tasks whose
    policies are learned: `adaptsim compare` needs it. train: What `adaptsim train` starts from, a
    table laid over the defaults of `TrainConfig`. of_model: `(model file as a table, its name) ->
    options`, what `adaptsim train --model` lays over the options (`left_out`: effects of the file
    that are none of the simulator's). backends: The engines that it runs in (`tasks/engine.py`),
    and parity: what they agree on. adapt, robot: What the commands of these names show and say
    (`AdaptFace`, `RobotFace`). symbols: What parameters are called in figures, where that is not
    their name.
    """

    config: type
    make: Callable[[Any], Task]
    one_shot: Callable[[Any], Any] | None = None
    train: Mapping[str, Any] = field(default_factory=dict)
    of_model: Callable[[Table, str], Table] | None = None
    adapt: AdaptFace | None = None
    robot: RobotFace | None = None
    symbols: Mapping[str, str] = field(default_factory=dict)
    backends: Any = field(default_factory=dict)
    parity: Any = None
