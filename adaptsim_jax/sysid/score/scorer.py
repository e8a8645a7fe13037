"""How much of the residual each candidate explains, beyond what the declared parameters can, and how sure that is.

Works on whitened, initial-state-free rows (`variance.whiten`): every fit, every held-out trial and every subset of
candidates is then a small linear solve. Candidate columns are projected orthogonal to the declared Jacobian first
(Rao's efficient score); what vanishes there is confounded with declared parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.estimate.variance import Whitened


@dataclass(frozen=True)
class Score:
    """One subset of atoms fitted together with the declared parameters, linearised."""

    atoms: tuple[Atom, ...]
    gain: float  # fall of the whitened sum of squares: a likelihood ratio, chi-square under no effect
    robust: float  # Wald statistic from the windows' own scatter
    freedom: int
    amplitude: np.ndarray
    p_value: float  # of the smaller of gain and robust, uncorrected
    held_out_gain: float  # fall of the whitened sum of squares on folds that were not fitted, over all folds
    held_out_share: float  # the same as a share of the held-out sum of squares without the subset
    retained: float  # largest share of a column's norm that survives the projection off the declared Jacobian


def _ridge(matrix: np.ndarray) -> np.ndarray:
    return matrix + np.diag(1e-9 * np.diag(matrix) + 1e-12)


class Scorer:
    """Scores subsets of atoms against one whitened linearisation.

    fold `[W]`: fold of each window, -1 for padding. Inner products are taken for the columns asked for, when asked.
    """

    def __init__(self, white: Whitened, fold: np.ndarray):
        self.white, self.fold = white, fold
        j, z = white.jac_theta, white.atoms
        normal = np.tensordot(j, j, ((0, 1), (0, 1)))
        seen = (np.swapaxes(j, 1, 2) @ z).sum(0)
        # `[P, K]`: what the declared parameters take of each column
        self._absorbed = np.linalg.solve(_ridge(normal), seen)
        self.residual = white.residual - j @ np.linalg.solve(_ridge(normal), np.einsum("wmi,wm->i", j, white.residual))
        before = np.einsum("wmk,wmk->k", z, z)
        after = before - np.sum(self._absorbed * (2.0 * seen - normal @ self._absorbed), axis=0)
        self.retained = np.where(before > 1e-12, np.maximum(after, 0.0) / np.maximum(before, 1e-30), 0.0)
        self.sum_squares = float(np.sum(self.residual**2))
        self.freedom = int(white.rows.sum()) - j.shape[2]

    def columns(self, columns: Sequence[int]) -> np.ndarray:
        """Atom columns `[W, M, k]` orthogonal to the declared Jacobian."""
        at = list(columns)
        return self.white.atoms[:, :, at] - self.white.jac_theta @ self._absorbed[:, at]

    def gain(self, columns: Sequence[int]) -> tuple[float, np.ndarray]:
        """Likelihood-ratio gain and amplitudes of a set of atom columns."""
        s = self.columns(columns)
        slope = np.einsum("wmi,wm->i", s, self.residual, optimize=True)
        amplitude = np.linalg.solve(_ridge(np.einsum("wmi,wmj->ij", s, s, optimize=True)), slope)
        return float(slope @ amplitude), amplitude

    def robust(self, columns: Sequence[int], amplitude: np.ndarray) -> float:
        """Wald statistic whose variance comes from the scatter of the windows' scores about the fit."""
        s = self.columns(columns)
        scores = np.einsum("wmi,wm->wi", s, self.residual - s @ amplitude, optimize=True)
        live = int((self.white.rows > 0).sum())
        spread = scores.T @ scores * live / max(live - len(amplitude), 1)
        pull = np.einsum("wmi,wmj->ij", s, s, optimize=True) @ amplitude
        return float(pull @ np.linalg.solve(_ridge(spread), pull))

    def held_out(self, columns: Sequence[int]) -> tuple[float, float]:
        """Sum of squares on left-out folds without and with the columns, everything refitted on the others."""
        z = np.concatenate([self.white.jac_theta, self.white.atoms[:, :, list(columns)]], -1)
        r, p = self.white.residual, self.white.jac_theta.shape[2]
        normal, slope = np.swapaxes(z, 1, 2) @ z, np.einsum("wmi,wm->wi", z, r)
        without, with_ = 0.0, 0.0
        for f in np.unique(self.fold[self.fold >= 0]):
            test, train = self.fold == f, (self.fold >= 0) & (self.fold != f)
            a, b = _ridge(normal[train].sum(0)), slope[train].sum(0)
            without += float(np.sum((r[test] - z[test][:, :, :p] @ np.linalg.solve(a[:p, :p], b[:p])) ** 2))
            with_ += float(np.sum((r[test] - z[test] @ np.linalg.solve(a, b)) ** 2))
        return without, with_

    def score(self, atoms: Sequence[Atom], *, dispersion: float = 1.0) -> Score:
        """Everything about one subset; `dispersion` divides the gain (residual variance left by the best model)."""
        columns = [c for a in atoms for c in a.columns]
        gain, amplitude = self.gain(columns)
        robust = self.robust(columns, amplitude)
        p = float(chi2.sf(min(gain / dispersion, robust), len(columns)))
        without, with_ = self.held_out(columns)
        share = (without - with_) / max(without, 1e-30)
        retained = float(np.max(self.retained[columns]))
        return Score(tuple(atoms), gain, robust, len(columns), amplitude, p, without - with_, share, retained)

    def best_shape(self, atoms: Sequence[Atom], beside: Sequence[Atom] = ()) -> Atom:
        """Of one candidate's shapes the one that explains most beside `beside`; the declared sign is preferred."""
        fixed = [c for a in beside for c in a.columns]

        def merit(atom: Atom) -> float:
            gain, amplitude = self.gain([*fixed, *atom.columns])
            wrong = atom.sign and np.sign(amplitude[len(fixed)]) != atom.sign
            return gain * (0.2 if wrong else 1.0)

        return max(atoms, key=merit)
