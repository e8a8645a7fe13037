"""Phases of trials: a disturbance that goes on between trials meets each of them at another phase.

A periodic force has one frequency and amplitude in a recording, but where its trials were started by hand, a phase of its
own in each. That phase is a nuisance of the trial, as its initial state is: it is found from the linear scores of one
frequency trial by trial, and then held as a shift of that trial's clock.
"""

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.score.scorer import Scorer


def by_trial(scorer: Scorer, atom: Atom) -> tuple[float, dict[int, np.ndarray]]:
    """Gain and amplitudes `{trial: [2]}` of an atom with amplitudes of its own in each trial."""
    s = scorer.columns(atom.columns)
    normal = np.swapaxes(s, 1, 2) @ s
    slope = np.einsum("wmi,wm->wi", s, scorer.residual)
    gain, amplitude = 0.0, {}
    for trial in np.unique(scorer.white.trial[scorer.white.rows > 0]):
        here = (scorer.white.trial == trial) & (scorer.white.rows > 0)
        a, b = normal[here].sum(0), slope[here].sum(0)
        amplitude[int(trial)] = np.linalg.solve(a + 1e-9 * np.trace(a) * np.eye(len(b)) + 1e-12 * np.eye(len(b)), b)
        gain += float(b @ amplitude[int(trial)])
    return gain, amplitude


def clocks(windows: Windows, scorer: Scorer, atoms: list[Atom], criteria: Criteria) -> np.ndarray | None:
    """Clock shifts `[N]` s that make one periodic force (atoms: sine and cosine at each frequency and joint) coherent
    over the trials; None where one phase for all does as well, or nothing is there.

    The clock is at the found phase in the middle of a trial, so that a better frequency moves it little.
    """
    trials = np.unique(scorer.white.trial[scorer.white.rows > 0])
    if len(trials) < 2 or not atoms:
        return None
    tried = [by_trial(scorer, a) for a in atoms]
    best = int(np.argmax([gain for gain, _ in tried]))
    gain, amplitude = tried[best]
    common = max(scorer.gain(a.columns)[0] for a in atoms)
    chance = min(1.0, float(chi2.sf(gain, 2 * len(trials))) * len(atoms))
    if chance > criteria.alpha or gain - common < 2.0 * criteria.price * (len(trials) - 1) + 12.0:
        return None
    speed = 2.0 * np.pi * atoms[best].shape["frequency"]
    clock = np.zeros_like(windows.clock)
    for trial, (sine, cosine) in amplitude.items():
        middle = 0.5 * float(windows.time[trial].max())
        phase = np.angle(np.exp(1j * (speed * middle + np.arctan2(cosine, sine))))
        clock[trial] = phase / speed - middle
    return clock
