"""Explanations that pieces of single joints hardly tell apart, held against each other over whole
trials.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import LawFit
from adaptsim_jax.simulators.closed_loop.imposed import Recording
from adaptsim_jax.simulators.closed_loop.law import SHARED, ServoLaw, moved
from adaptsim_jax.simulators.closed_loop.polish import (
    SHARED_BY_ALL,
    FittedServos,
    Polished,
    WholeTrials,
    over_noise,
    polished,
    without,
)
from adaptsim_jax.simulators.closed_loop.shared import LATE


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
    """With a mass at the hand free as well, and its place: pieces of single joints take it for
    other scales.
    """
    known = "payload" in allowed_by_all(recording) and "lift" not in model.shared
    if not known or not model.coordinates:
        return model
    fits = model.fits
    if "payload" not in model.shared:
        fits = tuple(f.of(f.law._replace(reach=CLOSED_LOOP.tool)) for f in fits)
    return FittedServos(fits, tuple(dict.fromkeys((*model.shared, *CARRIED))))


def _rival(whole: WholeTrials, model: FittedServos, found: Polished) -> Polished:
    """Other servos fitted to whole trials; a few rounds alone where these leave far more than what
    was found.
    """
    rival = polished(whole, model, rounds=3)
    if left_over(whole, rival) > left_over(whole, found) + CLOSED_LOOP.hopeless:
        return rival
    return polished(whole, rival.model, rounds=5)


def or_rival(whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]) -> Polished:
    """The servos with a shared number's rival in its place, where that leaves less."""
    for names, others in RIVALS:
        shared, known = found.model.shared, allowed_by_all(whole.recording)
        if names[0] not in shared or others[0] in shared or others[0] not in known:
            continue
        fits = []
        for fit, law in zip(found.model.fits, file, strict=True):
            own = {n: getattr(law, n) for n in (*names, *others)}
            if others[0] in LATE:
                own[others[0]] = getattr(fit.law, names[0])
            if others is CARRIED:
                own["reach"] = CLOSED_LOOP.tool
            fits.append(fit.of(fit.law._replace(**own)))
        rest = tuple(n for n in shared if n not in names)
        rival = _rival(whole, FittedServos(tuple(fits), (*others, *rest)), found)
        if left_over(whole, rival) < left_over(whole, found) - CLOSED_LOOP.gain:
            return rival
    return found


def or_other_friction(whole: WholeTrials, found: Polished) -> Polished:
    """With dry friction that creeps as MuJoCo's does, or that holds still, where that leaves less
    once all else is fitted with it.
    """
    if not any(law.rub for law in found.model.laws):
        return found
    fits = tuple(f.of(f.law._replace(sharp=1.0 - f.law.sharp)) for f in found.model.fits)
    rival = polished(whole, replace(found.model, fits=fits), rounds=2)
    if left_over(whole, rival) < left_over(whole, found) - CLOSED_LOOP.gain:
        return rival
    return found


def or_plain(whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]) -> Polished:
    """Without gravity fed forward and what single joints were given beside their law, where a mass
    at the hand does as well: pieces of single joints do not know of it.
    """
    model = found.model
    more = [(j, n) for j, f in enumerate(model.fits) for n in f.free if n not in OF_LAW]
    more += [(SHARED_BY_ALL, "lift")] * ("lift" in model.shared)
    if not more or "payload" not in model.shared:
        return found
    start = without(whole, found, more, file)
    fits = tuple(f.of(f.law._replace(reach=CLOSED_LOOP.tool)) for f in start.fits)
    rival = _rival(whole, replace(start, fits=fits), found)
    payload = rival.model.laws[0].payload
    if payload > 0.0 and left_over(whole, rival) < left_over(whole, found) + CLOSED_LOOP.gain:
        return rival
    return found


def or_stepped(whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]) -> Polished:
    """Without any rotor, where damping that acts at another time in a step does as well."""
    rotors = [(j, "rotor") for j, f in enumerate(found.model.fits) if "rotor" in f.free]
    if not rotors:
        return found
    rival = _rival(whole, without(whole, found, rotors, file), found)
    if left_over(whole, rival) < left_over(whole, found) + CLOSED_LOOP.gain:
        return rival
    return found


def or_other_scale(whole: WholeTrials, found: Polished) -> Polished:
    """With servos of single joints times another factor, where that leaves less of whole trials:
    where motion hardly shows the scale, a limit or an end of friction's range may hold it.
    """
    model, sizes = found.model, (0.0, *CLOSED_LOOP.scales)
    joints = range(len(model.fits))
    machines = [[_scaled(whole, model, j, z) for j in joints] for z in sizes]
    left = np.array([over_noise(whole, e) for e in whole.errors(machines)])
    best = left.argmin(0)
    best[np.log(left[0] / left.min(0)) < CLOSED_LOOP.gain] = 0
    if not best.any():
        return found
    fits = tuple(f.of(machines[best[j]][j]) for j, f in enumerate(model.fits))
    rival = _rival(whole, replace(model, fits=fits), found)
    return min((found, rival), key=lambda f: left_over(whole, f))


def _scaled(whole: WholeTrials, model: FittedServos, j: int, z: float) -> ServoLaw:
    """The law of a joint with all that was fitted of its servo times e^z; the same where its scale
    is not fitted.
    """
    fit, p = model.fits[j], whole.problems[j]
    step = np.array([z * (name == "scale") for name in fit.free])
    return moved(p.servo, p.scales, fit.law, fit.free, step)


