"""Frequencies of long trials, finer than the grid of shapes.

With half a cycle of a trial between its points, the grid of a trial of a minute would hold a thousand frequencies a place. Within
a window, which lasts a second or so, a frequency and its neighbour differ by little more than a phase: the scores of the grid's own
points, window by window, turned by that phase and summed, are those of every frequency between.
"""

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.effects.grids import FINEST
from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.score.scorer import Scorer


def frequency_of(windows: Windows, scorer: Scorer, atoms: list[Atom], alpha: float) -> float | None:
    """The frequency [Hz] between the points of the grid that explains most, each trial with a phase of its own; None where
    the grid is fine enough for trials of that length, or what is found may be chance.

    `atoms`: one periodic force each, with columns sine and cosine and a shape `frequency`.
    """
    duration = float(windows.time.max())
    if not atoms or duration <= 0.5 / FINEST:
        return None
    shift = (
        0.25 / duration * np.arange(-np.ceil(2.0 * FINEST * duration), np.ceil(2.0 * FINEST * duration) + 1)
    )  # [D] Hz
    gains = np.array([_gains(windows, scorer, atom, shift) for atom in atoms])  # [A, D]
    best, at = np.unravel_index(int(gains.argmax()), gains.shape)
    trials = len(np.unique(scorer.white.trial[scorer.white.rows > 0]))
    if float(chi2.sf(gains[best, at], 2 * trials)) * gains.size > alpha:
        return None
    return atoms[best].shape["frequency"] + float(shift[at])


def _gains(windows: Windows, scorer: Scorer, atom: Atom, shift: np.ndarray) -> np.ndarray:
    """Likelihood-ratio gain `[D]` of an atom whose frequency is shifted by `shift` Hz, amplitudes free in each trial."""
    s = scorer.columns(atom.columns)
    normal, slope = np.swapaxes(s, 1, 2) @ s, np.einsum("wmi,wm->wi", s, scorer.residual)
    middle = 0.5 * (windows.times[:, 0] + windows.times.max(1))
    cos, sin = (f(2.0 * np.pi * shift[:, None] * middle) for f in (np.cos, np.sin))
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)  # [D, W, 2, 2]
    normal = np.einsum("dwij,wik,dwkl->dwjl", turn, normal, turn, optimize=True)
    slope = np.einsum("dwij,wi->dwj", turn, slope, optimize=True)
    out = np.zeros(len(shift))
    for trial in np.unique(scorer.white.trial[scorer.white.rows > 0]):
        here = (scorer.white.trial == trial) & (scorer.white.rows > 0)
        a, b = normal[:, here].sum(1), slope[:, here].sum(1)
        a = a + (1e-9 * np.trace(a, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(2)
        out += np.einsum("di,di->d", b, np.linalg.solve(a, b[..., None])[..., 0])
    return out
