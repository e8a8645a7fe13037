"""What a push may lack beside its declared parameters: each effect with its quantities, units,
bounds, physics and excitation.
"""

import itertools
import math

from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.tasks import camera_effects
from adaptsim_jax.tasks.camera_effects import quantity as _q

DECLARED = ("mu", "log_e", "mu_p", "y_p")
QUANTITIES = (
    Quantity("mu", "", 0.02, 0.6, 0.12, prior=0.58, scale=0.01),
    Quantity("log_e", "log10 Pa", 3.5, 7.0, 5.0, prior=3.5, scale=0.2),
    Quantity("mu_p", "", 0.02, 1.2, 0.5, prior=1.18, scale=0.1),
    Quantity("y_p", "m", -0.2, 0.2, prior=0.4, scale=0.01),
    _q("speed_scale", "", -0.3, 0.3, 0.02),
    _q("speed_offset", "m/s", -0.15, 0.15, 0.01),
    _q("heading_offset", "rad", -0.25, 0.25, 0.02),
    _q("start_x", "m", -0.05, 0.05, 0.002),
    _q("start_y", "m", -0.05, 0.05, 0.002),
    _q("placed", "", -0.3, 1.3, 0.2),
    _q("hardening", "", -2.0, 2.0, 0.2),
    _q("heavier", "", -0.7, 3.0, 0.1),
    _q("plate_turn", "rad", -0.3, 0.3, 0.02),
    _q("tilt_x", "rad", -0.1, 0.1, 0.005),
    _q("tilt_y", "rad", -0.1, 0.1, 0.005),
    _q("speed_friction", "s/m", -0.9, 5.0, 0.1),
    _q("drag", "1/s", -1.0, 4.0, 0.1),
    _q("grain_a", "", -0.8, 0.8, 0.1),
    _q("grain_b", "", -0.8, 0.8, 0.1),
    _q("patch_x", "m", -0.12, 0.15, 0.01),
    _q("patch_size", "m", -0.04, 0.08, 0.005),
    _q("other_x", "m", 0.6, 1.3, 0.01, 0.85),
    _q("other_y", "m", -0.35, 0.35, 0.01),
    _q("other_mu", "", -0.5, 1.0, 0.1),
    _q("spin", "", 0.0, 3.0, 0.3),
    _q("com_x", "m", -0.015, 0.015, 0.001),
    _q("com_y", "m", -0.015, 0.015, 0.001),
    _q("scale_start", "", -0.2, 0.2, 0.01),
    _q("turn_start", "rad", -0.25, 0.25, 0.02),
    *camera_effects.QUANTITIES,
)
"""Those that are declared have bounds wider than Omega: a target outside of it is no effect that
the model lacks.
"""

PLACES = tuple(
    {"other_x": x, "other_y": y}
    for x, y in itertools.product((0.68, 0.78, 0.88, 0.98), (-0.14, -0.07, 0.0, 0.07, 0.14))
)
_E = camera_effects.effect_of(QUANTITIES)
EFFECTS = (
    _E(
        "speed_scale",
        "command",
        ("speed_scale",),
        "the plate runs faster or slower than commanded, by a share",
        "fast and slow pushes",
        look_alikes=("mu", "log_e"),
    ),
    _E(
        "speed_offset",
        "command",
        ("speed_offset",),
        "the plate runs faster or slower than commanded, by as much",
        "fast and slow pushes",
        look_alikes=("mu", "log_e"),
    ),
    _E(
        "heading_offset",
        "command",
        ("heading_offset",),
        "the plate runs along another heading than commanded",
        "any push",
    ),
    _E(
        "start_pose",
        "command",
        ("start_x", "start_y"),
        "the bottle stands elsewhere than declared, always at the same place",
        "any push",
    ),
    _E(
        "placement",
        "command",
        ("placed",),
        "the bottle is put down where the first rows of each track show it, not where declared",
        "starts that differ",
    ),
    _E(
        "hardening",
        "contact",
        ("hardening",),
        "the hit is harder or softer with speed than declared",
        "slow and fast pushes",
        look_alikes=("log_e",),
    ),
    _E(
        "mass",
        "contact",
        ("heavier",),
        "the bottle is heavier or lighter than declared, by a share, so that the same contact "
        "gives way more or less",
        "fast and slow pushes",
        same=("softer_contact@contact",),
        look_alikes=("log_e",),
        separated_by="scales",
    ),
    _E(
        "plate_turn",
        "contact",
        ("plate_turn",),
        "the plate's face is turned against its motion",
        "any push",
    ),
    _E(
        "tilt",
        "force",
        ("tilt_x", "tilt_y"),
        "the table is not level",
        "pushes to either side",
        look_alikes=("mu",),
    ),
    _E(
        "speed_friction",
        "force",
        ("speed_friction",),
        "friction grows or falls with speed",
        "slow and fast pushes",
        look_alikes=("mu",),
    ),
    _E(
        "drag",
        "force",
        ("drag",),
        "a drag proportional to speed",
        "slow and fast pushes",
        look_alikes=("mu",),
    ),
    _E(
        "grain",
        "force",
        ("grain_a", "grain_b"),
        "friction is larger across a grain than along it",
        "pushes over a wide range of angles",
        look_alikes=("mu",),
    ),
    _E(
        "patch_place",
        "force",
        ("patch_x",),
        "the patch lies nearer or farther than declared",
        "pushes that stop beyond the patch",
        look_alikes=("mu_p",),
    ),
    _E(
        "patch_size",
        "force",
        ("patch_size",),
        "the patch is larger or smaller than declared",
        "pushes across the patch's edges",
        look_alikes=("mu_p", "y_p"),
    ),
    _E(
        "second_patch",
        "force",
        ("other_x", "other_y", "other_mu"),
        "another patch of other friction",
        "pushes over all of the table",
        grid=PLACES,
    ),
    _E(
        "off_axis",
        "force",
        ("spin", "com_x", "com_y"),
        "the centre of mass lies beside the bottle's axis, so that a hit turns it",
        "any push, the bottle put down the same way round",
        grid=({"spin": 1.0},),
    ),
    _E(
        "turning",
        "force",
        ("spin",),
        "the bottle turns where friction under it does not balance, as at a patch's edge; asked "
        "where yaw was measured",
        "bottles that cross a patch's edge beside their axis",
        grid=({"spin": 1.0},),
    ),
    _E(
        "camera_scale_at_start",
        "measurement",
        ("scale_start",),
        "lengths are measured too long or too short, from the bottle's start",
        "any push",
    ),
    _E(
        "camera_turn_at_start",
        "measurement",
        ("turn_start",),
        "the camera is turned about the bottle's start",
        "any push",
    ),
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
