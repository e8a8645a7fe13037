"""One recording made ready to be diagnosed: plant, windows, noise, catalogue, and the linearisation of any of its models."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from adaptsim_jax.effects.base import Effect, Reach
from adaptsim_jax.logs.meta import check_known
from adaptsim_jax.logs.model_file import declared_model
from adaptsim_jax.logs.noise.floor import NoiseFloor, smooth
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.segments import Windows, cut_windows
from adaptsim_jax.logs.types import Recording, Trial
from adaptsim_jax.mechanisms.plant import Plant
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.dictionary import gravity_torque, make_reach
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.output_error import FitSettings, least_squares
from adaptsim_jax.sysid.forward import Model, make_model

Active = tuple[tuple[str, str], ...]  # (effect, where) pairs that act


UNFINISHED, DIVERGED = 1, 3  # indices into fit_result.CODES
FAR = 0.15  # rad that a window may stray, times the growth of errors within it, before it is cut shorter


class Diverged(ArithmeticError):
    """A model whose simulation runs away where it should be linearised."""


@dataclass(frozen=True)
class Problem:
    """A recording, its declared model and every candidate, as arrays. Built by `prepare`."""

    recording: Recording
    audit: Audit
    noise: NoiseFloor
    plant: Plant
    model: Model
    windows: Windows
    reach: Reach
    theta0: np.ndarray
    rows_merged: int
    base: Active = ()  # effects that the declared model has already (it is a mended one)
    eff0: np.ndarray | None = None  # `[E]` where they start
    elaborated: Active = ()  # found effects whose late parameters are fitted too
    criteria: Criteria = Criteria()  # noqa: RUF009

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the effect parameters `[E]`, for this rig; what the declared model has already stays within them, and late
        parameters stay where they are."""
        layout = self.model.layout
        low, high = layout.bounds(self.reach)
        start = layout.off() if self.eff0 is None else self.eff0
        room = 2.0 * start  # what the declared model has may be large for the torques of this recording
        for name, where in self.base:
            at = layout.instances[layout.index(name, where)].at
            low[at], high[at] = np.minimum(low[at], room[at]), np.maximum(high[at], room[at])
        late = layout.vector(lambda p, i: p.late and (i.effect.name, i.where) not in self.elaborated).astype(bool)
        return np.where(late, start, low), np.where(late, start, high)

    @property
    def torque_rms(self) -> np.ndarray:
        """RMS of the recorded torque per joint `[n]` N m; of gravity's, where none was applied."""
        if not any_torque(self.recording):
            return np.sqrt(np.mean(gravity_torque(self.plant, self.theta0, self.windows) ** 2, axis=0))
        return np.sqrt(np.mean(np.concatenate([t.torque for t in self.recording.trials]) ** 2, axis=0))

    @property
    def torque_scale(self) -> np.ndarray:
        """The same, no less than a tenth of the most driven joint's: a joint at rest is not infinitely sensitive."""
        rms = self.torque_rms
        return np.maximum(rms, 0.1 * rms.max() + 1e-9)

    def phases(self, active: Active) -> int:
        """How many phases of trials those effects use, beyond the one they have by themselves."""
        layout = self.model.layout
        clocked = any(layout.instances[layout.index(*a)].effect.clocked for a in active)
        return max(len(self.recording.trials) - 1, 0) if clocked and np.any(self.windows.clock) else 0


