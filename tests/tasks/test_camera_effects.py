"""What a camera does to places: parallax is that of rays through what it sees, and over one height
a scale with a shift.
"""

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.camera_effects import QUANTITIES, effects, viewed

PLACES = np.random.default_rng(0).uniform(-0.5, 1.0, (20, 2))
HEIGHTS = np.random.default_rng(1).uniform(0.0, 0.2, (20, 1))
CAMERA = np.array([0.4, -0.3, 1.2])  # x, y and height m


def seen(places, height, **given):
    values = {q.name: jnp.float32(given.get(q.name, 0.0)) for q in QUANTITIES}
    return np.asarray(
        viewed(values, jnp.asarray(places, jnp.float32), jnp.asarray(height, jnp.float32))
    )


def parallax():
    return {"near": 1 / CAMERA[2], "lean_x": CAMERA[0] / CAMERA[2], "lean_y": CAMERA[1] / CAMERA[2]}


def test_parallax_is_where_rays_meet_the_table():
    points = np.concatenate([PLACES, HEIGHTS], 1)
    rays = points - CAMERA
    table = CAMERA - rays * (CAMERA[2] / rays[:, 2:])
    np.testing.assert_allclose(seen(PLACES, HEIGHTS, **parallax()), table[:, :2], atol=1e-6)


def test_over_one_height_it_is_a_scale_with_a_shift_and_over_several_none():
    more = 0.1 / (CAMERA[2] - 0.1)
    alike = {"scale": more, "shift_x": -more * CAMERA[0], "shift_y": -more * CAMERA[1]}
    np.testing.assert_allclose(
        seen(PLACES, 0.1, **parallax()), seen(PLACES, 0.1, **alike), atol=1e-6
    )
    apart = seen(PLACES, HEIGHTS, **parallax())
    design = np.concatenate([PLACES, np.ones((20, 1))], 1)
    left = apart - design @ np.linalg.lstsq(design, apart, rcond=None)[0]
    assert np.abs(left).max() > 0.01


def test_only_where_heights_do_not_vary_no_trial_tells_them_apart():
    classes = [
        {e.name: e.same for e in effects("trial", "there", rises)}["parallax"]
        for rises in (False, True)
    ]
    assert classes == [("camera_scale_with_shift@measurement",), ()]
