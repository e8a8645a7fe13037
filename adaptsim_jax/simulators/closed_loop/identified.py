"""The servos' laws that a recording shows: begun joint by joint, grown while left-out pieces
improve, polished on whole trials, and returned to the file's where these do not refute it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.testing import jackknife
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import (
    LawFit,
    error_over_noise,
    fit_from_grid,
    fit_law,
    fit_with_limit,
    is_preferred,
    linearise,
    score,
    solve,
    sum_squares,
)
from adaptsim_jax.simulators.closed_loop.imposed import JointProblem, Recording, joint_problems
from adaptsim_jax.simulators.closed_loop.law import OPEN, ServoLaw, step_law
from adaptsim_jax.simulators.closed_loop.pieces import imposed_motion
from adaptsim_jax.simulators.closed_loop.polish import (
    SHARED_BY_ALL,
    Better,
    Coordinate,
    FittedServos,
    PolishedLaws,
    WholeTrials,
    better_at,
    held_out_errors,
    over_noise,
    polish_laws,
    remove_coordinates,
    whole_trials,
)
from adaptsim_jax.simulators.closed_loop.rivals import (
    CARRIED,
    allowed_by_all,
    damping_shown,
    gain_shown,
    one_shared,
    or_files_gain,
    or_heavier,
    or_other_friction,
    or_other_scale,
    or_plain,
    or_rival,
    or_stepped,
    scale_shown,
    with_mass,
)
from adaptsim_jax.simulators.closed_loop.shared import DELAY_NAMES, late_targets, one_more_shared
from adaptsim_jax.simulators.closed_loop.stepping import errors, squared

STEP_NAMES = ("damping_delay", "shift")
"""Fitted of all joints together whatever is found: how a simulator or a controller steps."""
OWN_NAMES = ("limit", "offset", "rotor", "spring", "zero")
"""Numbers that one joint may have beside its law."""


@dataclass(frozen=True)
class LawMember:
    """What a law has that the file's has not, and how whole trials bear it out.

    Args:
        coordinates: (joint, name) that go together; joint -1: of all.
        test: How whole trials are better with it.
        without: What is left without it, times the noise, at the joint where that is most.
        change: Of the file's number, as a logarithm, where it is one of the law.
    """

    coordinates: tuple[Coordinate, ...]
    test: Better
    without: float
    change: float

    @property
    def refuted(self) -> bool:
        """Whether whole trials do as well without it, or lack nothing without it."""
        joint = self.coordinates[0][0]
        threshold = CLOSED_LOOP.shared_gain if joint == SHARED_BY_ALL else CLOSED_LOOP.gain
        beyond_chance = self.test.p < CLOSED_LOOP.level or self.test.explains
        has_gain = self.test.gain > threshold and beyond_chance
        is_lacking = self.without > CLOSED_LOOP.shown
        return not (has_gain and is_lacking and self.change > CLOSED_LOOP.min_change)


@dataclass(frozen=True)
class ServoLaws:
    """What a recording shows of a machine's servos.

    Args:
        recording: What was simulated.
        found: The servos, polished.
        members: What stays beside the file's laws.
        before, after: Errors [rows, n] rad over whole trials by the file's laws and by these, each
            piece by the numbers that the others give.
        whole: The trials.
        instead: Joints whose kp and damping, times one factor, say what a mass that is carried
            does.
        gain_shown, damping_shown, scale_shown: By joint, whether another kp alone, another damping
            alone, and another scale of its servo, are simulated worse.
    """

    recording: Recording
    found: PolishedLaws
    members: tuple[LawMember, ...]
    before: np.ndarray
    after: np.ndarray
    whole: WholeTrials
    instead: tuple[int, ...] = ()
    gain_shown: tuple[bool, ...] = ()
    damping_shown: tuple[bool, ...] = ()
    scale_shown: tuple[bool, ...] = ()

    @property
    def laws(self) -> list[ServoLaw]:
        """By joint."""
        return self.found.model.laws

    @property
    def over_noise(self) -> np.ndarray:
        """What is left [n], times the noise."""
        return over_noise(self.whole, self.after)

    def spread(self, coordinates: Sequence[Coordinate]) -> float:
        """Standard error of the sum of some coordinates, by the jackknife over left-out pieces; 0
        where none is fitted.
        """
        indices = [i for i, c in enumerate(self.found.model.coordinates) if c in coordinates]
        if not indices:
            return 0.0
        return float(jackknife(self.found.steps[:, indices].sum(1)))

    def ends(self) -> float:
        """Standard errors from the middle of a 90 % interval to its ends: Student's t."""
        return float(stats.t.ppf(0.95, max(len(self.found.steps) - 1, 1)))


