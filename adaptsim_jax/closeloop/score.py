"""How much of the residual each candidate explains, beyond what the declared parameters can, and how sure that is.

Works on whitened, initial-state-free rows (`disturbance.whiten`), through one Gram matrix a window: every fit, every
held-out trial and every subset of candidates is then a small linear solve. Candidate columns are projected orthogonal
to the declared Jacobian first (Rao's efficient score); what vanishes there is confounded with declared parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.closeloop.disturbance import Whitened


@dataclass(frozen=True)
class Atom:
    """One candidate at fixed shape, linear in its amplitudes: columns of the atom matrix."""

    effect: str
    where: str
    shape: dict[str, float]
    columns: tuple[int, ...]
    sign: int = 0  # +1: the first amplitude must be positive to be that effect


@dataclass(frozen=True)
class Gram:
    """Window-wise inner products of `[theta | atoms | residual]`: `[W, C, C]`, with P declared and K atom columns."""

    windows: np.ndarray
    trial: np.ndarray
    rows: np.ndarray
    declared: int

    @property
    def residual(self) -> int:
        return self.windows.shape[1] - 1

    def total(self, keep: np.ndarray | None = None) -> np.ndarray:
        return (self.windows if keep is None else self.windows[keep]).sum(0)


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
    retained: float  # least share of an atom's norm that survives the projection off the declared Jacobian


def gram(white: Whitened) -> Gram:
    """Inner products per window of declared Jacobian, atom columns and residual."""
    z = np.concatenate([white.jac_theta, white.atoms, white.residual[..., None]], -1).astype(np.float64)
    return Gram(np.swapaxes(z, 1, 2) @ z, white.trial, white.rows, white.jac_theta.shape[2])


def folds(trial: np.ndarray, rows: np.ndarray, *, least: int = 3, blocks: int = 6) -> np.ndarray:
    """Fold of each window `[W]`: one a trial, or contiguous blocks of time where there are too few trials."""
    live = np.flatnonzero(rows > 0)
    names = np.unique(trial[live])
    out = np.full(len(trial), -1)
    if len(names) >= least:
        for i, name in enumerate(names):
            out[(trial == name) & (rows > 0)] = i
        return out
    for i, part in enumerate(np.array_split(live, min(blocks, len(live)))):
        out[part] = i
    return out


def _ridge(matrix: np.ndarray) -> np.ndarray:
    return matrix + np.diag(1e-9 * np.diag(matrix) + 1e-12)


def project_declared(g: Gram) -> tuple[np.ndarray, np.ndarray]:
    """Windows' Gram matrices `[W, K+1, K+1]` after projection off the declared columns, and the retained norms `[K]`."""
    p = g.declared
    total = g.total()
    beta = np.linalg.solve(_ridge(total[:p, :p]), total[:p, p:])
    lift = np.concatenate([-beta, np.eye(total.shape[0] - p)], 0)
    projected = lift.T @ g.windows @ lift
    size = np.diag(total)[p:-1]
    retained = np.diag(projected.sum(0))[:-1] / np.maximum(size, 1e-30)
    return projected, np.where(size > 1e-12, retained, 0.0)


def _held_out(g: Gram, columns: np.ndarray, fold: np.ndarray) -> tuple[float, float]:
    """Sum of squares on left-out folds without and with the columns, everything refitted on the others."""
    base, full = np.arange(g.declared), np.concatenate([np.arange(g.declared), g.declared + columns])
    total, without, with_ = g.total(fold >= 0), 0.0, 0.0
    for f in np.unique(fold[fold >= 0]):
        test = g.total(fold == f)
        train = total - test
        without += _test_error(train, test, base)
        with_ += _test_error(train, test, full)
    return without, with_


def _test_error(train: np.ndarray, test: np.ndarray, index: np.ndarray) -> float:
    coef = np.linalg.solve(_ridge(train[np.ix_(index, index)]), train[index, -1])
    return float(test[-1, -1] - 2 * coef @ test[index, -1] + coef @ test[np.ix_(index, index)] @ coef)


class Scorer:
    """Scores subsets of atoms against one linearisation; holds nothing but inner products."""

    def __init__(self, g: Gram, fold: np.ndarray):
        self.gram, self.fold = g, fold
        self.projected, self.retained = project_declared(g)
        self.sum = self.projected.sum(0)
        self.sum_squares = float(self.sum[-1, -1])
        self.freedom = int(g.rows.sum()) - g.declared

    def gain(self, columns: Sequence[int]) -> tuple[float, np.ndarray]:
        """Likelihood-ratio gain and amplitudes of a set of atom columns."""
        c = np.asarray(columns)
        d, b = _ridge(self.sum[np.ix_(c, c)]), self.sum[c, -1]
        amplitude = np.linalg.solve(d, b)
        return float(b @ amplitude), amplitude

    def robust(self, columns: Sequence[int], amplitude: np.ndarray) -> float:
        """Wald statistic whose variance comes from the scatter of the windows' scores about the fit."""
        c = np.asarray(columns)
        scores = self.projected[:, c, -1] - self.projected[:, c][:, :, c] @ amplitude
        live = int((self.gram.rows > 0).sum())
        spread = scores.T @ scores * live / max(live - len(c), 1)
        d = self.sum[np.ix_(c, c)]
        return float((d @ amplitude) @ np.linalg.solve(_ridge(spread), d @ amplitude))

    def score(self, atoms: Sequence[Atom], *, dispersion: float = 1.0) -> Score:
        """Everything about one subset; `dispersion` divides both statistics (residual variance left by the best model)."""
        columns = [c for a in atoms for c in a.columns]
        gain, amplitude = self.gain(columns)
        robust = self.robust(columns, amplitude)
        freedom = len(columns)
        p = float(chi2.sf(min(gain / dispersion, robust), freedom))
        without, with_ = _held_out(self.gram, np.asarray(columns), self.fold)
        return Score(
            tuple(atoms), gain, robust, freedom, amplitude, p, without - with_, (without - with_) / max(without, 1e-30),
            float(np.min(self.retained[columns])),
        )  # fmt: skip

    def best_shape(self, atoms: Sequence[Atom], beside: Sequence[Atom] = ()) -> Atom:
        """Of one candidate's shapes the one that explains most beside `beside`; the declared sign is preferred."""
        fixed = [c for a in beside for c in a.columns]

        def merit(atom: Atom) -> float:
            gain, amplitude = self.gain([*fixed, *atom.columns])
            wrong = atom.sign and np.sign(amplitude[len(fixed)]) != atom.sign
            return gain * (0.2 if wrong else 1.0)

        return max(atoms, key=merit)
