"""The slide in converged steps as a twin of Drake: its coefficients fitted to whole tracks of
random pushes, the other half judges.

    python -m experiments.slide_twin --samples 160 --seed 8820

Prints the coefficients (`adaptsim_jax.tasks.pushing.slide.DRAKE`) and distances along the push in
mm, before and after. Drake makes about ten pushes a second on two idle cores, the fit takes a few
seconds.
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from adaptsim_jax.tasks.pushing import model, planar, slide
from adaptsim_jax.tasks.pushing.engines import make_backend

OPTIONS = model.PushOptions(duration=1.4)
ROWS = np.arange(21, 140, 3)  # of 10 ms; nothing is touched before
ALLOWED = 5e-3  # m; beyond it a distance counts by its size and not by its square
ASIDE = np.array([0.01] * 3 + [0.02] * 6 + [0.01])


def along(xy, actions):
    """Distance `[..., T]` m from the start along the push, of places `[..., T, 2]`."""
    heading = jnp.stack([jnp.cos(actions[..., 1]), jnp.sin(actions[..., 1])], -1)
    return ((xy - jnp.asarray(model.START)) * heading[..., None, :]).sum(-1)


def flat(c: planar.PlanarCoefficients) -> np.ndarray:
    return np.array(
        [*c.elasticity.frequency, *c.elasticity.damping, *c.elasticity.speed, c.lift, c.sole]
    )


@jax.jit
@jax.vmap
def simulated(c, params, action):
    """Distance along the push `[len(ROWS)]` m."""
    elasticity = model.ElasticityMap(tuple(c[:3]), tuple(c[3:6]), tuple(c[6:8]))
    values: dict[str, Any] = dict(zip(model.PARAMETERS, params, strict=True))
    rows = slide.rollout(values, action, OPTIONS, planar.PlanarCoefficients(elasticity, c[8], c[9]))
    return along(rows[2::2][ROWS, :2], action)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=160)
    parser.add_argument("--seed", type=int, default=8820)
    args = parser.parse_args()
    params, actions, starts = model.draw(args.seed, args.samples)
    found = make_backend("drake", OPTIONS).simulate(params, actions, starts)
    truth = np.asarray(along(found.state[:, ROWS, :2], actions), float)
    half = args.samples // 2

    def run(vectors: np.ndarray, part: slice) -> np.ndarray:
        """`[K, n * rows]` m for coefficients `[K, 10]`."""
        count = len(params[part])
        rows = (
            np.repeat(vectors, count, 0),
            *(np.tile(a[part], (len(vectors), 1)) for a in (params, actions)),
        )
        return np.asarray(simulated(*(a.astype(np.float32) for a in rows)), float).reshape(
            len(vectors), -1
        )

    def residual(c: np.ndarray) -> np.ndarray:
        return (run(c[None], slice(half))[0] - truth[:half].reshape(-1)) / ALLOWED

    def columns(c: np.ndarray) -> np.ndarray:
        moved = run(np.concatenate([c + np.diag(ASIDE), c - np.diag(ASIDE)]), slice(half))
        return ((moved[: len(c)] - moved[len(c) :]) / (2 * ASIDE[:, None] * ALLOWED)).T

    def told(name: str, c: np.ndarray) -> None:
        apart = 1e3 * np.abs(
            run(c[None], slice(half, None))[0].reshape(-1, len(ROWS)) - truth[half:]
        )
        touching = apart[:, (ROWS >= 28) & (ROWS < 42)]
        print(
            f"{name:14s} while the plate touches RMS {np.sqrt((touching**2).mean()):.1f} mm; end: "
            f"median {np.median(apart[:, -1]):.1f}, 90 % {np.quantile(apart[:, -1], 0.9):.1f} mm"
        )

    jac: Any = columns
    fit = least_squares(residual, flat(planar.DRAKE), jac, loss="soft_l1", max_nfev=25)
    print("frequency, damping, speed, lift, sole:", fit.x.round(3).tolist())
    for name, c in (
        ("planar.DRAKE", flat(planar.DRAKE)),
        ("slide.DRAKE", flat(slide.DRAKE)),
        ("as fitted", fit.x),
    ):
        told(name, c)


if __name__ == "__main__":
    main()