def scale_spread(servo_laws: ServoLaws) -> np.ndarray:
    """Standard error [n] of the logarithm of kp, each joint's rotor and a mass at the hand free as
    well: where these and kp can grow together, only ratios are known. Infinite where kp was not
    fitted.
    """
    model, out = servo_laws.found.model, np.full(len(servo_laws.laws), np.inf)
    scaled = [j for j, f in enumerate(model.fits) if "scale" in f.free]
    if not scaled:
        return out
    free = [f.and_free("rotor") if j in scaled else f for j, f in enumerate(model.fits)]
    shared = model.shared
    if servo_laws.recording.hand >= 0 and "payload" not in shared:
        shared = (*shared, *CARRIED)
    with_all_free = polish_laws(servo_laws.whole, FittedServos(tuple(free), shared), rounds=0)
    spread = jackknife(with_all_free.steps)
    for i, (j, name) in enumerate(with_all_free.model.coordinates):
        if name == "scale":
            out[j] = spread[i]
    return out


def identify_servos(
    recording: Recording,
    notify: Callable[[str], None] = lambda note: None,
    keep: Callable[[ServoLaws], None] = lambda polished: None,
) -> ServoLaws:
    """The servos' laws that a recording shows: the file's where nothing is lacking, one number that
    all servos share where that explains all, else laws of joints, held against whole trials.

    Args:
        notify: Called with what is done.
        keep: Called with what has been found so far, its errors those of the trials that were
            fitted.
    """
    notify("whole trials by the file")
    file = [s.law for s in recording.servos]
    problems = joint_problems(recording, [imposed_motion(t) for t in recording.trials], file)
    trials = whole_trials(recording, problems)
    finer = in_fine_steps(trials, file)
    file, before = _with_friction(finer, file)
    moving_joints = [j for j, p in enumerate(problems) if _is_moving(recording, j)]
    if file_laws := _nothing_lacking(finer, file, before, moving_joints):
        error = file_laws.errors
        return ServoLaws(finer.recording, file_laws, (), error, error, finer)
    notify("one number that all servos share")
    polished, instead = one_shared(trials, file, STEP_NAMES), ()
    if polished is None:
        model = _joint_by_joint(trials, file, moving_joints, notify)
        if _run_away(trials, model, moving_joints):
            trials, model = _or_stretches(trials, model, file, moving_joints, notify)
            before = trials.errors([file])[0]
        trials = in_fine_steps(trials, model.laws)
        polished, instead = _of_whole_trials(trials, model, file, notify)
        file = [law._replace(sharp=polished.model.laws[0].sharp) for law in file]

    def keep_model(model: PolishedLaws, members: Sequence[LawMember]) -> None:
        remaining = tuple(m for m in members if not m.refuted)
        keep(ServoLaws(recording, model, remaining, before, model.errors, trials, instead))

    polished, members = _remove_refuted(trials, polished, file, notify, keep_model)
    if not_better := _not_followed_better(trials, before, polished, members):
        polished = polish_laws(
            trials, remove_coordinates(trials, polished, not_better, file), rounds=2
        )
        polished, members = _remove_refuted(trials, polished, file, notify, keep_model)
    notify("whole trials in finer steps")
    polished = polish_laws(trials, polished.model)
    finer = in_fine_steps(trials, polished.model.laws)
    if finer is not trials:
        polished = polish_laws(finer, polished.model, rounds=4)
    after = held_out_errors(finer, polished)
    shows = [f(finer, polished) for f in (gain_shown, damping_shown, scale_shown)]
    return ServoLaws(finer.recording, polished, members, before, after, finer, instead, *shows)


