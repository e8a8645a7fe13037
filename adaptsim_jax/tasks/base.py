"""What Phase 1, Phase 2 and the baselines know of a task: a frozen record of pure functions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from adaptsim_jax.space import Gaussian, Space

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
    * `make(key, report) -> prepared`: not pure, may take minutes; `report(done, total, note)`
    * `ready(prepared) -> Task`: the task with it
    * digest() -> str: of all that it depends on beside the seed. It may take seconds
    """

    blank: Callable[[Array], Any]
    make: Callable[..., Any]
    ready: Callable[[Any], "Task"]
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
    init_policy: Callable[[Array], Policy]  # (key) -> policy
    train: Callable[[Array, Gaussian, Policy], Policy]  # (key, dist, policy) -> policy
    rollout: Callable[[Array, Policy, Array], Trajectory]  # (key, policy, params [D]) -> trajectory
    observe: Callable[[Trajectory], Array]  # trajectory -> [obs_dim]
    score: Callable[
        [Trajectory], Array
    ]  # -> [], the raw return; higher is better; all that a real target can tell
    reference: Callable[
        [Array], Reference
    ]  # (params [D]) -> what rewards in this simulated target are scaled with
    reward: Callable[
        [Trajectory, Reference], Array
    ]  # -> [], at most 1; in [0, 1] where the policy is of any use
    # (keys [P], dists [P], policies [P], trials [P]) -> policies [P]: `train` for several at once,
    # each with a budget of its own. None where training is too cheap to be worth sharing; see
    # `adaptation.reuse`.
    train_many: Callable[[Array, Gaussian, Policy, Array], Policy] | None = None
    # (key, policy, params [D]) -> trajectory, as `rollout` but cheaper and good enough for Phase 1
    # to learn from; None: `rollout`.
    rehearse: Callable[[Array, Policy, Array], Trajectory] | None = None
    # (key) -> a policy for all of Omega that `train` goes on from better than from `init_policy`;
    # None where there is none
    pretrain: Callable[[Array], Policy] | None = None
    # variance of a visit's return by luck, over that by E's mean: above 0 what is deployed is
    # chosen by smoothed returns
    doubt: float = 0.0
    # what is learned before all else, and is the same for all that Phase 1 and 2 do; None where
    # nothing is
    preparation: Preparation | None = None
    # (a setting's name) -> the task with rollouts in that target, which has more than parameters of
    # Omega; None: `params` say it all
    world: Callable[[str], "Task"] | None = None
    # (policy, obs [O]) -> action [A]: of tasks whose policies are called at each step
    act: Callable[[Policy, Array], Array] | None = None
    # (obs [T, O], action [T, A], reward [T]) -> trajectory: of a measured episode of theirs
    read: Callable[[Any, Any, Any], Trajectory] | None = None


@dataclass(frozen=True)
class TaskKind:
    """A task as the registry holds it (`tasks/registry.py`): how one is made of options, and what
    goes with it.

    config: a frozen dataclass of the task's options, all with defaults. make: `(config) -> Task`;
    BadInput says what an option would lead to. one_shot: `(config) -> OneShot`, of tasks whose
    policies are learned: `adaptsim compare` needs it. train: what `adaptsim train` starts from, a
    table laid over the defaults of `TrainConfig`. augmented: `(options, where) -> Task` on the
    model file that stands under the option `model`. of_model: `(model file as a table, its name) ->
    options`, what `adaptsim train --model` lays over the options (`left_out`: effects of the file
    that are none of the simulator's). backends: the engines that it runs in (`tasks/engine.py`),
    and parity: what they agree on. adapt, robot: what the commands of these names show and say
    (`tasks/faces.py`). symbols: what parameters are called in figures, where that is not their
    name.
    """

    config: type
    make: Callable[[Any], Task]
    one_shot: Callable[[Any], Any] | None = None
    train: Mapping[str, Any] = field(default_factory=dict)
    augmented: Callable[[dict[str, Any], str], Task] | None = None
    of_model: Callable[[dict[str, Any], str], dict[str, Any]] | None = None
    adapt: Any = None
    robot: Any = None
    symbols: Mapping[str, str] = field(default_factory=dict)
    backends: Any = field(default_factory=dict)
    parity: Any = None
