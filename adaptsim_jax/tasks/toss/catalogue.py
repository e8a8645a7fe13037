"""What a toss may lack beside its declared contact: each effect with its quantities, units, bounds,
physics and excitation.
"""

import math

from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.tasks.camera_effects import effect_of
from adaptsim_jax.tasks.camera_effects import quantity as _q
from adaptsim_jax.tasks.toss.body import TossedBody

DECLARED = ("friction", "log_time", "damping")
CHUNKED = ("speed_friction", "grain_a", "grain_b", "rebound")
"""What depends on the motion: set anew every few ms of a simulation."""


OWN = (
    _q("speed_friction", "s/m", -0.9, 5.0, 0.1),
    _q("grain_a", "", -0.8, 0.8, 0.1),
    _q("grain_b", "", -0.8, 0.8, 0.1),
    _q("rebound", "", -1.5, 1.5, 0.1),
    _q("inertia", "", -0.5, 1.0, 0.02, mjcf="inertia"),
    _q("com_x", "m", -0.05, 0.05, 0.0005, mjcf="ipos"),
    _q("com_y", "m", -0.05, 0.05, 0.0005, mjcf="ipos"),
    _q("com_z", "m", -0.05, 0.05, 0.0005, mjcf="ipos"),
    _q("drag", "1/s", -1.0, 4.0, 0.05),
    _q("tilt_x", "rad", -0.1, 0.1, 0.005, mjcf="gravity"),
    _q("tilt_y", "rad", -0.1, 0.1, 0.005, mjcf="gravity"),
    _q("size", "", -0.2, 0.2, 0.005, mjcf="size"),
    _q("scale", "", -0.2, 0.2, 0.005),
    _q("clock", "", -0.2, 0.2, 0.005),
    _q("height", "m", -0.05, 0.05, 0.0005),
    _q("plane_x", "rad", -0.1, 0.1, 0.002),
    _q("plane_y", "rad", -0.1, 0.1, 0.002),
    _q("off_x", "m", -0.05, 0.05, 0.0005),
    _q("off_y", "m", -0.05, 0.05, 0.0005),
    _q("off_z", "m", -0.05, 0.05, 0.0005),
    _q("turned_x", "rad", -0.2, 0.2, 0.002),
    _q("turned_y", "rad", -0.2, 0.2, 0.002),
    _q("turned_z", "rad", -0.2, 0.2, 0.002),
)


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


_E = effect_of(OWN)
EFFECTS = (
    _E(
        "speed_friction",
        "contact",
        ("speed_friction",),
        "friction grows or falls with speed",
        "fast and slow slides",
        look_alikes=("friction",),
    ),
    _E(
        "grain",
        "contact",
        ("grain_a", "grain_b"),
        "friction depends on the direction of the slide",
        "slides in many directions",
        look_alikes=("friction",),
    ),
    _E(
        "restitution",
        "contact",
        ("rebound",),
        "harder impacts rebound more or less than the declared damping says",
        "soft and hard impacts",
        look_alikes=("damping",),
    ),
    _E(
        "body_size",
        "contact",
        ("size",),
        "the body is larger or smaller than declared",
        "impacts on corners, and rest",
    ),
    _E(
        "inertia",
        "force",
        ("inertia",),
        "the body is harder or easier to turn than declared",
        "impacts off the centre",
    ),
    _E(
        "centre_of_mass",
        "force",
        ("com_x", "com_y", "com_z"),
        "the centre of mass lies beside the declared one",
        "spinning flight",
    ),
    _E(
        "drag",
        "force",
        ("drag",),
        "a drag proportional to speed",
        "fast flights and slides",
        look_alikes=("friction",),
    ),
    _E(
        "tilt",
        "force",
        ("tilt_x", "tilt_y"),
        "the table is not level",
        "flights, and slides in many directions",
    ),
    _E(
        "length_scale",
        "measurement",
        ("scale",),
        "lengths are measured too long or too short",
        "free flight beside rest: the height of rest scales too",
    ),
    _E(
        "clock_scale",
        "measurement",
        ("clock",),
        "the recording's clock runs fast or slow",
        "free flight",
        same=("gravity@force",),
    ),
    _E(
        "plane_height",
        "measurement",
        ("height",),
        "the plane does not lie at the height zero of the recording",
        "impacts and rest",
    ),
    _E(
        "plane_turn",
        "measurement",
        ("plane_x", "plane_y"),
        "the recording's frame is turned against a level plane",
        "rest and slides",
    ),
    _E(
        "body_offset",
        "measurement",
        ("off_x", "off_y", "off_z"),
        "the point that is recorded is not the body's middle",
        "impacts and rest on several faces",
    ),
    _E(
        "body_turn",
        "measurement",
        ("turned_x", "turned_y", "turned_z"),
        "the recorded axes are turned against the body's",
        "rest on several faces",
    ),
)
"""A clock that is off and another gravity are the same toss: rigid motion under Coulomb friction
has no time of its own.
"""


def effects(body: TossedBody) -> tuple[Effect, ...]:
    """The effects that this body can have: shapes without a size cannot be scaled."""
    return tuple(e for e in EFFECTS if body.sized or e.name != "body_size")