def _run_away(trials: WholeTrials, model: FittedServos, joints: Sequence[int]) -> bool:
    """Whether a joint, fitted by itself, is far from where it was measured."""
    far = (error_over_noise(trials.problems[j], model.laws[j]) for j in joints)
    return max(far, default=0.0) > CLOSED_LOOP.runaway


def _or_stretches(
    trials: WholeTrials,
    model: FittedServos,
    file: Sequence[ServoLaw],
    moving_joints: Sequence[int],
    notify: Callable[[str], None],
) -> tuple[WholeTrials, FittedServos]:
    """Short stretches in the place of whole trials, and the servos fitted to them, where these are
    followed far better: errors that grow along a trial hide the law.
    """
    recording = trials.recording.in_pieces_of(CLOSED_LOOP.stretch)
    if any(t.begins for t in recording.trials):
        return trials, model  # joints that others move have no start of their own
    problems = joint_problems(recording, [imposed_motion(t) for t in recording.trials], file)
    stretches = whole_trials(recording.cut(), problems)
    notify("stretches, for joints run away from whole trials")
    new_model = _joint_by_joint(stretches, file, moving_joints, notify)
    logs = [
        np.log([error_over_noise(t.problems[j], m.laws[j]) for j in moving_joints])
        for t, m in ((trials, model), (stretches, new_model))
    ]
    if np.mean(logs[0] - logs[1]) < CLOSED_LOOP.calmer:
        return trials, model
    return stretches, new_model


def in_fine_steps(trials: WholeTrials, laws: Sequence[ServoLaw]) -> WholeTrials:
    """Whole trials in steps that are halved until this moves no joint of these laws by what
    counts.
    """
    error, finest = trials.errors([laws])[0], trials.recording.step * 0.5**CLOSED_LOOP.halvings
    while trials.recording.whole_step > 1.5 * finest:
        finer = replace(trials, recording=trials.recording.restepped(0.5))
        coarse_error, error = error, finer.errors([laws])[0]
        if not _is_moved(trials, coarse_error, error):
            break
        trials = finer
    return trials


def _is_moved(trials: WholeTrials, coarse_error: np.ndarray, error: np.ndarray) -> bool:
    """Whether finer steps move a joint by what counts beside the noise and what is left."""
    moved, left = over_noise(trials, error - coarse_error), over_noise(trials, error)
    return bool((moved > CLOSED_LOOP.stepped * np.maximum(left, 1.0)).any())


def _nothing_lacking(
    trials: WholeTrials, file: Sequence[ServoLaw], before: np.ndarray, moving_joints: Sequence[int]
) -> PolishedLaws | None:
    """The file's laws where they leave no more than noise at the joints that move, at once or with
    how a simulator steps; else None.

    Args:
        before: Errors [rows, n] rad that they leave at once.
    """
    fits = tuple(LawFit(law, ()) for law in file)
    if over_noise(trials, before)[moving_joints].max(initial=0.0) < CLOSED_LOOP.lacks_nothing:
        return polish_laws(trials, FittedServos(fits), rounds=0)
    polished = polish_laws(trials, FittedServos(fits, STEP_NAMES))
    if over_noise(trials, polished.errors)[moving_joints].max() < CLOSED_LOOP.lacks_nothing:
        return polished
    return None


