"""Laws polished on whole trials of the whole machine, all joints together, and what is not borne
out there returned to the file's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import (
    LawFit,
    explains,
    paired_t,
    prior_of,
    pull_loss,
    solve_within,
)
from adaptsim_jax.simulators.closed_loop.imposed import JointProblem, Recording
from adaptsim_jax.simulators.closed_loop.law import ServoLaw, clip_law, ranges, step_law
from adaptsim_jax.simulators.closed_loop.whole import (
    blocks_of,
    simulate,
    simulate_once,
    sums_by_piece,
    trial_errors,
)

STEP = {
    # at a limit a joint's place hangs on their quotients: longer steps are too rough for kp alone
    "scale": 1e-4,
    "damping": 1e-4,
    "limit": 1e-4,
    "delay": 0.2,
    "lag": 0.2,
    "rotor": 0.02,
    "payload": 0.02,
    "reach": 0.1,
    "lift": 0.02,
    "offset": 0.05,
    "damping_delay": 0.2,
    "shift": 0.2,
}
OTHER_STEP = 0.01
SHARED_BY_ALL = -1
Coordinate = tuple[int, str]
"""(joint, name)."""


@dataclass(frozen=True)
class FittedServos:
    """A machine's servos.

    Args:
        fits: By joint.
        shared: Names of numbers with one value for all joints.
    """

    fits: tuple[LawFit, ...]
    shared: tuple[str, ...] = ()

    @property
    def laws(self) -> list[ServoLaw]:
        """By joint."""
        return [f.law for f in self.fits]

    @property
    def coordinates(self) -> list[tuple[int, str]]:
        """(joint, name) of what is fitted; joint -1: of all."""
        of_joints = [(j, n) for j, f in enumerate(self.fits) for n in f.free]
        return of_joints + [(SHARED_BY_ALL, n) for n in self.shared]


@dataclass(frozen=True)
class PolishedLaws:
    """Servos fitted to whole trials.

    Args:
        model: The servos.
        errors: [rows, n] rad.
        hess, slope: Normal equations by piece, [P, K, K] and [P, K], without the pull.
        steps: [F, K] to the coordinates that one step without each group of pieces gives.
    """

    model: FittedServos
    errors: np.ndarray
    hess: np.ndarray
    slope: np.ndarray
    steps: np.ndarray


@dataclass(frozen=True)
class WholeTrials:
    """Whole trials of a machine.

    Args:
        recording: What is simulated.
        problems: Its joints, for scales and limits of their numbers.
        block: [rows of all trials] the piece of each, -1: none.
        counted: [rows of all trials] whether a row is compared.
    """

    recording: Recording
    problems: tuple[JointProblem, ...]
    block: np.ndarray
    counted: np.ndarray

    def errors(
        self, machines: Sequence[Sequence[ServoLaw]], roughly: bool = False
    ) -> list[np.ndarray]:
        """[rows, n] of each machine, 0 where no row is compared. roughly: as differences of
        machines need it, in a third of the time.
        """
        if roughly:
            paths = simulate_once(self.recording.restepped(2.0), machines)
        else:
            paths = simulate(self.recording, machines)
        return [trial_errors(self.recording, m) * self.counted[:, None] for m in paths]

    def first(self, seconds: float) -> "WholeTrials":
        """The same of each trial's first so many seconds."""
        recording, rows, counted = self.recording, [], []
        ends = np.cumsum([len(t.time) for t in recording.trials])
        for t, own in zip(recording.trials, np.split(self.counted, ends[:-1]), strict=True):
            rows.append(max(2, int(np.searchsorted(t.time, seconds))))
            counted.append(own[: rows[-1]])
        trials = tuple(t.first(n) for t, n in zip(recording.trials, rows, strict=True))
        pieces = tuple((k, min(a, rows[k]), min(b, rows[k] - 1)) for k, a, b in recording.pieces)
        recording = replace(recording, trials=trials, pieces=pieces)
        block = blocks_of(recording)
        return replace(self, recording=recording, block=block, counted=np.concatenate(counted))

    def by_piece(self, error: np.ndarray) -> np.ndarray:
        """Sums of squares [P, n]."""
        return sums_by_piece(self.recording, error)

    def step_from(self, model: FittedServos, steps: np.ndarray) -> FittedServos:
        """A step [K] away."""
        step_of = dict(zip(model.coordinates, steps, strict=True))
        fits = []
        for j, (fit, p) in enumerate(zip(model.fits, self.problems, strict=True)):
            joint_steps = np.array([step_of[j, n] for n in fit.free])
            law = (
                step_law(p.servo, p.scales, fit.law, fit.free, joint_steps) if fit.free else fit.law
            )
            for name in model.shared:
                unit = self.unit(p, (SHARED_BY_ALL, name))
                value = getattr(law, name) + step_of[SHARED_BY_ALL, name] * unit
                law = clip_law(p.servo, p.scales, law._replace(**{name: value}), (name,))
            fits.append(fit.of(law))
        return FittedServos(tuple(fits), model.shared)

    def room(self, model: FittedServos, max_step: float) -> tuple[np.ndarray, np.ndarray]:
        """How far each coordinate may go, down and up, [K]: at most `max_step`."""
        low = {c: -max_step for c in model.coordinates}
        high = {c: max_step for c in model.coordinates}
        for j, (fit, p) in enumerate(zip(model.fits, self.problems, strict=True)):
            ends = ranges(p.servo)
            for at in [(j, n) for n in fit.free] + [(SHARED_BY_ALL, n) for n in model.shared]:
                if (name := at[1]) not in ends:
                    continue
                unit = self.unit(p, at)
                down, up = ((end - getattr(fit.law, name)) / unit for end in ends[name])
                low[at], high[at] = max(low[at], min(down, 0.0)), min(high[at], max(up, 0.0))
        return np.array([*low.values()]), np.array([*high.values()])

    def unit(self, problem: JointProblem, at: Coordinate) -> float:
        """The size of a coordinate of 1."""
        return self.rotor_unit if at == (SHARED_BY_ALL, "rotor") else problem.scales.unit(at[1])

    @property
    def rotor_unit(self) -> float:
        """The size of a rotor of one value for all joints, kg m^2."""
        return float(np.median([p.scales.inertia for p in self.problems]))

    def pull_loss(self, model: FittedServos) -> float:
        """What the pull to the file's scale adds to the loss."""
        rows = zip(self.problems, model.fits, strict=True)
        return sum(pull_loss(p, f) for p, f in rows if f.free)


