"""The pushes that tell the members of a class apart: of a grid of actions those whose tracks they
predict most differently.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.diagnosis.problem import simulated
from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed

SPEEDS, ANGLES, PUSHES = 5, 13, 3
SEPARATION = 3.0  # times the camera's noise, between members, of a push worth making


def informative_pushes(pushed: Pushed, found: Finding) -> dict[str, Any] | None:
    """message, separates (names) and rows (speed m/s, angle rad), none where no push of the grid
    tells them apart.

    None where nothing that was named has look-alikes.
    """
    pairs = [
        (n, other, m)
        for n in found.named
        for other, m in zip(n.alternatives, n.models, strict=True)
    ]
    if not pairs:
        return None
    grid = np.stack(
        np.meshgrid(
            np.linspace(model.ACTION_LOW[0], model.ACTION_HIGH[0], SPEEDS),
            np.linspace(model.ACTION_LOW[1], model.ACTION_HIGH[1], ANGLES),
            indexing="ij",
        ),
        -1,
    ).reshape(-1, 2)
    time = np.arange(0.0, 1.3, 1 / 60)
    many = replace(
        pushed,
        actions=grid,
        starts=np.tile(model.START, (len(grid), 1)),
        aside=np.zeros((len(grid), 2)),
        time=np.tile(time, (len(grid), 1)),
    )

    def text(m):
        return simulated(
            many, pushed.options, pushed.coefficients, np.tile(m.fit.values, (len(grid), 1))
        )

    own, sizes = text(found.final), pushed.sizes / pushed.noise
    distance = np.array(
        [np.sqrt(np.square((text(m) - own) / sizes).sum(-1).max(1)) for _, _, m in pairs]
    )
    most = distance.max(1)
    shown = (
        most >= SEPARATION * pushed.noise
    )  # a scale of lengths may be a parallax as well, whatever is pushed
    i = int(np.argmin(np.where(shown | ~shown.any(), most, np.inf)))
    n, other, _ = pairs[i]
    names, score = [n.candidate.name, other.name], distance[i]
    words = f"{names[0].replace('_', ' ')} and {names[1].replace('_', ' ')}"
    if pushed.yaw is None:
        trials = f"{1e3 * score.max():.2g} mm"
    else:
        trials = f"{score.max() / pushed.noise:.2g} times the noise"
    if score.max() < SEPARATION * pushed.noise:
        return {
            "message": f"No push within the bounds tells {words} apart: their tracks differ by "
            f"{trials} at most. Measure one of them "
            "by itself.",
            "separates": names,
            "rows": [],
        }
    order = np.argsort(-score)[:PUSHES]
    return {
        "message": f"Pushes whose tracks differ most, by up to {trials}, between {words}.",
        "separates": names,
        "rows": [tuple(map(float, grid[i])) for i in order],
    }