def _joint_by_joint(
    trials: WholeTrials,
    file: Sequence[ServoLaw],
    moving_joints: Sequence[int],
    notify: Callable[[str], None],
) -> FittedServos:
    """Laws fitted to pieces of single joints, with numbers that all joints share."""
    problems, fits = trials.problems, {j: LawFit(law, ()) for j, law in enumerate(file)}
    moving_problems = [problems[j] for j in moving_joints]
    notify("servos, joint by joint")
    fits |= zip(
        moving_joints,
        parallel_map(lambda p: _begin_fit(p, file[0].sharp), moving_problems),
        strict=True,
    )
    if all(
        error_over_noise(p, fits[j].law) < CLOSED_LOOP.shown
        for p, j in zip(moving_problems, moving_joints, strict=True)
    ):
        return FittedServos(tuple(fits.values()))
    shared: list[str] = []
    notify("targets that are late")
    new_fits, attempts = late_targets(moving_problems, [fits[j] for j in moving_joints])
    if passed := [a for a in attempts if a.passes]:
        shared.append(max(passed, key=lambda a: a.gain).name)
        fits |= zip(moving_joints, new_fits, strict=True)
    fits, shared = _grow_laws(trials.recording, problems, moving_joints, fits, shared, notify)
    shared_values = {n: getattr(fits[moving_joints[0]].law, n) for n in shared}
    all_fits = [
        fits[j] if j in moving_joints else fits[j].of(fits[j].law._replace(**shared_values))
        for j in fits
    ]
    return FittedServos(tuple(all_fits), tuple(shared))


def _of_whole_trials(
    trials: WholeTrials,
    model: FittedServos,
    file: Sequence[ServoLaw],
    notify: Callable[[str], None],
) -> tuple[PolishedLaws, tuple[int, ...]]:
    """Laws fitted to whole trials, each explanation held against its rivals; joints as of
    `ServoLaws.instead`.
    """
    notify("whole trials")
    has_delay = any(n in DELAY_NAMES for n in model.shared)
    step_names = [n for n in STEP_NAMES if n != "shift" or not has_delay]
    model = replace(model, shared=(*model.shared, *step_names))
    polished = polish_laws(trials, with_mass(trials.recording, model), apart=True)
    polished = or_other_friction(trials, polished)
    polished = or_other_scale(trials, or_plain(trials, polished, file))
    file = [law._replace(sharp=polished.model.laws[0].sharp) for law in file]
    polished = or_files_gain(trials, or_stepped(trials, polished, file), file)
    polished = or_rival(trials, polished, file)
    polished, instead = or_heavier(trials, polished, file)
    return polish_laws(trials, polished.model), instead


def _with_friction(
    trials: WholeTrials, laws: Sequence[ServoLaw]
) -> tuple[list[ServoLaw], np.ndarray]:
    """The laws with dry friction that holds still or that creeps as MuJoCo's does, whichever leaves
    less of whole trials, and what these leave.
    """
    both_laws = [
        [law._replace(sharp=z) for law in laws] for z in (laws[0].sharp, 1.0 - laws[0].sharp)
    ]
    if not any(law.rub for law in laws):
        return both_laws[0], trials.errors(both_laws[:1])[0]
    all_errors = trials.errors(both_laws)
    log_errors = [float(np.log(over_noise(trials, e)).sum()) for e in all_errors]
    best = int(log_errors[1] < log_errors[0] - CLOSED_LOOP.gain)
    return both_laws[best], all_errors[best]


def _is_moving(recording: Recording, j: int) -> bool:
    span = max(float(np.ptp(t.q[:, j])) for t in recording.trials)
    return span > CLOSED_LOOP.moving * recording.noise[j]


def _begin_fit(problem: JointProblem, sharp: float) -> LawFit:
    """kp, damping and friction, with a limit where that is better. sharp: as of `ServoLaw`."""
    fit = fit_from_grid(problem, problem.servo.law._replace(sharp=sharp))
    if error_over_noise(problem, fit.law) < CLOSED_LOOP.enough:
        return fit
    return fit_with_limit(problem, fit)