def whole_trials(recording: Recording, problems: Sequence[JointProblem]) -> WholeTrials:
    """The rows after the first instants of each trial count."""
    unscored = CLOSED_LOOP.unscored if recording.stretch else 0.02
    counted = np.concatenate([t.time > unscored for t in recording.trials])
    return WholeTrials(recording, tuple(problems), blocks_of(recording), counted)


def weights(trials: WholeTrials, error: np.ndarray) -> np.ndarray:
    """[n] of joints."""
    noise = np.array([p.noise for p in trials.problems])
    return 1.0 / (np.square(error).mean(0) + np.square(noise))


def polish_laws(
    trials: WholeTrials, model: FittedServos, rounds: int = 8, apart: bool = False
) -> PolishedLaws:
    """Gauss and Newton's fit over whole trials. apart: as of `_linearise`."""
    error = trials.errors([model.laws])[0]
    damping = 1e-3
    while True:
        weight = weights(trials, error)
        before = float((np.square(error) * weight).sum()) + trials.pull_loss(model)
        hess, slope = _linearise(trials, model, error, weight, apart)
        prior_hess, prior_slope = pull(trials, model)
        if not model.coordinates or rounds == 0:
            break
        total, right = hess.sum(0) + prior_hess, slope.sum(0) + prior_slope
        diagonal = np.diag(np.diag(total))
        room = trials.room(model, 0.7)
        for factors in ((1e-3, 1.0), (30.0, 1e3)):  # the longer steps nearly always do
            sizes = damping * np.array(factors)
            steps = [solve_within(total + z * diagonal, right, *room) for z in sizes]
            tries = [trials.step_from(model, step) for step in steps]
            errors_of_tries = trials.errors([t.laws for t in tries])
            loss = [
                float((np.square(e) * weight).sum()) + trials.pull_loss(t)
                for e, t in zip(errors_of_tries, tries, strict=True)
            ]
            best = int(np.argmin(loss))
            if loss[best] < before:
                break
        if not loss[best] < before:
            break
        model, error, rounds = tries[best], errors_of_tries[best], rounds - 1
        damping = float(np.clip(sizes[best], 1e-7, 1e3))
        if loss[best] > before * (1.0 - CLOSED_LOOP.settled):
            rounds = 0
    return PolishedLaws(model, error, hess, slope, _jackknife_steps(trials, model, hess, slope))


