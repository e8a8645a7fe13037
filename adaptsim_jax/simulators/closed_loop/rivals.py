"""Explanations that pieces of single joints hardly tell apart, held against each other over whole
trials.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import LawFit
from adaptsim_jax.simulators.closed_loop.imposed import Recording
from adaptsim_jax.simulators.closed_loop.law import SHARED, ServoLaw, step_law
from adaptsim_jax.simulators.closed_loop.polish import (
    SHARED_BY_ALL,
    FittedServos,
    PolishedLaws,
    WholeTrials,
    over_noise,
    polish_laws,
    remove_coordinates,
)
from adaptsim_jax.simulators.closed_loop.shared import DELAY_NAMES


def allowed_by_all(recording: Recording) -> list[str]:
    """Numbers that all joints may share."""
    names = [n for n in SHARED if all(s.allowed(n) for s in recording.servos)]
    return [n for n in names if n != "payload" or recording.hand >= 0]


CARRIED = ("payload", "reach")
"""Of a mass at the hand."""
OF_LAW = ("scale", "damping", "rub", "limit")
"""Of a joint's servo itself."""
RIVALS = (
    (("lift",), CARRIED),
    (CARRIED, ("lift",)),
    (("delay",), ("lag",)),
    (("lag",), ("delay",)),
)
"""Shared numbers that pieces of single joints hardly tell apart: whole trials decide."""


def with_mass(recording: Recording, model: FittedServos) -> FittedServos:
    """Free a mass at the hand as well, and its place: pieces of single joints take it for
    other scales.
    """
    has_payload = "payload" in allowed_by_all(recording) and "lift" not in model.shared
    if not has_payload or not model.coordinates:
        return model
    fits = model.fits
    if "payload" not in model.shared:
        fits = tuple(f.of(f.law._replace(reach=CLOSED_LOOP.tool)) for f in fits)
    return FittedServos(fits, tuple(dict.fromkeys((*model.shared, *CARRIED))))


def fitted_rival(trials: WholeTrials, model: FittedServos, polished: PolishedLaws) -> PolishedLaws:
    """Fit other servos to whole trials, in a few rounds alone where these leave far more than what
    was found.
    """
    rival = polish_laws(trials, model, rounds=3, apart=True)
    if log_error(trials, rival) > log_error(trials, polished) + CLOSED_LOOP.hopeless:
        return rival
    return polish_laws(trials, rival.model, rounds=5, apart=True)


def or_rival(trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]) -> PolishedLaws:
    """The servos with a shared number's rival in its place, where that leaves less."""
    for names, others in RIVALS:
        shared, allowed = polished.model.shared, allowed_by_all(trials.recording)
        if names[0] not in shared or others[0] in shared or others[0] not in allowed:
            continue
        fits = []
        for fit, law in zip(polished.model.fits, file, strict=True):
            numbers = {n: getattr(law, n) for n in (*names, *others)}
            if others[0] in DELAY_NAMES:
                numbers[others[0]] = getattr(fit.law, names[0])
            if others is CARRIED:
                numbers["reach"] = CLOSED_LOOP.tool
            fits.append(fit.of(fit.law._replace(**numbers)))
        other_shared = tuple(n for n in shared if n not in names)
        rival = fitted_rival(trials, FittedServos(tuple(fits), (*others, *other_shared)), polished)
        if log_error(trials, rival) < log_error(trials, polished) - CLOSED_LOOP.gain:
            return rival
    return polished


def or_other_friction(trials: WholeTrials, polished: PolishedLaws) -> PolishedLaws:
    """Take dry friction that holds still, or that creeps as MuJoCo's does where that leaves less
    once all else is fitted with it.
    """
    if not any(law.rub for law in polished.model.laws):
        return polished
    fits = tuple(f.of(f.law._replace(sharp=1.0 - f.law.sharp)) for f in polished.model.fits)
    rival = fitted_rival(trials, replace(polished.model, fits=fits), polished)
    both = {p.model.laws[0].sharp: p for p in (polished, rival)}
    if log_error(trials, both[0.0]) < log_error(trials, both[1.0]) - CLOSED_LOOP.gain:
        return both[0.0]
    return both[1.0]


def or_plain(trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]) -> PolishedLaws:
    """Drop gravity fed forward and what single joints were given beside their law, where a mass
    at the hand, or targets that come late, do as well: pieces of single joints do not know of
    the one, and hardly tell the other from a rotor.
    """
    model = polished.model
    additions = [(j, n) for j, f in enumerate(model.fits) for n in f.free if n not in OF_LAW]
    additions += [(SHARED_BY_ALL, "lift")] * ("lift" in model.shared)
    if not additions:
        return polished
    plain = remove_coordinates(trials, polished, additions, file)
    best, to_beat = polished, log_error(trials, polished) + CLOSED_LOOP.gain
    for names in _plain_rivals(trials, plain):
        rival = fitted_rival(trials, _with_shared(plain, names), polished)
        if getattr(rival.model.laws[0], names[0]) > 0.0 and log_error(trials, rival) < to_beat:
            best, to_beat = rival, log_error(trials, rival)
    return best


