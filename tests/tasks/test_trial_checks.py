"""What tracks say by themselves of units and mirrors: the checks that pushes, scoops and tosses
share.
"""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.camera_record import unit_like
from adaptsim_jax.tasks.scooping.motion import check_mirrored


def test_units_are_told_by_their_size():
    assert [unit_like(0.7 * f, 0.7) for f in (1e3, 1e2, 1 / 0.0254)] == ["mm", "cm", "inches"]
    assert unit_like(0.1 * 100 * 0.6, 0.1) == "inches or cm"


def test_a_mirror_is_told_from_any_origin():
    declared = np.array([-0.02, 0.015, 0.03, -0.001])
    check_mirrored(declared, 0.4 + declared, "f")
    check_mirrored(declared, np.full(4, 0.001), "f")  # each counted from itself
    with pytest.raises(BadInput, match="turn the sign of y"):
        check_mirrored(declared, 0.4 - declared + 1e-3, "f")
