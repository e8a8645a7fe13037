"""Double-precision Riccati solutions against SciPy's over random systems and the paper's settings.

    python benchmarks/riccati_accuracy.py [count]

Prints the largest relative difference (Frobenius) per family, to which the bar of 1e-8 applies.
SciPy solves by an ordered Schur form, so what remains is both methods' rounding, which the
conditioning of the system scales.
"""

import sys
from collections.abc import Callable, Iterator

import jax
import numpy as np
import scipy.linalg as sl

from adaptsim_jax.control.riccati import solve_care
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized

SETTINGS = {
    "wd": (1.8, 1.2, 1.5, 1.5),
    "ood-1": (1.8, 0.3, 1.5, 1.5),
    "ood-2": (0.5, 1.8, 1.5, 1.5),
    "ood-3": (1.2, 1.8, 10.0, 10.0),
    "ood-4": (0.4, 2.6, 1.0, 2.0),
}


def random_systems(rng: np.random.Generator, count: int, n: int, m: int) -> tuple:
    """Gaussian A, B; `Q = C'C`, C Gaussian; R with eigenvalues from 0.1 up."""
    A, B = rng.normal(size=(count, n, n)), rng.normal(size=(count, n, m))
    C, D = rng.normal(size=(count, n, n)), rng.normal(size=(count, m, m))
    return A, B, np.swapaxes(C, 1, 2) @ C, np.swapaxes(D, 1, 2) @ D + 0.1 * np.eye(m)


def pendulum_systems(params: np.ndarray) -> tuple:
    """The paper's CARE at `params: [count, 4]`; call with x64 enabled."""
    A, B = (np.asarray(x) for x in jax.vmap(linearized)(params))
    return A, B, np.tile(np.eye(4), (len(params), 1, 1)), np.tile(np.eye(2), (len(params), 1, 1))


def families(count: int) -> Iterator[tuple[str, Callable, Callable, tuple]]:
    """`(name, our solver, SciPy's, systems)`: `count` systems in all, and the paper's five
    settings.
    """
    rng = np.random.default_rng(0)
    care = solve_care, sl.solve_continuous_are
    share = count // 10
    wide = rng.uniform([0.3, 0.3, 0, 0], [3, 3, 10, 10], (4 * share, 4))
    yield "CARE, settings wd, ood-1..4", *care, pendulum_systems(np.array(list(SETTINGS.values())))
    yield "CARE, pendulum m 0.3..3, b 0..10", *care, pendulum_systems(wide)
    for n, m in ((2, 1), (4, 2), (6, 3)):
        yield f"CARE, random {n} states, {m} inputs", *care, random_systems(rng, share, n, m)


def differences(ours: Callable, theirs: Callable, systems: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Relative differences `[count]` and our result codes `[count]`."""
    solution = jax.jit(jax.vmap(ours))(*systems)
    reference = np.array([theirs(*system) for system in zip(*systems, strict=True)])
    gap = np.linalg.norm(np.asarray(solution.P) - reference, axis=(1, 2))
    return gap / np.linalg.norm(reference, axis=(1, 2)), np.asarray(solution.code)


def main(count: int = 10_000) -> None:
    print(
        f"{'family':36s} {'systems':>8s} {'largest':>9s} {'99 %':>9s} {'median':>9s}  codes 0, 1, "
        "2, 3"
    )
    worst = 0.0
    with jax.enable_x64(True):
        for name, ours, theirs, systems in families(count):
            gap, code = differences(ours, theirs, systems)
            worst = max(worst, gap.max())
            numbers = f"{gap.max():9.1e} {np.quantile(gap, 0.99):9.1e} {np.median(gap):9.1e}"
            print(
                f"{name:36s} {len(gap):8d} {numbers}  {np.bincount(code, minlength=4).tolist()}",
                flush=True,
            )
    print(f"largest of all: {worst:.1e}; the bar is 1e-8: {'met' if worst < 1e-8 else 'MISSED'}")


if __name__ == "__main__":
    main(*(int(x) for x in sys.argv[1:2]))
