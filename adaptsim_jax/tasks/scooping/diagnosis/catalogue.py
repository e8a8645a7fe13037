"""What a scoop may lack beside its declared parameters: each effect with its quantities, units,
bounds, physics and excitation, as `catalogue.toml` has them.
"""

from pathlib import Path

from adaptsim_jax.tasks import camera_effects

_OWN, _TABLE = camera_effects.read_table(Path(__file__).with_suffix(".toml"))
QUANTITIES = (*_OWN, *camera_effects.QUANTITIES)
CAMERA = ("start_y", "shift_z", *(q.name for q in camera_effects.QUANTITIES))
"""Quantities that no simulation depends on."""
*_ALWAYS, HEIGHT, SHAPE = camera_effects.effects_of(_TABLE, QUANTITIES)
EFFECTS = (*_ALWAYS, *camera_effects.effects("scoop", "the middle of the places", rises=True))
SHIFTS = tuple(q for axis in "xyz" for q in QUANTITIES if q.name == f"shift_{axis}")
"""Of `camera_shift` where heights are seen, too."""
