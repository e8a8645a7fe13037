"""What a comparison runs, and what that of each task starts from."""

from dataclasses import dataclass, field, replace

from adaptsim_jax.adaptation.training import TrainConfig, default_config
from adaptsim_jax.baselines import mdn
from adaptsim_jax.baselines.bayesopt import BayesOptConfig
from adaptsim_jax.baselines.direct import DirectConfig
from adaptsim_jax.baselines.registry import exact_methods, learned_methods, steps_methods
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import check_counts


@dataclass(frozen=True)
class StepsConfig:
    """Budgets of the methods for policies over many steps.

    tests: Episodes that score a policy. together, epochs, rate: Of fine-tuning in the target,
    episodes of an update, epochs over them, and the learning rate. points: Of the search for the
    best in Omega. share: Of the training's rounds that an oracle goes on for. sigma: Of CMA-ES at
    its start, as a share of each range.
    """

    tests: int = 8
    together: int = 2
    epochs: int = 8
    rate: float = 3e-4
    points: int = 64
    share: float = 0.5
    sigma: float = 0.25

    def __post_init__(self):
        check_counts(self, ("tests", "together", "epochs", "points"), "compare: steps.", ";")


@dataclass(frozen=True)
class CompareConfig:
    """What `adaptsim compare` runs. `methods`, `settings`: empty means all.

    starts: N, distributions that AdaptSim and the gradient adapt at once. iterations: Of every
    method, after the first visit; train: Phase 1 of AdaptSim. sysid: Budgets of the SysID rows (its
    `iterations` are replaced).
    For tasks whose policies are learned: target: The engine that targets run in (empty: the task's
    own simulator), with target_options of its own. direct: Budgets of UDR+Target and LearnInTarget.
    bayesopt: Of BayesOpt. steps: Where a trial is an episode of many steps. options: What baselines
    of other packages are given.
    """

    methods: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    seeds: int = 20
    seed: int = 0
    iterations: int = 10
    starts: int = 2
    train: TrainConfig = field(default_factory=TrainConfig)
    sysid: SysIdConfig = field(default_factory=SysIdConfig)
    target: str = ""
    target_options: Table = field(default_factory=dict)
    direct: DirectConfig = field(default_factory=DirectConfig)
    bayesopt: BayesOptConfig = field(default_factory=BayesOptConfig)
    steps: StepsConfig = field(default_factory=StepsConfig)
    options: Table = field(default_factory=dict)

    def __post_init__(self):
        check_counts(self, ("seeds", "iterations", "starts"), "compare: ", ";")
        for method in self.methods:
            configs.pick(
                "method",
                method,
                dict.fromkeys((*exact_methods(), *learned_methods(), *steps_methods())),
            )


def default_comparison(task: str) -> CompareConfig:
    """What `adaptsim compare TASK` starts from: as many iterations as the task's adaptation
    trajectories have, and for AdaptSim's row what `adaptsim train` would take. What is deployed in
    the push and in scooping is corrected by the target's own trials, of SysID and BayesOpt
    likewise.
    """
    train = default_config(task)
    plain = CompareConfig(train=train, iterations=train.phase1.horizon)
    if task == "environment":
        return replace(plain, seeds=3, sysid=STEPS_SYSID, bayesopt=BayesOptConfig(initial=6))
    if task == "pendulum":
        return plain
    return replace(plain, seeds=10, sysid=LEARNED_SYSID)


# SysID where policies are learned: half the simulations and fits of the pendulum's, for a visit
# there costs a training
LEARNED_SYSID = SysIdConfig(
    simulations=1000,
    first_fit=mdn.FitConfig(updates=1000),
    next_fit=mdn.FitConfig(updates=300, rate=1e-3),
)
# and where a simulated trajectory is an episode, fewer of them
STEPS_SYSID = replace(LEARNED_SYSID, simulations=300, hidden=(64, 64))
