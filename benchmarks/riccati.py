"""Speed of our CARE in batches against SciPy's in a loop, on the pendulum's 4-state systems, side
by side.

python benchmarks/riccati.py
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg as sl

from adaptsim_jax.control.riccati import solve_care
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized


def best_time(work: Callable[[], object], repeats: int) -> float:
    """Shortest of `repeats` wall times, in s: the others only add what else the machine was
    doing.
    """
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(work())
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    params = (
        np.random.default_rng(0)
        .uniform([0.3, 0.3, 0, 0], [3, 3, 10, 10], (1000, 4))
        .astype(np.float32)
    )
    A, B = jax.vmap(linearized)(jnp.asarray(params))
    Q, R = np.eye(4), np.eye(2)
    A64, B64 = np.asarray(A, float), np.asarray(B, float)

    def scipy_loop() -> object:
        return [
            sl.solve_continuous_are(a, b, Q, R) for a, b in zip(A64[:200], B64[:200], strict=True)
        ]

    scipy_each = best_time(scipy_loop, 5) / 200
    print(
        f"scipy.linalg.solve_continuous_are in a loop: {1e6 * scipy_each:.1f} us a system (float64)"
    )
    Qj, Rj = jnp.eye(4), jnp.eye(2)
    solver = jax.jit(jax.vmap(lambda a, b: solve_care(a, b, Qj, Rj).P))
    for count in (1, 10, 100, 256, 1000):
        a, b = A[:count], B[:count]
        start = time.perf_counter()
        jax.block_until_ready(solver(a, b))
        first = time.perf_counter() - start
        each = best_time(lambda a=a, b=b: solver(a, b), 100) / count
        ratio = scipy_each / each
        print(
            f"ours, batch {count:5d}: {1e6 * each:7.2f} us a system (float32), {ratio:6.1f} times "
            f"SciPy; first call {first:.2f} s"
        )


if __name__ == "__main__":
    main()