def _grow_laws(recording, problems, moving_joints, fits, shared, notify):
    """Add numbers that all joints share and numbers of one, while left-out pieces improve."""
    names = [n for n in allowed_by_all(recording) if n not in shared]
    if any(n in DELAY_NAMES for n in shared):
        names = [n for n in names if n not in DELAY_NAMES]
    are_alike = (
        len({problems[j].servo.armature for j in moving_joints}) == 1 and len(moving_joints) > 1
    )
    names = names if are_alike else [n for n in names if n != "rotor"]
    moving_problems = [problems[j] for j in moving_joints]
    for _ in range(CLOSED_LOOP.shared):
        notify("numbers that all servos share")
        best, _ = one_more_shared(moving_problems, [fits[j] for j in moving_joints], names)
        if best is None:
            break
        shared = [*shared, best.name]
        names = [n for n in names if n != best.name]
        fits = fits | dict(zip(moving_joints, best.fits, strict=True))
    notify("numbers of one servo")
    own_names = [n for n in OWN_NAMES if n not in shared]
    rows = [(problems[j], fits[j], problems[j].servo.allowed(*own_names)) for j in moving_joints]
    fits = fits | dict(
        zip(moving_joints, parallel_map(lambda row: _with_own(*row), rows), strict=True)
    )
    return fits, shared


def _with_own(problem: JointProblem, fit: LawFit, extras: Sequence[str]) -> LawFit:
    """Add numbers of this joint alone, while left-out pieces improve."""
    for _ in range(CLOSED_LOOP.own):
        for start in _likely_own(problem, fit, [n for n in extras if n not in fit.free]):
            new = fit_law(problem, start, 8)
            if is_preferred(problem, fit, new):
                fit = new
                break
        else:
            break
    return fit


def _likely_own(problem: JointProblem, fit: LawFit, names: Sequence[str]) -> list[LawFit]:
    """Starts with one number more, likeliest first: by one step, or from several limits."""
    before, starts = score(problem, sum_squares(problem, fit.law)), []
    smooth_names = [n for n in names if n != "limit"]
    if smooth_names:
        linear = linearise(problem, LawFit(fit.law, (*fit.free, *smooth_names)))
        hess, slope = linear.normal()
        k = len(fit.free)
        for i, name in enumerate(smooth_names):
            indices = [*range(k), k + i]
            step = -solve(hess[np.ix_(indices, indices)], slope[indices])
            free = (*fit.free, name)
            for share in (1.0, 0.4):
                law = step_law(problem.servo, problem.scales, fit.law, free, share * step)
                starts.append(LawFit(law, free))
    if "limit" in names:
        usual_force = fit.law.kp * np.abs(problem.scales.error) * 3.0
        for share in (0.15, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95):
            for inside in (0.0, 1.0):
                law = fit.law._replace(limit=share * usual_force, inside=inside)
                starts.append(LawFit(law, (*fit.free, "limit")))
    if not starts:
        return []
    sums = squared(errors(problem, [s.law for s in starts]))
    value = [score(problem, z) for z in sums]
    best: dict[str, tuple[float, LawFit]] = {}
    for z, start in zip(value, starts, strict=True):
        name = start.free[-1]
        if name not in best or z < best[name][0]:
            best[name] = z, start
    likely = sorted(best.values(), key=lambda b: b[0])
    return [start for z, start in likely if before - z > 0.5 * CLOSED_LOOP.gain]


def _remove_refuted(
    trials: WholeTrials,
    polished: PolishedLaws,
    file: Sequence[ServoLaw],
    notify: Callable[[str], None],
    keep_model: Callable[[PolishedLaws, Sequence[LawMember]], None],
) -> tuple[PolishedLaws, tuple[LawMember, ...]]:
    """Remove what whole trials do not bear out beside all else; returns also what stays. seen:
    called with each model and its members.
    """
    while True:
        notify("whole trials, each number returned to the file's")
        members = _members(trials, polished, file)
        keep_model(polished, members)
        refuted = [m for m in members if m.refuted]
        if not refuted:
            return polished, tuple(members)
        shared = [m for m in refuted if m.coordinates[0][0] == SHARED_BY_ALL]
        if shared:  # one at a time: each may take up what another leaves
            refuted = [min(shared, key=lambda m: m.test.gain)]
        else:
            refuted = _weakest_by_joint(refuted)
        coordinates = [c for m in refuted for c in m.coordinates]
        polished = polish_laws(
            trials, remove_coordinates(trials, polished, coordinates, file), rounds=1
        )


