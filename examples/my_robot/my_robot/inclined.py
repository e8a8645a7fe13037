"""The rigid double pendulum on an inclined table."""

from dataclasses import replace

import numpy as np

from adaptsim_jax.diagnosis import Plant, make_plant

SLOPE = np.radians(30.0)


def inclined(angle_zero, geometry, known) -> Plant:
    """geometry: l1 [m], g [m/s^2]; theta as of `rigid_body`, and held where `known`. BadInput where
    l1 is missing.
    """
    g = geometry.get("g", 9.81) * np.sin(SLOPE)
    return replace(
        make_plant("rigid_body", angle_zero, {**geometry, "g": g}, known), name="pendulum/inclined"
    )
