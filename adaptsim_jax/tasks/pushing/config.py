"""The push: its options, the parameters that are adapted, its settings, and what policies and
trajectories are made of.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from jax import Array

from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.learners.naf import NAF, NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.learners.naf_shared import SharedConfig
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import space_of, tables
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.corrections import PushRecord
from adaptsim_jax.tasks.pushing.model import PARAMETERS, PushOptions
from adaptsim_jax.tasks.pushing.planar import check_options as check_planar
from adaptsim_jax.tasks.pushing.slide import Lacking

SETTINGS = tables()["pushing"]["settings"]


@dataclass(frozen=True)
class PushingConfig:
    """Options of the task.

    observation: Six points of each trajectory, or the `final` position alone (the paper's
    state-only variant). show_goal: Observe also the goal of each push, without which a miss cannot
    be told from a far goal. show_gap: Observe also how far the points lie from those of the same
    pushes simulated at the mean of E (`pretrain` only). trajectories: Pushes an iteration; tests:
    goals that the reward of a simulated target is averaged over. goals: Of an iteration's pushes:
    drawn anew; `spread`, drawn one in each equal part of the sector's angle and far out; or
    `fixed`, always the same, so that what is seen differs by parameters alone, or `edges`, likewise
    but near the sector's edges. targets: Phase 1 draws targets from Omega (the paper), or from a
    box around it (`wide`).
    trials: M, simulated pushes that `train` trains a policy with; training: how; hidden,
    learning_rate: Of the NAF. pretrain: Go on from one policy for all of Omega (`naf_shared`)
    instead of from nothing. It is made first, by `shared` with `learning_rate`; `train` then moves
    it to the mean of E and, unless `tune` is false, tunes it by `tuning` with `tuning_rate`.
    refine: Pushes simulated at the mean of E that each action is corrected by before it is made
    (`refine`), with `pretrain` only; 0: actions are the network's own. correct: What is deployed is
    searched for in the simulator as mended by the pushes made in the target so far, near E's mean
    and over the actions (`corrections`). A visit's own pushes are not, nor is anything in Phase 1.
    visits: An iteration's pushes are E's own for `goals`, or `deployed`, those that would be
    deployed then for goals drawn over the whole sector. The adaptation policy is shown as their
    goals where E's mean expects them (`compare` and `robot`; Phase 1 knows only the former).
    rehearsal: Tests and refine that Phase 1 makes do with, where not 0. simulator: Where policies
    are trained, refined and corrected: the planar model, or the MuJoCo scene itself in processes
    of its own (`engines.served`), at a hundredth of the speed. With `mjx` it is that scene in MJX,
    in the compiled program and all samples at once. That is for GPUs: on a CPU it has a quarter of
    the speed of `native`. coefficients: The planar model as a twin of that scene or of Drake's.
    friction, duration: Of the model, see `tasks.pushing.model.PushOptions`. mu, e, mu_p, y_p:
    Omega. mended: What measured pushes showed that the planar model lacks. It is then a slide in
    two dimensions (`slide`, in steps of 2.5 ms). fitted: mu, e Pa, mu_p, y_p m as fitted to them,
    the setting `fitted`. Both of a model.toml of `adaptsim diagnose`.
    """

    observation: Literal["points", "final"] = "points"
    show_goal: bool = True
    show_gap: bool = False
    trajectories: int = 2
    tests: int = 24
    goals: Literal["drawn", "spread", "fixed", "edges"] = "drawn"
    targets: Literal["omega", "wide"] = "wide"
    trials: int = 10_000
    training: GoalConfig = field(
        default_factory=lambda: GoalConfig(
            updates=40, batch=32, candidates=16, temperature=0.03, width=(0.5, 0.05)
        )
    )
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 3e-3
    pretrain: bool = False
    shared: SharedConfig = field(default_factory=SharedConfig)
    tuning: GoalConfig = field(
        default_factory=lambda: GoalConfig(
            updates=40,
            batch=32,
            temperature=0.015,
            width=(0.15, 0.03),
            near=1.0,
            uniform=0.25,
            noise=0.05,
        )
    )
    tuning_rate: float = 1e-3
    tune: bool = True
    refine: int = 0
    correct: bool = False
    visits: Literal["own", "deployed"] = "own"
    rehearsal: tuple[int, int] = (0, 0)
    simulator: Literal["planar", "native", "mjx"] = "planar"
    coefficients: Literal["native", "drake"] = "native"
    friction: Literal["clean", "coupled"] = "clean"
    duration: float = 1.3
    mu: tuple[float, float] = (model.LOW[0], model.HIGH[0])
    e: tuple[float, float] = (model.LOW[1], model.HIGH[1])
    mu_p: tuple[float, float] = (model.LOW[2], model.HIGH[2])
    y_p: tuple[float, float] = (model.LOW[3], model.HIGH[3])
    mended: Lacking = field(default_factory=Lacking)
    fitted: tuple[float, ...] = ()


class PushingPolicy(NamedTuple):
    """weights: `[n]` of the NAF; `make_policy(config)` gives what it does. Where it came of one for
        all of Omega (else None):
    tilt: `[D, width]`, what E's mean adds to the first bias, and at: `[D]`, the mean (unit
        coordinates) that it stands for. told: Pushes of the target that its actions are corrected
        by, where there are any (else None).
    """

    weights: Array
    tilt: Array | None = None
    at: Array | None = None
    told: PushRecord | None = None


class PushingTrajectory(NamedTuple):
    """goals: `[N, 2]` m; points: `[N, 6, 2]` m, the bottle at six even times, the last at the end;
    rewards: `[N]` of these pushes; tested: `[]`, mean reward over the test goals (in simulation
    only; elsewhere the mean of `rewards`); expected: `[N, 6, 2]` m, the points of the same pushes
    simulated at the mean of E, where they are observed (else None).
    """

    goals: Array
    points: Array
    rewards: Array
    tested: Array
    expected: Array | None = None


def pushing_space(config: PushingConfig = PushingConfig()) -> Space:
    """Omega: two frictions, the modulus on a logarithmic scale, and the place of the patch."""
    return space_of("pushing", "omega", config).within(model.PHYSICAL_LOW, model.PHYSICAL_HIGH)


def wide_space() -> Space:
    """A box around Omega for Phase-1 targets that Omega cannot reproduce."""
    return space_of("pushing", "wide")


def make_pushing_naf(config: PushingConfig) -> NAF:
    """The learner whose weights a `PushingPolicy` holds."""
    return make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=config.hidden))


def naf_rates(config: PushingConfig, tuning: bool = False) -> NAFHyper:
    return NAFHyper(
        learning_rate=config.tuning_rate if tuning else config.learning_rate, max_grad_norm=10.0
    )


def checked(config: PushingConfig) -> PushOptions:
    check_counts(config, ("trajectories", "tests", "trials"), "pushing, ")
    for name in ("learning_rate", "tuning_rate"):
        if getattr(config, name) <= 0:
            raise BadInput(
                f"pushing, {name} = {getattr(config, name)}: give a positive one, such as 1e-3"
            )
    if config.mended != Lacking() and config.simulator != "planar":
        raise BadInput(
            f"pushing, simulator = {config.simulator}: a mended push is simulated by the planar "
            "model; leave simulator out"
        )
    if len(config.fitted) not in (0, len(PARAMETERS)):
        raise BadInput(
            f"pushing, fitted = {list(config.fitted)}: give {', '.join(PARAMETERS)}, or leave it "
            "out"
        )
    if min(config.refine, *config.rehearsal) < 0:
        raise BadInput(
            f"pushing, refine = {config.refine}, rehearsal = {config.rehearsal}: give numbers of "
            "pushes, 0 for none"
        )
    if config.correct and not config.refine:
        raise BadInput(
            "pushing, correct: it is by refining that actions are corrected; give refine, such as 8"
        )
    if config.visits == "deployed" and not (config.correct and config.show_gap):
        raise BadInput(
            "pushing, visits = deployed: only corrected actions differ from E's own, and f tells "
            "them by the gap; set correct and show_gap"
        )
    if config.show_gap and not config.pretrain:
        raise BadInput(
            "pushing, show_gap: only a policy made with pretrain = true knows the mean of E that "
            "the gap is to; set it"
        )
    if config.refine and not config.pretrain:
        raise BadInput(
            "pushing, refine: only a policy made with pretrain = true knows the mean of E to try "
            "a push at; set it"
        )
    return check_planar(PushOptions(friction=config.friction, duration=config.duration))