def _plain_rivals(trials: WholeTrials, model: FittedServos) -> list[tuple[str, ...]]:
    """What all joints may share in the place of numbers of their own."""
    allowed = allowed_by_all(trials.recording)
    names = [CARRIED] if "payload" in model.shared else []
    if not any(n in DELAY_NAMES for n in model.shared):
        names += [(n,) for n in DELAY_NAMES if n in allowed]
    return names


def _with_shared(model: FittedServos, names: tuple[str, ...]) -> FittedServos:
    """Free shared numbers as well, from where fits begin; a delay takes the place of a shift."""
    if names == CARRIED:
        start, instead = {"reach": CLOSED_LOOP.tool}, ()
    else:
        start, instead = {names[0]: CLOSED_LOOP.usual_delay, "shift": 0.0}, ("shift",)
    fits = tuple(f.of(f.law._replace(**start)) for f in model.fits)
    shared = tuple(n for n in dict.fromkeys((*model.shared, *names)) if n not in instead)
    return FittedServos(fits, shared)


def or_stepped(
    trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]
) -> PolishedLaws:
    """Drop all rotors, where damping that acts at another time in a step does as well."""
    rotors = [(j, "rotor") for j, f in enumerate(polished.model.fits) if "rotor" in f.free]
    if not rotors:
        return polished
    rival = fitted_rival(trials, remove_coordinates(trials, polished, rotors, file), polished)
    if log_error(trials, rival) < log_error(trials, polished) + CLOSED_LOOP.gain:
        return rival
    return polished


def or_other_scale(trials: WholeTrials, polished: PolishedLaws) -> PolishedLaws:
    """Multiply servos of single joints by another factor, where that leaves less of whole trials:
    where motion hardly shows the scale, a limit or an end of friction's range may hold it.
    """
    model, sizes = polished.model, (0.0, *CLOSED_LOOP.scales)
    joints = range(len(model.fits))
    machines = [[_scaled(trials, model, j, z) for j in joints] for z in sizes]
    ratios = np.array([over_noise(trials, e) for e in trials.errors(machines)])
    best = ratios.argmin(0)
    best[np.log(ratios[0] / ratios.min(0)) < CLOSED_LOOP.gain] = 0
    if not best.any():
        return polished
    fits = tuple(f.of(machines[best[j]][j]) for j, f in enumerate(model.fits))
    rival = fitted_rival(trials, replace(model, fits=fits), polished)
    return min((polished, rival), key=lambda p: log_error(trials, p))


def _scaled(trials: WholeTrials, model: FittedServos, j: int, z: float) -> ServoLaw:
    """The law of a joint with all that was fitted of its servo times e^z; the same where its scale
    is not fitted.
    """
    fit, p = model.fits[j], trials.problems[j]
    step = np.array([z * (name == "scale") for name in fit.free])
    return step_law(p.servo, p.scales, fit.law, fit.free, step)


def log_error(trials: WholeTrials, polished: PolishedLaws) -> float:
    """Logarithm of what is left of whole trials over the noise, summed over joints."""
    return float(np.log(over_noise(trials, polished.errors)).sum())


def or_heavier(
    trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]
) -> tuple[PolishedLaws, tuple[int, ...]]:
    """A mass that is carried in the place of kp and damping that are the file's times one factor,
    where whole trials are simulated as well, by fewer numbers; and the joints whose gains say the
    same.
    """
    model = polished.model
    joints = tuple(
        j
        for j, (fit, law) in enumerate(zip(model.fits, file, strict=True))
        if "scale" in fit.free and law.kp > 0.0 and _same_ratio(fit.law, law)
    )
    if not joints or "payload" not in allowed_by_all(trials.recording):
        return polished, ()
    fits = list(model.fits)
    for j in joints:
        law, free = fits[j].law, tuple(n for n in fits[j].free if n not in ("scale", "damping"))
        fits[j] = LawFit(law._replace(kp=file[j].kp, damping=file[j].damping), free)
    if "payload" not in model.shared:
        fits = [f.of(f.law._replace(reach=CLOSED_LOOP.tool)) for f in fits]
    shared = tuple(dict.fromkeys((*model.shared, *CARRIED)))
    rival = fitted_rival(trials, FittedServos(tuple(fits), shared), polished)
    if log_error(trials, rival) < log_error(trials, polished) + CLOSED_LOOP.gain:
        return rival, joints
    return polished, ()


