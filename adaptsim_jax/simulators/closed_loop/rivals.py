"""Explanations that pieces of single joints hardly tell apart, held against each other over whole
trials.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import LawFit
from adaptsim_jax.simulators.closed_loop.imposed import Recording
from adaptsim_jax.simulators.closed_loop.law import SHARED, ServoLaw
from adaptsim_jax.simulators.closed_loop.polish import (
    FittedServos,
    Polished,
    WholeTrials,
    over_noise,
    polished,
)
from adaptsim_jax.simulators.closed_loop.shared import LATE


def allowed_by_all(recording: Recording) -> list[str]:
    """Numbers that all joints may share."""
    names = [n for n in SHARED if all(s.allowed(n) for s in recording.servos)]
    return [n for n in names if n != "payload" or recording.hand >= 0]


def with_payload(whole: WholeTrials, found: Polished) -> Polished:
    """With a mass at the hand free as well: pieces of single joints take it for other scales."""
    shared = found.model.shared
    if "payload" not in allowed_by_all(whole.recording) or {"payload", "lift"} & {*shared}:
        return found
    if not found.model.coordinates:
        return found
    return polished(whole, replace(found.model, shared=(*shared, "payload")), rounds=3)


RIVALS = (("lift", "payload"), ("payload", "lift"), ("delay", "lag"), ("lag", "delay"))
"""Shared numbers that pieces of single joints hardly tell apart: whole trials decide."""


def or_rival(whole: WholeTrials, found: Polished, file: Sequence[ServoLaw]) -> Polished:
    """The servos with a shared number's rival in its place, where that leaves less."""
    for name, other in RIVALS:
        shared = found.model.shared
        if name not in shared or other in shared or other not in allowed_by_all(whole.recording):
            continue
        fits = []
        for fit, law in zip(found.model.fits, file, strict=True):
            value = getattr(fit.law, name) if other in LATE else getattr(law, other)
            fits.append(fit.of(fit.law._replace(**{name: getattr(law, name), other: value})))
        names = tuple(other if n == name else n for n in shared)
        rival = polished(whole, FittedServos(tuple(fits), names))
        if left_over(whole, rival) < left_over(whole, found) - CLOSED_LOOP.gain:
            return rival
    return found


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
    shared = tuple(dict.fromkeys((*model.shared, "payload")))
    rival = polished(whole, FittedServos(tuple(fits), shared), rounds=8)
    if left_over(whole, rival) < left_over(whole, found) + CLOSED_LOOP.gain:
        return rival, joints
    return found, ()


def _same_ratio(law: ServoLaw, file: ServoLaw) -> bool:
    """Whether damping over kp is the file's."""
    off = np.log(law.damping / law.kp / (file.damping / file.kp))
    return bool(abs(off) < CLOSED_LOOP.min_change)