def _linearise(
    trials: WholeTrials, model: FittedServos, error: np.ndarray, weight: np.ndarray, apart: bool
):
    """Normal equations by piece, by differences. apart: as if a joint's numbers moved no other
    joint, which closed loops nearly hold: then all joints change at once.
    """
    at = model.coordinates
    size = np.array([STEP.get(name, OTHER_STEP) for _, name in at])
    keys = [name if apart and j != SHARED_BY_ALL else (j, name) for j, name in at]
    alone = list(dict.fromkeys(keys))
    changed = [trials.step_from(model, size * [k == key for k in keys]) for key in alone]
    count = len(trials.recording.pieces)
    hess, slope = np.zeros((count, len(at), len(at))), np.zeros((count, len(at)))
    if not at:
        return hess, slope
    base_error, *changed_errors = trials.errors([m.laws for m in (model, *changed)], roughly=True)
    change = {key: e - base_error for key, e in zip(alone, changed_errors, strict=True)}
    derivative = np.stack([change[k] / h for k, h in zip(keys, size, strict=True)], -1)
    if apart:
        own = [[j in (k, SHARED_BY_ALL) for j, _ in at] for k in range(len(model.fits))]
        derivative *= np.array(own)
    for i in range(count):
        rows = trials.block == i
        d = derivative[rows]
        hess[i] = np.einsum("rja,rjb,j->ab", d, d, weight)
        slope[i] = np.einsum("rja,rj,j->a", d, error[rows], weight)
    return hess, slope


def pull(trials: WholeTrials, model: FittedServos) -> tuple[np.ndarray, np.ndarray]:
    """Curvature [K, K] and slope [K] of the pull to the file's scale."""
    count = len(model.coordinates)
    hess, slope, k = np.zeros((count, count)), np.zeros(count), 0
    for p, f in zip(trials.problems, model.fits, strict=True):
        size = len(f.free)
        hess[k : k + size, k : k + size], slope[k : k + size] = prior_of(p, f)
        k += size
    return hess, slope


def _jackknife_steps(trials: WholeTrials, model: FittedServos, hess, slope) -> np.ndarray:
    prior = pull(trials, model)
    groups = trials.problems[0].groups
    total, right = hess.sum(0) + prior[0], slope.sum(0) + prior[1]
    room = trials.room(model, 0.7)
    full_step = solve_within(total, right, *room)
    steps = [solve_within(total - hess[g].sum(0), right - slope[g].sum(0), *room) for g in groups]
    return np.array(steps) - full_step


def held_out_errors(trials: WholeTrials, polished: PolishedLaws) -> np.ndarray:
    """Errors [rows, n] rad of whole trials, each group of pieces by the numbers that one step
    without it gives.
    """
    out = polished.errors.copy()
    groups = trials.problems[0].groups
    if not polished.model.coordinates:
        return out
    models = [trials.step_from(polished.model, np.clip(step, -0.7, 0.7)) for step in polished.steps]
    errors_by_group = trials.errors([m.laws for m in models])
    for group, error in zip(groups, errors_by_group, strict=True):
        rows = np.isin(trials.block, group)
        out[rows] = error[rows]
    return out