def left_over(whole: WholeTrials, found: Polished) -> float:
    """Logarithm of what is left of whole trials over the noise, summed over joints."""
    return float(np.log(over_noise(whole, found.errors)).sum())


def or_heavier(
    whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]
) -> tuple[Polished, tuple[int, ...]]:
    """A mass that is carried in the place of kp and damping that are the file's times one factor,
    where whole trials are simulated as well, by fewer numbers; and the joints whose gains say the
    same.
    """
    model = found.model
    joints = tuple(
        j
        for j, (fit, law) in enumerate(zip(model.fits, file, strict=True))
        if "scale" in fit.free and law.kp > 0.0 and _same_ratio(fit.law, law)
    )
    if not joints or "payload" not in allowed_by_all(whole.recording):
        return found, ()
    fits = list(model.fits)
    for j in joints:
        law, free = fits[j].law, tuple(n for n in fits[j].free if n not in ("scale", "damping"))
        fits[j] = LawFit(law._replace(kp=file[j].kp, damping=file[j].damping), free)
    if "payload" not in model.shared:
        fits = [f.of(f.law._replace(reach=CLOSED_LOOP.tool)) for f in fits]
    shared = tuple(dict.fromkeys((*model.shared, *CARRIED)))
    rival = _rival(whole, FittedServos(tuple(fits), shared), found)
    if left_over(whole, rival) < left_over(whole, found) + CLOSED_LOOP.gain:
        return rival, joints
    return found, ()


def or_files_gain(whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]) -> Polished:
    """With the file's kp where motion is cut by a limit, which hardly shows kp: where that leaves
    less, all else as it was and fitted from there.
    """
    cut = [j for j, f in enumerate(found.model.fits) if {"scale", "limit"} <= {*f.free}]
    if not cut:
        return found
    fits = list(found.model.fits)
    for j in cut:
        fits[j] = fits[j].of(fits[j].law._replace(kp=file[j].kp))
    rival = _rival(whole, replace(found.model, fits=tuple(fits)), found)
    return min((found, rival), key=lambda f: left_over(whole, f))


def gain_shown(whole: WholeTrials, found: Polished) -> tuple[bool, ...]:
    """Whether whole trials show kp at each joint, damping and limit as they are."""
    laws = found.model.laws
    return _shown(whole, found, lambda j, z: laws[j]._replace(kp=laws[j].kp * np.exp(z)))


def scale_shown(whole: WholeTrials, found: Polished) -> tuple[bool, ...]:
    """Whether they show the scale of all that was fitted of each joint's servo together."""
    return _shown(whole, found, lambda j, z: _scaled(whole, found.model, j, z))


def _shown(
    whole: WholeTrials, found: Polished, other: Callable[[int, float], ServoLaw]
) -> tuple[bool, ...]:
    """Whether each joint is simulated worse by another law of its servo: by `other(joint, z)`, in
    either direction of z, the logarithm of a factor.
    """
    laws, joints, z = found.model.laws, range(len(found.model.laws)), np.log(CLOSED_LOOP.other_gain)
    tried = [(j, way) for j in joints if "scale" in found.model.fits[j].free for way in (z, -z)]
    every = whole.errors(
        [[other(j, way) if i == j else law for i, law in enumerate(laws)] for j, way in tried]
    )
    here, worse = over_noise(whole, found.errors), dict.fromkeys(joints, np.inf)
    for (j, _), error in zip(tried, every, strict=True):
        worse[j] = min(worse[j], 2.0 * np.log(over_noise(whole, error)[j] / here[j]))
    return tuple(worse[j] > CLOSED_LOOP.clearly for j in joints)


def one_shared(
    whole: WholeTrials, file: Sequence[ServoLaw], stepped: Sequence[str]
) -> Polished | None:
    """The file's laws with one number that all joints share (a delay, a filter, a mass at the hand,
    gravity fed forward), where nothing that is left could show another.

    Args:
        stepped: How a simulator steps, fitted with it.
    """
    known, found = allowed_by_all(whole.recording), []
    for names in (CARRIED, ("lift",), ("delay",), ("lag",)):
        if names[0] not in known:
            continue
        rest = [n for n in stepped if n != "shift" or names[0] not in LATE]
        reach = CLOSED_LOOP.tool if names is CARRIED else 0.0
        fits = tuple(LawFit(law._replace(reach=reach), ()) for law in file)
        model = FittedServos(fits, (*names, *rest))
        for part in (whole.first(CLOSED_LOOP.brief), whole):
            begun = polished(part, model, rounds=3)
            model = begun.model
            if over_noise(part, begun.errors).max() > CLOSED_LOOP.hopeful:
                break
        else:
            found.append(polished(whole, model))
    best = min(found, key=lambda f: left_over(whole, f), default=None)
    if best is None or over_noise(whole, best.errors).max() > CLOSED_LOOP.shown:
        return None
    return best


def _same_ratio(law: ServoLaw, file: ServoLaw) -> bool:
    """Whether damping over kp is the file's."""
    off = np.log(law.damping / law.kp / (file.damping / file.kp))
    return bool(abs(off) < CLOSED_LOOP.min_change)
