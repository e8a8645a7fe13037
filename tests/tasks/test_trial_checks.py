"""What tracks say by themselves of units: the check that pushes, scoops and tosses share."""

from adaptsim_jax.tasks.camera_record import unit_like


def test_units_are_told_by_their_size():
    assert [unit_like(0.7 * f, 0.7) for f in (1e3, 1e2, 1 / 0.0254)] == ["mm", "cm", "inches"]
    assert unit_like(0.1 * 100 * 0.6, 0.1) == "inches or cm"
