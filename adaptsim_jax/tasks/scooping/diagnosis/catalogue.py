"""What a scoop may lack beside its declared parameters: each effect with its quantities, units,
bounds, physics and excitation.
"""

from adaptsim_jax.effects.base import Quantity
from adaptsim_jax.tasks import camera_effects
from adaptsim_jax.tasks.camera_effects import quantity as _q

QUANTITIES = (
    Quantity("mu", "", 0.08, 0.8, 0.3, prior=0.72, scale=0.01),
    Quantity("log_e", "log10 Pa", 3.5, 6.5, 4.8, prior=3.0, scale=0.1),
    Quantity("h", "m", 0.011, 0.032, 0.02, prior=0.021, scale=2e-4),
    _q("speed_scale", "", -0.3, 0.3, 0.01),
    _q("lift_scale", "", -0.5, 0.5, 0.02),
    _q("pitch_offset", "rad", -0.12, 0.12, 0.003),
    _q("distance_offset", "m", -0.015, 0.02, 5e-4),
    _q("start_x", "m", -0.015, 0.02, 5e-4),
    _q("start_y", "m", -0.03, 0.03, 5e-4),
    _q("placed", "", -0.3, 1.3, 0.1),
    _q("clearance", "m", -5e-5, 1.5e-3, 3e-5),
    _q("tilt", "rad", -0.12, 0.12, 0.005),
    _q("drag", "1/s", -2.0, 12.0, 0.3),
    _q("adhesion", "m/s^2", -2.0, 20.0, 0.5),
    _q("blade_friction", "", -0.7, 2.0, 0.05),
    _q("shift_z", "m", -0.05, 0.05, 1e-3),
    *camera_effects.QUANTITIES,
)
"""Those that are declared have bounds wider than Omega: a piece outside of it is no effect that the
model lacks.
"""
CAMERA = ("start_y", "shift_z", *(q.name for q in camera_effects.QUANTITIES))
"""Quantities that no simulation depends on."""
_E = camera_effects.effect_of(QUANTITIES)
_ALL = ("mu", "log_e", "h")
EFFECTS = (
    _E(
        "speed_scale",
        "command",
        ("speed_scale",),
        "the blade runs faster or slower than commanded, by a share",
        "any scoop",
    ),
    _E(
        "lift_scale",
        "command",
        ("lift_scale",),
        "the blade pitches up faster or slower than commanded, by a share",
        "scoops that end on the blade, seen from the side",
    ),
    _E(
        "pitch_offset",
        "command",
        ("pitch_offset",),
        "the blade is pitched more or less than commanded, from the start",
        "pitches over a wide range",
        look_alikes=_ALL,
    ),
    _E(
        "distance_offset",
        "command",
        ("distance_offset",),
        "the blade starts farther from the piece or nearer than commanded",
        "any scoop",
    ),
    _E(
        "place_offset",
        "command",
        ("start_x", "start_y"),
        "the piece lies elsewhere than declared, always by as much",
        "any scoop",
    ),
    _E(
        "placement",
        "command",
        ("placed",),
        "the piece is put down where the first rows of each track show it, not where declared",
        "places that differ",
    ),
    _E(
        "clearance",
        "contact",
        ("clearance",),
        "the blade slides higher over the table than declared, or lower",
        "low pitches, pieces with a flat bottom",
        look_alikes=_ALL,
    ),
    _E(
        "blade_friction",
        "contact",
        ("blade_friction",),
        "the blade is rougher or smoother to the piece than the table, by a share",
        "scoops that end on the blade and others that do not",
        look_alikes=("mu",),
    ),
    _E(
        "adhesion",
        "contact",
        ("adhesion",),
        "the piece sticks to the blade on which it lies",
        "scoops that end on the blade",
        look_alikes=("mu",),
    ),
    _E(
        "tilt",
        "force",
        ("tilt",),
        "the table rises or falls along the motion",
        "pieces that slide freely",
        look_alikes=("mu",),
    ),
    _E(
        "drag",
        "force",
        ("drag",),
        "a viscous friction on the table",
        "slow and fast sliding",
        look_alikes=("mu",),
    ),
    *camera_effects.effects("scoop", "the middle of the places", rises=True),
)
HEIGHT = _E(
    "height",
    "piece",
    ("h",),
    "the piece is higher or lower than declared",
    "any scoop, best seen from the side",
)
SHIFTS = tuple(q for axis in "xyz" for q in QUANTITIES if q.name == f"shift_{axis}")
"""Of `camera_shift` where heights are seen, too."""
SHAPE = _E(
    "shape",
    "piece",
    (),
    "the piece moves like one of another shape than declared",
    "pieces that roll or slide",
)
