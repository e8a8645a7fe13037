"""What a toss may lack beside its declared contact: each effect with its quantities, units, bounds,
physics and excitation, as `catalogue.toml` has them.
"""

import math
from pathlib import Path

from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.tasks.camera_effects import effects_of, read_table
from adaptsim_jax.tasks.toss.body import TossedBody

DECLARED = ("friction", "log_time", "damping")
CHUNKED = ("speed_friction", "grain_a", "grain_b", "rebound")
"""What depends on the motion: set anew every few ms of a simulation."""
OWN, _TABLE = read_table(Path(__file__).with_suffix(".toml"))
EFFECTS = effects_of(_TABLE, OWN)


def quantities(body: TossedBody) -> tuple[Quantity, ...]:
    """The declared numbers, which begin where the file has them, and those of the effects."""
    shortest = math.log10(2.0 * body.step)  # MuJoCo takes no shorter time constant
    begin = max(math.log10(body.contact_time), shortest)
    return (
        Quantity("friction", "", 0.0, 1.5, body.friction, prior=3.0, scale=0.01),
        Quantity("log_time", "log10 s", shortest, -1.3, begin, prior=2.0, scale=0.05),
        Quantity("damping", "", 0.02, 3.0, body.damping, prior=3.0, scale=0.05),
        *OWN,
    )


def effects(body: TossedBody) -> tuple[Effect, ...]:
    """The effects that this body can have: shapes without a size cannot be scaled."""
    return tuple(e for e in EFFECTS if body.sized or e.name != "body_size")
