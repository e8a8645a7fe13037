"""What may be amiss with pushes: the effects that a diagnosis tries, and the vector of all their parameters."""

import math

import numpy as np

from adaptsim_jax.attribution.trials import Candidate, Parameter
from adaptsim_jax.tasks.pushing import model as pushing

DECLARED = ("mu", "log_e", "mu_p", "y_p")
LOW, HIGH = pushing.LOW, pushing.HIGH

PARAMETERS = (
    Parameter("mu", "1", 0.12, LOW[0], HIGH[0]),
    Parameter("log_e", "log10 Pa", 5.0, math.log10(LOW[1]), math.log10(HIGH[1])),
    Parameter("mu_p", "1", 0.45, LOW[2], HIGH[2]),
    Parameter("y_p", "m", 0.0, LOW[3], HIGH[3]),
    Parameter("speed_scale", "1", 0.0, -0.3, 0.3),
    Parameter("speed_offset", "m/s", 0.0, -0.15, 0.15),
    Parameter("heading", "rad", 0.0, -0.3, 0.3),
    Parameter("late", "s", 0.0, -0.2, 0.2),
    Parameter("start_x", "m", 0.0, -0.05, 0.05),
    Parameter("start_y", "m", 0.0, -0.05, 0.05),
    Parameter("hit", "1", 0.0, -1.5, 1.5),
    Parameter("tilt_x", "rad", 0.0, -0.1, 0.1),
    Parameter("tilt_y", "rad", 0.0, -0.1, 0.1),
    Parameter("viscous", "1/s", 0.0, 0.0, 3.0),
    Parameter("quadratic", "1/m", 0.0, 0.0, 4.0),
    Parameter("grain", "1", 0.0, -0.8, 3.0),
    Parameter("grain_angle", "rad", 0.0, -math.pi, math.pi),
    Parameter("patch_x", "m", 0.0, -0.12, 0.2),
    Parameter("patch_side", "m", 0.0, -0.08, 0.15),
    Parameter("spot", "1", 0.0, -0.1, 0.8),
    Parameter("spot_x", "m", 0.95, 0.6, 1.4),
    Parameter("spot_y", "m", 0.0, -0.3, 0.3),
    Parameter("camera_x", "m", 0.0, -0.1, 0.1),
    Parameter("camera_y", "m", 0.0, -0.1, 0.1),
    Parameter("camera_scale", "1", 0.0, -0.3, 0.3),
    Parameter("camera_turn", "rad", 0.0, -0.3, 0.3),
    Parameter("latency", "s", 0.0, -0.2, 0.2),
    Parameter("clock_scale", "1", 0.0, -0.3, 0.3),
)
NAMES = tuple(p.name for p in PARAMETERS)


def _effect(
    name: str, place: str, parameters: tuple[str, ...], physics: str, excited_by: str, starts=None
) -> Candidate:
    zero = tuple(PARAMETERS[NAMES.index(p)].off for p in parameters)
    return Candidate(name, place, parameters, starts or (zero,), physics, excited_by)


_SPOTS = tuple((0.2, x, y) for x in (0.85, 0.95, 1.05) for y in (-0.1, 0.0, 0.1))
_GRAINS = tuple((0.3, a) for a in (0.0, np.pi / 4, np.pi / 2, -np.pi / 4))

CATALOGUE = (
    _effect("speed_scale", "command", ("speed_scale",), "the arm is faster or slower by a share", "pushes of all speeds"),
    _effect("speed_offset", "command", ("speed_offset",), "the arm is faster or slower by a constant", "pushes of all speeds"),
    _effect("heading_offset", "command", ("heading",), "the arm pushes along another heading", "pushes of one heading"),
    _effect("late_start", "command", ("late",), "the arm starts later than the clock says", "a fast camera"),
    _effect("start_pose", "command", ("start_x", "start_y"), "the bottle stands elsewhere than declared", "rows before the hit"),
    _effect("hit_speed", "contact", ("hit",), "the bottle is softer or harder at faster hits than declared", "a range of speeds"),
    _effect("tilt", "force", ("tilt_x", "tilt_y"), "the table is not level", "pushes of several headings that stop late"),
    _effect("viscous_friction", "force", ("viscous",), "friction grows with the speed", "fast and slow slides"),
    _effect("quadratic_friction", "force", ("quadratic",), "friction grows with the square of the speed", "fast and slow slides"),
    _effect("grain", "force", ("grain", "grain_angle"), "friction is larger across the table's grain than along it",
            "headings far apart", _GRAINS),
    _effect("patch_place", "force", ("patch_x",), "the patch lies nearer or farther than declared", "pushes over the patch"),
    _effect("patch_size", "force", ("patch_side",), "the patch is larger or smaller than declared", "pushes over the patch"),
    _effect("second_patch", "force", ("spot", "spot_x", "spot_y"), "one more patch of other friction", "pushes over it", _SPOTS),
    _effect("camera_shift", "measurement", ("camera_x", "camera_y"), "the camera's zero is off", "rows before the hit"),
    _effect("camera_scale", "measurement", ("camera_scale",), "the camera's scale is off", "long and short pushes"),
    _effect("camera_rotation", "measurement", ("camera_turn",), "the camera is turned", "pushes of several headings"),
    _effect("camera_latency", "measurement", ("latency",), "the camera is late", "fast motion"),
    _effect("clock_scale", "measurement", ("clock_scale",), "the camera's clock runs fast or slow", "slides that end late"),
)  # fmt: skip