def remove_coordinates(
    trials: WholeTrials,
    polished: PolishedLaws,
    removed: Sequence[Coordinate],
    base: Sequence[ServoLaw],
) -> FittedServos:
    """The servos with some coordinates as the laws `base` have them, the others one step on."""
    model, at = polished.model, polished.model.coordinates
    fits = []
    for j, (fit, law) in enumerate(zip(model.fits, base, strict=True)):
        base_names = [name for k, name in removed if k in (j, SHARED_BY_ALL)]
        free = tuple(n for n in fit.free if (j, n) not in removed)
        fits.append(LawFit(_with_base_values(fit.law, law, base_names, fit.free), free))
    shared = tuple(n for n in model.shared if (SHARED_BY_ALL, n) not in removed)
    new = FittedServos(tuple(fits), shared)
    remaining = [i for i, c in enumerate(at) if c not in removed]
    if not remaining:
        return new
    distances = np.array([_distance(trials, model, new, c) if c in removed else 0.0 for c in at])
    prior_hess, prior_slope = pull(trials, model)
    hess, slope = polished.hess.sum(0) + prior_hess, polished.slope.sum(0) + prior_slope
    right = slope[remaining] + hess[remaining] @ distances
    room = trials.room(new, 0.5)
    return trials.step_from(new, solve_within(hess[np.ix_(remaining, remaining)], right, *room))


def _with_base_values(
    law: ServoLaw, base: ServoLaw, names: Sequence[str], free: Sequence[str]
) -> ServoLaw:
    """A law with some coordinates of another. The scale alone takes with it what it multiplies."""
    new = law._asdict()
    if "scale" in names and "damping" not in names and base.kp > 0.0:
        factor = base.kp / law.kp
        for name in ("kp", "damping", "rub", "limit"):
            if name == "kp" or name in free:
                new[name] *= factor
    elif "scale" in names:
        new |= {"kp": base.kp, "damping": base.damping}
    elif "damping" in names:
        new["damping"] = base.damping / base.kp * law.kp
    if "limit" in names:
        new |= {"limit": base.limit, "inside": base.inside}
    for name in names:
        if name not in ("scale", "damping", "limit"):
            new[name] = getattr(base, name)
    return ServoLaw(**new)


def _distance(trials: WholeTrials, model: FittedServos, new: FittedServos, at: Coordinate) -> float:
    """Return by how many units of its coordinate a number was moved."""
    j, name = max(at[0], 0), at[1]
    law, new_law, p = model.fits[j].law, new.fits[j].law, trials.problems[j]
    stiffness = "damping" if p.servo.follows_speed else "kp"

    def log_ratio(number):
        return float(np.log(getattr(new_law, number) / getattr(law, number)))

    if name == "scale":
        return log_ratio(stiffness)
    if name == "damping":
        return log_ratio("damping") - log_ratio("kp")
    if name == "limit":
        return 0.0
    return (getattr(new_law, name) - getattr(law, name)) / trials.unit(p, at)


def over_noise(trials: WholeTrials, error: np.ndarray) -> np.ndarray:
    """RMS errors over the noise [n]."""
    noise = np.array([p.noise for p in trials.problems])
    return np.sqrt(np.square(error[trials.counted]).mean(0)) / noise


class Better(NamedTuple):
    """What one model of whole trials does better than another at some joints.

    Args:
        gain: Logarithm of the squared errors' quotient, at most 1 of a piece and joint, summed over
            joints, mean over pieces.
        share: Of the squared error, noise being one everywhere, that is taken off.
        p: Of the paired t-test over pieces.
        pieces: That are better.
        explains: Whether it explains pieces wholly (`fit.explains`).
    """

    gain: float
    share: float
    p: float
    pieces: int
    explains: bool


def better_at(
    trials: WholeTrials, before: np.ndarray, after: np.ndarray, joints: Sequence[int]
) -> Better:
    """How errors [rows, n] `after` are better than `before` at some joints."""
    rows = np.bincount(trials.block[trials.block >= 0], minlength=len(trials.recording.pieces))
    noise = np.array([trials.problems[j].noise for j in joints])
    before_over_noise, after_over_noise = (
        np.sqrt(trials.by_piece(e)[:, joints] / np.maximum(rows, 1)[:, None]) / noise
        for e in (before, after)
    )
    floor = 0.05  # of the squared noise, below which nothing counts
    by_joint = np.clip(
        np.log((before_over_noise**2 + floor) / (after_over_noise**2 + floor)), -1.0, 1.0
    )
    total = by_joint.sum(1)
    share = 1.0 - float(
        np.square(after_over_noise).sum() / max(np.square(before_over_noise).sum(), 1e-12)
    )
    explains_pieces = explains(before_over_noise.max(1), after_over_noise.max(1))
    return Better(
        float(total.mean()), share, paired_t(total), int((total > 0.0).sum()), explains_pieces
    )