def _not_followed_better(
    trials: WholeTrials, before: np.ndarray, polished: PolishedLaws, members: Sequence[LawMember]
) -> list[Coordinate]:
    """Coordinates of joints that the machine, mended, follows no better than by the file, and of
    what all share where that holds of all joints together.
    """
    ratios = over_noise(trials, polished.errors) / np.maximum(over_noise(trials, before), 1e-12)
    not_better = []
    for m in members:
        joint = m.coordinates[0][0]
        share = float(np.exp(np.log(ratios).mean())) if joint == SHARED_BY_ALL else ratios[joint]
        if share > 1.0 - CLOSED_LOOP.better:
            not_better += [c for c in m.coordinates if c not in not_better]
    return not_better


def _weakest_by_joint(members: Sequence[LawMember]) -> list[LawMember]:
    """Return the weakest member of each joint."""
    best: dict[int, LawMember] = {}
    for m in members:
        joint = m.coordinates[0][0]
        if joint not in best or m.test.gain < best[joint].test.gain:
            best[joint] = m
    return list(best.values())


def _members(
    trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]
) -> list[LawMember]:
    """What may be returned, each with its test: the machine without it, one step on."""
    sets = _removable_sets(polished.model)
    machines = [remove_coordinates(trials, polished, c, file) for c in sets]
    all_errors = trials.errors([m.laws for m in machines])
    out = []
    for coordinates, error in zip(sets, all_errors, strict=True):
        joint = coordinates[0][0]
        joints = list(range(error.shape[1])) if joint == SHARED_BY_ALL else [joint]
        error_ratio = over_noise(trials, error)[joints].max()
        test = better_at(trials, error, polished.errors, joints)
        change = max(
            _change(polished.model.fits[j].law, file[j], n, trials.problems[j])
            for j, n in coordinates
        )
        out.append(LawMember(coordinates, test, float(error_ratio), change))
    return out


def _change(law: ServoLaw, file: ServoLaw, name: str, problem: JointProblem) -> float:
    """How far a number is from the file's: as a logarithm; of a rotor in what damping does within a
    step, times `CLOSED_LOOP.min_change`; of others in their units, times `CLOSED_LOOP.units`.
    """
    if name == "damping" and law.kp > 0.0:
        return float(abs(np.log(law.damping / law.kp / (file.damping / file.kp))))
    if name == "scale":
        number = "kp" if law.kp > 0.0 else "damping"
        return float(abs(np.log(getattr(law, number) / getattr(file, number))))
    if name == "limit":
        return float(abs(np.log(law.limit / file.limit))) if file.limit < OPEN else np.inf
    off = abs(getattr(law, name) - getattr(file, name))
    if name == "rotor":
        return float(off / (problem.step * law.damping) * CLOSED_LOOP.min_change)
    return float(off / problem.scales.unit(name) * CLOSED_LOOP.units)


def _removable_sets(model: FittedServos) -> list[tuple[Coordinate, ...]]:
    """Sets of coordinates that go together: the scale alone before kp and damping, which return
    together or not at all.
    """
    out: list[tuple[Coordinate, ...]] = []
    for j, fit in enumerate(model.fits):
        for name in fit.free:
            if name == "damping":
                law = [(j, n) for n in ("scale", "damping") if n in fit.free]
                out.append(tuple(law))
            else:
                out.append(((j, name),))
    shared = [n for n in model.shared if n not in (*STEP_NAMES, "reach")]
    for name in shared:
        names = CARRIED if name == "payload" else (name,)
        out.append(tuple((SHARED_BY_ALL, n) for n in names if n in model.shared))
    return out