def or_files_gain(
    trials: WholeTrials, polished: PolishedLaws, file: Sequence[ServoLaw]
) -> PolishedLaws:
    """Take the file's kp where motion is cut by a limit, which hardly shows kp: where that leaves
    less, all else as it was and fitted from there.
    """
    limited_joints = [
        j for j, f in enumerate(polished.model.fits) if {"scale", "limit"} <= {*f.free}
    ]
    if not limited_joints:
        return polished
    fits = list(polished.model.fits)
    for j in limited_joints:
        fits[j] = fits[j].of(fits[j].law._replace(kp=file[j].kp))
    rival = fitted_rival(trials, replace(polished.model, fits=tuple(fits)), polished)
    return min((polished, rival), key=lambda f: log_error(trials, f))


def gain_shown(trials: WholeTrials, polished: PolishedLaws) -> tuple[bool, ...]:
    """Whether whole trials show kp at each joint, damping and limit as they are."""
    laws = polished.model.laws
    return _is_shown(trials, polished, lambda j, z: laws[j]._replace(kp=laws[j].kp * np.exp(z)))


def damping_shown(trials: WholeTrials, polished: PolishedLaws) -> tuple[bool, ...]:
    """Whether they show damping at each joint, kp and limit as they are."""
    laws = polished.model.laws

    def other(j: int, z: float) -> ServoLaw:
        return laws[j]._replace(damping=laws[j].damping * np.exp(z))

    return _is_shown(trials, polished, other)


def scale_shown(trials: WholeTrials, polished: PolishedLaws) -> tuple[bool, ...]:
    """Whether they show the scale of all that was fitted of each joint's servo together."""
    return _is_shown(trials, polished, lambda j, z: _scaled(trials, polished.model, j, z))


def _is_shown(
    trials: WholeTrials, polished: PolishedLaws, other: Callable[[int, float], ServoLaw]
) -> tuple[bool, ...]:
    """Whether each joint is simulated worse by another law of its servo: by `other(joint, z)`, in
    either direction of z, the logarithm of a factor.
    """
    laws, joints, z = (
        polished.model.laws,
        range(len(polished.model.laws)),
        np.log(CLOSED_LOOP.other_gain),
    )
    changes = [
        (j, direction)
        for j in joints
        if "scale" in polished.model.fits[j].free
        for direction in (z, -z)
    ]
    changed_errors = trials.errors(
        [
            [other(j, direction) if i == j else law for i, law in enumerate(laws)]
            for j, direction in changes
        ]
    )
    error_now, least_increase = over_noise(trials, polished.errors), dict.fromkeys(joints, np.inf)
    for (j, _), error in zip(changes, changed_errors, strict=True):
        least_increase[j] = min(
            least_increase[j], 2.0 * np.log(over_noise(trials, error)[j] / error_now[j])
        )
    return tuple(least_increase[j] > CLOSED_LOOP.clearly for j in joints)


def one_shared(
    trials: WholeTrials, file: Sequence[ServoLaw], step_names: Sequence[str]
) -> PolishedLaws | None:
    """The file's laws with one number that all joints share (a delay, a filter, a mass at the hand,
    gravity fed forward), where nothing that is left could show another.

    Args:
        step_names: How a simulator steps, fitted with it.
    """
    allowed, candidates = allowed_by_all(trials.recording), []
    for names in (CARRIED, ("lift",), ("delay",), ("lag",)):
        if names[0] not in allowed:
            continue
        free_step_names = [n for n in step_names if n != "shift" or names[0] not in DELAY_NAMES]
        reach = CLOSED_LOOP.tool if names is CARRIED else 0.0
        fits = tuple(LawFit(law._replace(reach=reach), ()) for law in file)
        model = FittedServos(fits, (*names, *free_step_names))
        for part in (trials.first(CLOSED_LOOP.brief), trials):
            rough = polish_laws(part, model, rounds=3)
            model = rough.model
            if over_noise(part, rough.errors).max() > CLOSED_LOOP.hopeful:
                break
        else:
            candidates.append(polish_laws(trials, model))
    best = min(candidates, key=lambda f: log_error(trials, f), default=None)
    if best is None or over_noise(trials, best.errors).max() > CLOSED_LOOP.shown:
        return None
    return best


def _same_ratio(law: ServoLaw, file: ServoLaw) -> bool:
    """Whether damping over kp is the file's."""
    off = np.log(law.damping / law.kp / (file.damping / file.kp))
    return bool(abs(off) < CLOSED_LOOP.min_change)
