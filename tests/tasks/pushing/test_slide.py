"""The push as a slide in two dimensions, against the planar model, a finer step, and what each
effect has to do.
"""

from functools import partial

import jax
import numpy as np
import pytest

from adaptsim_jax.tasks.pushing import model, planar, slide
from experiments import pushing_worlds

PARAMS, ACTIONS, _ = model.draw(0, 24)


@partial(jax.jit, static_argnames=("step", "as_planar"))
def batch(values, actions, step, as_planar):
    return jax.vmap(lambda v, a: slide.rollout(v, a, step=step, as_planar=as_planar))(
        values, actions
    )


def rolled(step=slide.STEP, as_planar=False, **more):
    values = dict(zip(model.PARAMETERS, PARAMS.T, strict=True))
    values |= {k: np.full(len(PARAMS), float(v)) for k, v in (slide.NEUTRAL | more).items()}
    with jax.enable_x64(True):
        return np.asarray(batch(values, ACTIONS, step, as_planar))


def test_it_is_the_planar_model_where_nothing_acts_sideways():
    with jax.enable_x64(True):
        expected = np.asarray(jax.jit(jax.vmap(planar.trajectory))(PARAMS, ACTIONS))
    np.testing.assert_allclose(
        rolled(planar.STEP, as_planar=True)[:, 2::2, :4], expected, atol=1e-6
    )


def test_the_step_of_1_ms_has_converged_but_for_a_fraction_of_a_millimetre():
    apart = np.linalg.norm((rolled() - rolled(2.5e-4))[..., :2], axis=-1).max(1)
    assert np.median(apart) < 5e-4
    assert apart.max() < 5e-3


def test_a_slope_across_bends_the_track_downhill_and_a_turned_heading_turns_it():
    plain = rolled()

    def aside(z):
        return z[:, -1, 1] - plain[:, -1, 1]

    assert (aside(rolled(tilt_y=0.02)) > 0.002).all()
    assert (aside(rolled(heading_offset=0.05)) > 0.002).all()
    assert np.isfinite(rolled(grain_a=0.4, grain_b=-0.2, drag=0.5, plate_turn=0.1)).all()


def test_a_bottle_that_turns_is_that_of_other_equations_of_motion():
    """Those of `experiments/pushing_worlds`: about the axis instead of the centre of mass, at
    another step, without JAX.
    """
    lanes = {k: np.zeros(len(PARAMS)) for k in pushing_worlds.ZERO}
    lanes |= dict(zip(("mu", "e", "mu_p", "y_p"), PARAMS.T, strict=True)) | dict(
        zip(("speed", "angle"), ACTIONS.T, strict=True)
    )
    about = {"com_x": -0.002, "com_y": 0.004, "plate_turn": 0.05}
    lanes |= {k: np.full(len(PARAMS), v) for k, v in about.items()}
    lanes["light"] = np.full(len(PARAMS), 1.5 / model.RADIUS**2)
    other = pushing_worlds.simulate(lanes, 200)
    ours = rolled(2.5e-4, spin=0.75, **about)
    both = min(ours.shape[1], other.shape[1])
    apart = np.linalg.norm(ours[:, :both, :2] - other[:, :both, :2], axis=-1).max(1)
    assert np.median(apart) < 5e-4
    assert np.median(np.abs(ours[:, :both, 4] - other[:, :both, 2]).max(1)) < 0.02
    assert np.median(np.abs(ours[:, -1, 4])) > 0.3
    aside = np.abs(ours[..., :4] - rolled(2.5e-4)[..., :4])[:, -1, 1]
    assert np.median(aside) > 30 * np.median(apart)


def test_a_bottle_of_a_huge_inertia_is_one_that_does_not_turn():
    apart = np.abs(rolled(spin=1e-6, com_y=0.004) - rolled(com_y=0.004))[..., :2].max((1, 2))
    assert np.median(apart) < 2e-6


def test_it_is_differentiable():
    def end(tilt):
        values = dict(zip(model.PARAMETERS, (0.1, 1e5, 0.5, 0.05), strict=True)) | {"tilt_y": tilt}
        return slide.rollout(values, np.array([0.6, 0.2]), step=0.005)[-1, 1]

    with jax.enable_x64(True):
        run = jax.jit(lambda tilt: jax.jvp(end, (tilt,), (1.0,)))
        slope = float(run(0.01)[1])
        assert slope == pytest.approx(float(run(0.0101)[0] - run(0.0099)[0]) / 2e-4, rel=0.05)


def test_another_mass_is_a_softer_contact_and_no_other_modulus():
    """Friction does not know of mass. Stiffness and damping fall alike, by which no modulus changes
    both.
    """
    halved = rolled(heavier=1.0)
    values = dict(zip(model.PARAMETERS, PARAMS.T, strict=True))
    heavy = model.PushOptions(mass=2 * model.NOMINAL_MASS)
    with jax.enable_x64(True):
        declared = jax.jit(jax.vmap(lambda v, a: slide.rollout(v, a, heavy)))(values, ACTIONS)
        k, b = model.spring(model.ELASTICITY, np.geomspace(1e3, 1e7, 400), 0.6, model.NOMINAL_MASS)
    np.testing.assert_allclose(halved[..., :4], declared, atol=1e-9)
    softest = model.spring(model.ELASTICITY, 1e5, 0.6, 2 * model.NOMINAL_MASS)
    assert np.min(np.hypot(np.log(k / softest[0]), np.log(b / softest[1]))) > 0.2
    assert np.median(np.abs(halved - rolled())[:, -1, 0]) > 0.005
