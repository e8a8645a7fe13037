"""Scooping: its options, the parameters that are adapted, its settings, and what policies and
trajectories are made of.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from jax import Array

from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.learners.naf import NAF, NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalConfig
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import space_of, tables
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.bank import BOXES as BANK_BOXES
from adaptsim_jax.tasks.scooping.corrections import ScoopRecord
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions

SETTINGS = tables()["scooping"]["settings"]


@dataclass(frozen=True)
class ScoopingConfig:
    """Options of the task.

    trajectories: Trials an iteration. tests: Places and errors that the reward of a simulated
    target is averaged over. fresh: More of them, in which `compare` scores each policy once more,
    none being chosen by them.
    targets: Phase 1 draws targets from Omega (the paper), or from a box around it, boxes included
    (`wide`). simulator: Where policies are trained and Phase 1 runs: the `bank` of the hydroelastic
    engine's trials, as far as `source` and `rehearsal` say; `hydro`, that engine itself, without
    the bank; or `mjx`, the MuJoCo scene in MJX (without correct, both). source: Of the trials that
    policies are trained with: the `bank`, or the `simulator`. rehearsal: Of the targets that Phase
    1 learns from, likewise. lucks: Execution errors that a trial of the bank is averaged over.
    checks: Places and errors that the best of a training's policies is chosen by, in the bank; 0
    keeps the last one. correct: What is deployed is the best action by the bank at E's mean as
    mended by the scoops made in the target so far (`corrections`). A visit's own scoops are not,
    nor is anything in Phase 1. trials: M of the paper; training: how;
    hidden, learning_rate: Of the NAF. clearance, noise: difficulty, see
    `tasks.scooping.model.ScoopOptions`. camera: Mean along the motion and standard deviation of the
    noise on observed places, m. numerics: Of the engine. mu, e, h: Omega.
    """

    trajectories: int = 2
    tests: int = 6
    fresh: int = 0
    targets: Literal["omega", "wide"] = "wide"
    simulator: Literal["bank", "hydro", "mjx"] = "bank"
    source: Literal["bank", "simulator"] = "bank"
    rehearsal: Literal["bank", "simulator"] = "bank"
    lucks: int = 4
    checks: int = 16
    correct: bool = False
    trials: int = 1200
    training: GoalConfig = field(
        default_factory=lambda: GoalConfig(
            updates=60, batch=32, candidates=32, capacity=1200, temperature=0.05, width=(0.4, 0.08)
        )
    )
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 3e-3
    clearance: float = ScoopOptions().clearance
    noise: tuple[float, ...] = ScoopOptions().noise
    camera: tuple[float, ...] = (0.002, 0.002)
    numerics: Numerics = field(default_factory=Numerics)
    mu: tuple[float, float] = (model.LOW[0], model.HIGH[0])
    e: tuple[float, float] = (model.LOW[1], model.HIGH[1])
    h: tuple[float, float] = (model.LOW[3], model.HIGH[3])

    @property
    def trains_in_bank(self) -> bool:
        return self.simulator == self.source == "bank"

    @property
    def rehearses_in_bank(self) -> bool:
        return self.simulator == self.rehearsal == "bank"


class ScoopingPolicy(NamedTuple):
    """weights: `[n]` of the NAF; `make_policy(config)` gives what it does. Where deployed policies
    are corrected (else None): at: `[D]`, the mean of E (unit coordinates) that it stands for; told:
    the target's scoops that it is corrected by, if any; probe: `[3]` in [-1, 1], what the last
    scoop of a visit tries instead (`deployed.make_probe`), if anything.
    """

    weights: Array
    at: Array | None = None
    told: ScoopRecord | None = None
    probe: Array | None = None


class ScoopingTrajectory(NamedTuple):
    """points: `[N, 8, 2]` m, the piece as the camera saw it, from where it lay; success: `[N]` of
    these trials; tested: `[]`, mean over the test contexts (in simulation only; elsewhere the mean
    of `success`).
    """

    points: Array
    success: Array
    tested: Array


def scooping_space(config: ScoopingConfig = ScoopingConfig()) -> Space:
    """Omega: friction, modulus on a logarithmic scale, shape as a category, height."""
    return space_of("scooping", "omega", config).within(model.PHYSICAL_LOW, model.PHYSICAL_HIGH)


def wide_space() -> Space:
    """A box around Omega for Phase-1 targets that Omega cannot reproduce; boxes among them."""
    return space_of("scooping", "wide")


def make_scooping_naf(config: ScoopingConfig) -> NAF:
    """The learner whose weights a `ScoopingPolicy` holds."""
    return make_naf(NAFConfig(obs_dim=2, action_dim=3, hidden=config.hidden))


def naf_rates(config: ScoopingConfig) -> NAFHyper:
    """Rates of the task policy's learner."""
    return NAFHyper(learning_rate=config.learning_rate, max_grad_norm=10.0)


def checked(config: ScoopingConfig) -> ScoopOptions:
    """The engine's options, if the config makes sense; BadInput names the key otherwise."""
    check_counts(config, ("trajectories", "tests", "trials", "lucks"), "scooping, ")
    if config.fresh < 0:
        raise BadInput(f"scooping, fresh = {config.fresh}: give 0 for none, or more, such as 96")
    if config.checks < 0:
        raise BadInput(
            f"scooping, checks = {config.checks}: give 0 to keep the last policy of a training, or "
            "more"
        )
    if config.learning_rate <= 0:
        raise BadInput(
            f"scooping, learning_rate = {config.learning_rate}: give a positive one, such as 3e-3"
        )
    if len(config.camera) != 2 or config.camera[1] < 0:
        raise BadInput(
            f"scooping, camera = {config.camera}: give a mean and a standard deviation of at least "
            "0, in m"
        )
    if config.correct and config.simulator != "bank":
        raise BadInput(
            "scooping, correct: what is deployed is corrected by the bank, and simulator = "
            f"'{config.simulator}' does without; set correct = false"
        )
    model.check_numerics(config.numerics)
    _check_covered(config)
    return model.check_options(ScoopOptions(clearance=config.clearance, noise=config.noise))


def _check_covered(config: ScoopingConfig) -> None:
    """BadInput where Omega reaches beyond the pieces that the bank was made of: its networks know
    nothing there.
    """
    if not (config.trains_in_bank or config.rehearses_in_bank or config.correct):
        return
    for name, low, high in zip(model.PARAMETERS, *BANK_BOXES["wide"], strict=True):
        given = getattr(config, name, (low, high))  # the shapes are no option
        if given[0] < low or given[1] > high:
            raise BadInput(
                f"scooping, {name} = {list(given)}: the bank holds pieces of {low:g} to {high:g}; "
                "stay within, or use simulator = 'hydro', correct = false"
            )
