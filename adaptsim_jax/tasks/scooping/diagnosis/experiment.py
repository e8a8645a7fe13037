"""The scoops that tell the members of a class apart: of a grid of actions those whose tracks they
predict most differently.
"""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.diagnosis.passes import Found
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import executed, places, poses

PITCHES, RATES, DISTANCES, SCOOPS = 4, 3, 3, 3
COPIES = 4
# times what the copies of a scoop and the camera scatter by, between members, of a scoop worth
# making
SEPARATION = 3.0
PLACE = (0.03, 0.02)  # m: away from the middle, where a scale and a turn show


def informative_scoops(scooped: Scooped, found: Found) -> dict[str, Any] | None:
    """message, separates (names) and rows (place m, pitch rad, rate rad/s, distance m), none where
    no scoop of the grid tells.

    None where nothing that was named has look-alikes.
    """
    pairs = [
        (n, other, m)
        for n in found.selection.named
        for other, m in zip(n.alternatives, n.models, strict=True)
    ]
    if not pairs:
        return None
    ends = zip(model.ACTION_LOW, model.ACTION_HIGH, (PITCHES, RATES, DISTANCES), strict=True)
    grid = np.array(list(product(*(np.linspace(*end) for end in ends))))
    count, time = len(grid), np.arange(0.0, model.SECONDS, 1 / 60)
    many = replace(
        scooped,
        actions=grid,
        starts=np.tile(PLACE, (count, 1)),
        aside=np.zeros((count, 2)),
        time=np.tile(time, (count, 1)),
        places=np.zeros((count, len(time), scooped.places.shape[-1])),
    )

    def text(values):
        """Mean and scatter `[count, R, C]` over copies."""
        trials = np.repeat(np.arange(count), COPIES)
        every = np.tile(values, (len(trials), 1))
        actions = grid[trials] + executed(scooped, len(trials))
        out = places(many, every, poses(many, found.shape, every, trials, actions), trials)
        out = out.reshape(count, COPIES, *out.shape[1:])
        return out.mean(1), out.std(1)

    own, scatter = text(found.selection.final.fit.values)
    scores, sizes = [], []
    for _, _, m in pairs:
        other, wide = text(m.fit.values)
        distance = np.abs(other - own)
        clear = distance / np.sqrt(scooped.noise**2 + np.square(scatter) + np.square(wide))
        scores.append(np.sqrt(np.square(clear).sum(-1)).max(1))
        sizes.append(np.sqrt(np.square(distance).sum(-1)).max(1))
    worst = int(np.argmin([s.max() for s in scores]))
    n, other, _ = pairs[worst]
    names, score = [n.candidate.name, other.name], scores[worst]
    words = f"{names[0].replace('_', ' ')} and {names[1].replace('_', ' ')}"
    if score.max() < SEPARATION:
        given = (
            f"No scoop within the bounds tells {words} apart: tracks differ by {score.max():.1f} "
            "times what scoops scatter by"
        )
        return {
            "message": f"{given}, at most. Measure one of them by itself.",
            "separates": names,
            "rows": [],
        }
    order = np.argsort(-score)[:SCOOPS]
    size = 1e3 * sizes[worst][order[0]]
    return {
        "message": f"Scoops whose tracks differ most, by up to {size:.2g} mm, between {words}.",
        "separates": names,
        "rows": [(*PLACE, *map(float, grid[i])) for i in order],
    }