def prepare(
    recording: Recording,
    audit: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    *,
    duration: float = 0.5,
    rows_kept: int = 34,
    averaged: bool = False,
    criteria: Criteria = Criteria(),  # noqa: B008
) -> Problem:
    """Cut windows, start the declared parameters, and say what the motion covers.

    Angles alone are fitted: a driver's velocity is a filtered difference of them, with a lag of its own. `duration` s is
    a window's length; about `rows_kept` averaged rows of each are kept for the residual statistics. Where the recording
    names a mended model, that is the declared one: its effects act from the start. averaged: the start of the declared
    parameters is taken from slow motion alone (`Plant.averaged_theta`). Raises BadInput where the model does not fit.
    """
    given = declared_model(recording, effects)
    motions = [smooth(t, noise) for t in recording.trials]
    plant = make_plant(recording.model, recording.angle_zero, recording.geometry, recording.known)
    plant = plant if any_torque(recording) else plant.unscaled()
    check_known(recording.path, recording.known, (*plant.theta_names, *plant.physical(np.ones(len(plant.theta_names)))))
    regress = plant.averaged_theta if averaged else plant.initial_theta
    theta0 = regress([(t.time, q, v, t.torque) for t, (q, v) in zip(recording.trials, motions, strict=True)])
    theta0 = theta0 if given is None else np.clip(given.theta(plant), plant.low, plant.high)
    sigma = np.array([noise.std["q1"], noise.std["q2"], np.inf, np.inf])
    trials = [_masked(t, audit.valid.get(t.name)) for t in recording.trials]
    windows = cut_windows(trials, sigma, duration=duration, motions=motions, use_velocity=False)
    reach = make_reach(plant, theta0, windows)
    if given is not None and given.trial_clock:
        windows = replace(windows, clock=clock_of(given.trial_clock, recording, windows))
    model = make_model(plant, tuple(effects))
    merged = max(1, windows.measured.shape[1] // rows_kept)
    base, eff0 = ((), None) if given is None else (given.active, given.effect_vector(model.layout))
    return Problem(recording, audit, noise, plant, model, windows, reach, theta0, merged, base, eff0, (), criteria)


def any_torque(recording: Recording) -> bool:
    """Whether any torque acts at all."""
    return any(np.any(t.torque) for t in recording.trials)


def _masked(trial: Trial, valid: np.ndarray | None) -> Trial:
    """The trial without the rows that the audit found frozen or spiked."""
    if valid is None or valid.all():
        return trial
    return replace(trial, q=np.where(valid[:, None], trial.q, np.nan))


def prepare_within_reach(
    recording: Recording,
    audit: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    *,
    duration: float = 0.5,
    criteria: Criteria = Criteria(),  # noqa: B008
) -> tuple[Problem, FitResult]:
    """`prepare` with windows short enough for a fit, and its first fit (`regressed_start`).

    Where the motion is unstable and much is missing, a model strays so far within half a second that no step on its
    linearisation is worth anything: what counts is how far it strays times how much a small error grows. Where errors do not
    grow, long windows stay: they see the slow forces, short ones mostly the fast. A regression that vibrations have spoilt strays
    too: before windows are cut shorter, the one of slow motion is tried.
    """
    least = 12.0 * max(t.dt for t in recording.trials)
    while True:
        problem = prepare(recording, audit, noise, effects, duration=duration, criteria=criteria)
        start = regressed_start(problem)
        if beyond_reach(problem, start) and recording.model_file is None:
            other = prepare(recording, audit, noise, effects, duration=duration, averaged=True, criteria=criteria)
            calm = regressed_start(other)
            if distance(other, calm) < distance(problem, start):
                problem, start = other, calm
        if not beyond_reach(problem, start) or duration < max(0.1, 2.0 * least):
            return problem, start
        duration *= 0.5


def beyond_reach(problem: Problem, result: FitResult) -> bool:
    """Whether a model strays too far within its windows for its linearisation to lead it back."""
    return result.code == DIVERGED or strayed(problem, result) * growth(problem, result) >= FAR


def distance(problem: Problem, result: FitResult) -> float:
    """How far a model strays [rad], infinitely where it runs away."""
    return np.inf if result.code == DIVERGED else strayed(problem, result)


def initial_states(problem: Problem, active: Active, theta: np.ndarray, eff: np.ndarray, x0: np.ndarray) -> FitResult:
    """A model as it is, only its initial states fitted, by least squares."""
    fixed = (*problem.plant.theta_names, *("/".join(n) for n in problem.model.layout.names()))
    return least_squares(
        problem.model, problem.model.layout.mask(list(active)), problem.windows, theta, eff, x0,
        bounds=problem.bounds, fixed=fixed, settings=FitSettings(iterations=12, tolerance=1e-3, huber=1e3),
    )  # fmt: skip


def growth(problem: Problem, result: FitResult) -> float:
    """How much an error of the initial angles grows within a window, the median over windows; 1 if not at all."""
    windows = problem.windows
    count, length, channels = windows.measured.shape
    weight = np.asarray(windows.weight)[..., None]
    moved = result.jac_state.reshape(count, length, channels, -1)[..., : problem.plant.joint_dim]
    moved = np.where(weight > 0, moved / np.where(weight > 0, weight, 1.0), 0.0)[windows.real]
    return float(np.median(np.sqrt(np.square(moved).sum((2, 3)).max(1) / problem.plant.joint_dim)))


def strayed(problem: Problem, result: FitResult) -> float:
    """RMS distance [rad] of simulated from measured angles."""
    weight = np.asarray(problem.windows.weight)
    error = np.where(weight > 0, result.residual / np.where(weight > 0, weight, 1.0), np.nan)
    return float(np.sqrt(np.nanmean(np.square(error))))


def regressed_start(problem: Problem) -> FitResult:
    """The declared parameters as the measured motion suggests them (`theta0`), initial states fitted."""
    eff0 = problem.model.layout.off() if problem.eff0 is None else problem.eff0
    return initial_states(problem, problem.base, problem.theta0, eff0, problem.windows.start)


def by_least_squares(
    problem: Problem, active: Active, theta: np.ndarray, eff: np.ndarray, x0: np.ndarray,
    settings: FitSettings = FitSettings(iterations=25, tolerance=1e-3, huber=1e3),  # noqa: B008
) -> FitResult:  # fmt: skip
    """Least-squares output-error fit of a model with effects, sensors being the only noise."""
    return least_squares(
        problem.model, problem.model.layout.mask(list(active)), problem.windows, theta, eff, x0, bounds=problem.bounds,
        settings=settings,
    )  # fmt: skip


def at_point(problem: Problem, active: Active, theta: np.ndarray, eff: np.ndarray, x0: np.ndarray) -> FitResult:
    """Residual and Jacobians of a model at given parameters: a fit of no iterations."""
    mask = problem.model.layout.mask(list(active))
    return least_squares(
        problem.model, mask, problem.windows, theta, eff, x0,
        bounds=problem.bounds, settings=FitSettings(iterations=0),
    )  # fmt: skip


def clock_of(given: Mapping[str, float], recording: Recording, windows: Windows) -> np.ndarray:
    """Clock shifts `[N]` s by the trials' names; zero for trials that are not named."""
    clock = np.zeros_like(windows.clock)
    for i, trial in enumerate(recording.trials):
        clock[i] = given.get(trial.name, 0.0)
    return clock
