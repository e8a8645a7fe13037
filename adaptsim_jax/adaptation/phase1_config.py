"""What a run of Phase 1 is given: sizes, which are static under jit, and what a sweep may vary."""

from dataclasses import dataclass, field

import jax

from adaptsim_jax.adaptation import reuse
from adaptsim_jax.adaptation.reuse import ReuseConfig
from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.learners import replay as ring
from adaptsim_jax.learners.bdq import BDQHyper
from adaptsim_jax.tasks.base import Task


@dataclass(frozen=True)
class Phase1Config:
    """Sizes, static under jit.

    trajectories: How many adaptation trajectories in all, K / horizon. parallel: How many at once.
    horizon: Adaptation steps of each. updates: Gradient steps after each round. batch: Transitions
    in each. capacity: Of the replay, in transitions. archive: Size of S_E, distributions. warmup:
    Rounds before the first update. reuse: Of task policies, for tasks whose training is dear.
    guided: Share of trajectories that are led towards their target.
    """

    trajectories: int = 20_000
    parallel: int = 100
    horizon: int = 10
    updates: int = 480
    batch: int = 64
    capacity: int = 200_000
    archive: int = 20_000
    warmup: int = 1
    hidden: tuple[int, ...] = (128, 128)
    activation: str = "elu"
    layer_norm: bool = False
    reuse: ReuseConfig = field(default_factory=ReuseConfig)
    guided: float = 0.0

    @property
    def rounds(self) -> int:
        return self.trajectories // self.parallel


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Phase1Hyper:
    """What one sweep may vary: each leaf a scalar, or `[S]` under vmap.

    delta: Adaptation step, a fraction of the range. Step i is `delta shrink^i`. threshold: The
    sparse reward's. Rewards below it count as 0.
    gain: Rewards `r` become `1 - gain (1 - r)` first, which sharpens them near the optimum. soft:
    Where 1, a curve instead of the line, informative however bad the policy is: `1 / (1 + gain (1 -
    r))`, and for a share `far` of it a logarithm, which still tells bad from worse where the
    hyperbola is flat. epsilon falls linearly from `epsilon_start` to `epsilon_end` over the first
    `epsilon_share` of the rounds. rate_end: Over the last half
    the learning rate falls linearly to this share of its start. obs_noise: Standard deviation of
    noise on the observation, in training only.
    independent: 1 lets each branch explore by itself. inside: For each parameter of a target, the
    probability of being drawn from Omega and not from the task's wider box of targets. terminal: 1
    ends the return at the horizon, as the paper's equation 2 does; 0 bootstraps through it.
    """

    learner: BDQHyper = field(default_factory=BDQHyper)
    delta: float = 0.1
    shrink: float = 1.0
    threshold: float = -1e9
    gain: float = 10.0
    soft: float = 1.0
    far: float = 0.25
    epsilon_start: float = 1.0
    epsilon_end: float = 0.1
    epsilon_share: float = 0.5
    rate_end: float = 0.02
    obs_noise: float = 0.0
    independent: float = 1.0
    inside: float = 0.5
    terminal: float = 0.0


SIZES = ("trajectories", "parallel", "horizon", "updates", "batch", "capacity", "archive")
POSITIVE = (
    "delta",
    "shrink",
    "gain",
    "epsilon_share",
    "learner.learning_rate",
    "learner.tau",
    "learner.max_grad_norm",
)
SHARES = (
    "delta",
    "soft",
    "far",
    "epsilon_start",
    "epsilon_end",
    "epsilon_share",
    "rate_end",
    "independent",
    "inside",
    "terminal",
    "learner.discount",
    "learner.tau",
)


def check(config: Phase1Config, task: Task) -> None:
    """Raises BadInput where the sizes do not fit each other or the task."""
    check_counts(config, SIZES, "phase1.")
    if config.warmup < 0:
        raise BadInput(f"phase1.warmup = {config.warmup}: give a number of rounds, 0 for none")
    if config.reuse.threshold > 0 and task.train_many is None:
        raise BadInput(
            f"task '{task.name}' trains each policy anew at no cost; set phase1.reuse.threshold to "
            "0"
        )
    if config.trajectories % config.parallel:
        raise BadInput(
            f"{config.trajectories} trajectories do not divide into rounds of {config.parallel}; "
            f"use {config.parallel * max(1, round(config.trajectories / config.parallel))}"
        )
    if not 0.0 <= config.guided <= 1.0:
        raise BadInput(f"phase1.guided = {config.guided} is a share of trajectories; give 0 to 1")
    ring.check_capacity(config.capacity, config.parallel * config.horizon)
    ring.check_capacity(config.archive, config.parallel * config.horizon)
    if config.reuse.threshold > 0:
        reuse.check(config.reuse, config.parallel)


def check_hyper(hyper: Phase1Hyper) -> None:
    """Raises BadInput where a value makes no sense. Values must be concrete: not traced, and no
    sweep of several.
    """
    for key in (*POSITIVE, *SHARES, "obs_noise"):
        holder = hyper.learner if key.startswith("learner.") else hyper
        value = getattr(holder, key.removeprefix("learner."))
        if key in POSITIVE and not value > 0:
            raise BadInput(f"hyper.{key} = {value}: give a positive number")
        if key in SHARES and not value <= 1:
            raise BadInput(f"hyper.{key} = {value}: give at most 1")
        if not value >= 0:
            raise BadInput(f"hyper.{key} = {value}: give at least 0")
