"""What a push may lack beside its declared parameters: each effect with its quantities, units,
bounds, physics and excitation, as `catalogue.toml` has them.
"""

import math
from pathlib import Path

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.tasks import camera_effects

DECLARED = ("mu", "log_e", "mu_p", "y_p")
_OWN, _TABLE = camera_effects.read_table(Path(__file__).with_suffix(".toml"))
QUANTITIES = (*_OWN, *camera_effects.QUANTITIES)
EFFECTS = (
    *camera_effects.effects_of(_TABLE, QUANTITIES),
    *camera_effects.effects("push", "the arm's base", rises=False),
)


def effects_of(yaw: bool) -> tuple[Effect, ...]:
    """The effects of tracks with a measured yaw or without: places alone hardly show that a bottle
    turns at a patch's edge.
    """
    return tuple(e for e in EFFECTS if yaw or e.name != "turning")


def physical(values: dict) -> dict:
    """Values as `slide.rollout` takes them: `e` in Pa."""
    return {**values, "e": 10.0 ** values["log_e"]}


def grain(a: float, b: float) -> tuple[float, float]:
    """Ratio of friction across by along the grain, and the grain's direction in rad from x, of
    `grain_a`, `grain_b`.
    """
    size = min(math.hypot(a, b), 0.999)
    ratio = math.sqrt((1 + size) / (1 - size))
    along = 0.5 * math.atan2(b, a) + math.pi / 2
    return ratio, (along + math.pi / 2) % math.pi - math.pi / 2
