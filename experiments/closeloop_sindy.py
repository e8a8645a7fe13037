"""The PySINDy row of `closeloop_peers`: an ensemble of sparse regressions on the torque that the declared model lacks.

As a user of that library would do it (Fasel et al., 2022): a library of functions of the measured motion, one for each
effect that can be written as one, the residual torque of each joint as the target, STLSQ over bootstrapped rows, and
what most members keep is named. Run by itself (`python closeloop_sindy.py IN.npz OUT.json`) it is the regression alone and
needs NumPy and PySINDy, so the library may live in an environment of its own.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

THRESHOLD = 0.1  # least coefficient, in standard deviations of the target, columns being of unit size
KEPT = 0.6  # least share of the ensemble that keeps a column
MEMBERS = 20
MOST = 3  # effects, as in the search that it is compared with


def library(x: np.ndarray, u: np.ndarray, t: np.ndarray, dt: np.ndarray, j: int) -> dict[tuple[str, str], np.ndarray]:
    """`{(effect, term): [W, L]}` at joint j of states `[W, L+1, S]`, torque `[W, L, U]`, times `[W, L+1]` s. The effect `""`
    is what the declared model may do itself; memories, delays of sensors and base tilt are no function of the motion."""
    n, step = u.shape[2], np.where(dt > 0, dt, 1.0)
    middle, at = 0.5 * (x[:, 1:] + x[:, :-1]), t[:, :-1] + 0.5 * dt
    q, v, u = middle[..., j], middle[..., n + j], u[..., j]
    live = dt > 0
    top, low, high = np.quantile(np.abs(v[live]), 0.9), *np.quantile(q[live], [0.1, 0.9])
    out = {
        ("", "v"): v, ("", "sin q"): np.sin(q), ("", "cos q"): np.cos(q),
        ("coulomb", "sign v"): np.sign(v),
        ("stribeck", "sign v, slow"): np.sign(v) * np.exp(-((v / (0.1 * top)) ** 2)),
        ("quadratic_drag", "v |v|"): v * np.abs(v), ("spring", "q"): q, ("bias", "1"): np.ones_like(q),
        ("torque_gain", "u"): u, ("load_friction", "|u| sign v"): np.abs(u) * np.sign(v),
        ("dead_zone", "sign u"): np.sign(u), ("saturation", "u^3"): u**3,
        ("delay", "du/dt"): np.gradient(u, axis=1) / step,
        ("rotor_inertia", "dv/dt"): np.diff(x[..., n + j], axis=1) / step,
        ("friction_drift", "v, fading"): v * np.exp(-4 * at / at[live].max()),
        ("hard_stop", "above"): np.maximum(q - high, 0.0), ("hard_stop", "below"): np.maximum(low - q, 0.0),
    }  # fmt: skip
    waves = [("cogging", f"{k} q", k * q) for k in range(2, 13)]
    waves += [("periodic_disturbance", f"{f:g} Hz", 2 * np.pi * f * at) for f in np.arange(0.5, 10.1, 0.5)]
    for effect, term, phase in waves:
        out[effect, f"sin {term}"], out[effect, f"cos {term}"] = np.sin(phase), np.cos(phase)
    return out


def named(view, force: np.ndarray, live: np.ndarray, python: str, seed: int = 0) -> list[tuple[str, str]]:
    """Effects that the ensemble names, the largest first. force `[W, n, L]` N m; live `[W, L]` rows that count."""
    path, sizes = view.path, {}
    for j in range(force.shape[1]):
        terms = library(path.x, path.u, path.time, path.dt, j)
        columns = np.stack([z[live] for z in terms.values()], 1)
        scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
        y = force[:, j][live]
        coefficients = regression(columns / scale, y / (np.std(y) + 1e-12), python, seed)
        for (effect, _), c in zip(terms, coefficients, strict=True):
            if effect and c:
                sizes[effect, f"joint{j + 1}"] = max(sizes.get((effect, f"joint{j + 1}"), 0.0), abs(c) * np.std(y))
    return sorted(sizes, key=lambda e: -sizes[e])[:MOST]


def regression(columns: np.ndarray, y: np.ndarray, python: str, seed: int) -> list[float]:
    """Median coefficient of each column, 0 where too few members keep it; run by `python`, which has PySINDy."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "in.npz", Path(folder) / "out.json"
        np.savez(given, columns=columns, y=y, seed=seed)
        subprocess.run([python, __file__, str(given), str(found)], check=True, capture_output=True)
        return json.loads(found.read_text())


def absent(python: str) -> str | None:
    """Why there is no PySINDy row; None where there can be one."""
    test = subprocess.run([python, "-c", "import pysindy"], capture_output=True, text=True)
    if test.returncode == 0:
        return None
    return f"pysindy row skipped: {python} cannot import it ({test.stderr.strip().splitlines()[-1]}); see --pysindy"


def main() -> None:
    from pysindy.optimizers import STLSQ, EnsembleOptimizer

    given = np.load(sys.argv[1])
    np.random.seed(int(given["seed"]))  # noqa: NPY002 (the library draws its bootstraps from NumPy's global state)
    optimizer = EnsembleOptimizer(STLSQ(threshold=THRESHOLD, alpha=1e-3), bagging=True, n_models=MEMBERS)
    optimizer.fit(given["columns"], given["y"][:, None])
    members = np.array(optimizer.coef_list).reshape(MEMBERS, -1)
    kept = np.mean(members != 0, axis=0) >= KEPT
    Path(sys.argv[2]).write_text(json.dumps(np.where(kept, np.median(members, axis=0), 0.0).tolist()))


if __name__ == "__main__":
    main()
