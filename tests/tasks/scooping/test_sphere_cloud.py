"""The sphere cloud of MuJoCo's engines: its outline, softness and weights; MJX against native;
codes.
"""

import copy
import importlib

import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import engines as backends
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.engines import mujoco as scooping_native
from adaptsim_jax.tasks.scooping.engines import scene
from adaptsim_jax.tasks.scooping.model import ScoopOptions

PIECES = [
    (0.3, e, g, h) for e in (1e4, 1e6) for g in (0.0, 1.0, 2.0) for h in (0.014, 0.0299, 0.035)
]


@pytest.mark.parametrize("params", PIECES)
def test_spheres_fill_the_outline_and_nothing_beyond(params):
    """Along 64 directions the union of spheres reaches as far as the piece does; short of it by at
    most 1.2 % of a flat ellipsoid, by a rounded corner of a flat piece.
    """
    found = scene.cloud(jnp.array(params))
    x, z, r = (
        np.asarray(found.centres)[:, 0],
        np.asarray(found.centres)[:, 2],
        np.asarray(found.radii),
    )
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    reach = (np.outer(c, x) + np.outer(s, z) + r).max(
        1
    )  # support functions tell how far to each side
    hz = params[3] / 2
    if params[2] == model.ELLIPSOID:
        outline = np.hypot(model.RADIUS * c, hz * s)
        np.testing.assert_array_less(reach, outline * 1.0001)
        np.testing.assert_array_less(0.988 * outline, reach)
    else:
        rim = float(scene.rim(jnp.asarray(params[1]), jnp.asarray(hz)))
        outline = (model.RADIUS - rim) * np.abs(c) + (hz - rim) * np.abs(s) + rim
        np.testing.assert_allclose(reach, outline, atol=1e-6)


@pytest.fixture(scope="module")
def native():
    return backends.make_backend("native").simulate


def test_softer_pieces_have_rounder_rims_and_lie_as_deep_as_hydroelastic_ones(native):
    """Rims shrink with stiffness; before the blade comes a piece lies still, as deep as the
    pressure field's closed form says (a third less where an ellipsoid rests on more than one of its
    spheres).
    """
    rims = [float(scene.rim(jnp.asarray(e), jnp.asarray(0.01))) for e in (1e3, 1e4, 1e5, 1e6, 1e7)]
    assert rims == sorted(rims, reverse=True) and rims[1] > 3 * rims[3]
    params = np.array(
        [[mu, e, g, 0.02] for mu in (0.25, 0.4) for e in (1e4, 3e4) for g in (0.0, 1.0, 2.0)]
    )
    actions = np.tile([0.1, 0.0, 0.02], (len(params), 1))
    lies = 0.01 - native(params, actions, np.zeros((len(params), 2))).state[:, 9, 2]  # at 0.1 s
    for row, depth in zip(params, lies, strict=True):
        piece = shapes.body(jnp.asarray(row[2]), jnp.asarray(row[3]))
        part = depth / float(shapes.sink(piece, jnp.asarray(row[1]), model.GRAVITY))
        assert (
            0.6 < part < 1.02 if row[2] == model.ELLIPSOID else part == pytest.approx(1.0, abs=0.02)
        )


def test_weights_are_what_mujoco_derives_itself():
    """Masses written into a compiled model: all that MuJoCo computes of them is what `fields`
    says.
    """
    mujoco = importlib.import_module("mujoco")
    compiled = scene.compiled()
    for params in PIECES[::4]:
        piece = {
            k: np.asarray(v, float) for k, v in scene.fields(jnp.array(params), scene.DT).items()
        }
        ours, theirs = copy.copy(compiled), copy.copy(compiled)
        for m in (ours, theirs):
            scooping_native.write_piece(m, piece)
        mujoco.mj_setConst(theirs, mujoco.MjData(theirs))
        for name in ("body_invweight0", "dof_invweight0", "body_subtreemass", "dof_M0"):
            np.testing.assert_allclose(
                getattr(ours, name)[1:], getattr(theirs, name)[1:], rtol=1e-4, err_msg=name
            )


def test_native_meets_every_sphere_that_overlaps():
    """Boxes made for other spheres must hide no contact: a piece turned any way above the table,
    some spheres in it.
    """
    mujoco = importlib.import_module("mujoco")
    m = scene.compiled()
    data = mujoco.MjData(m)
    for params, angle in zip(PIECES, np.linspace(0, 6, len(PIECES)), strict=True):
        piece = {
            k: np.asarray(v, float) for k, v in scene.fields(jnp.array(params), scene.DT).items()
        }
        scooping_native.write_piece(m, piece)
        data.qpos[:] = 0.3, 0.012, angle, 0.32, 0.004, 0.05
        mujoco.mj_forward(m, data)
        z = (
            0.012
            - np.sin(angle) * piece["geom_pos"][:, 0]
            + np.cos(angle) * piece["geom_pos"][:, 2]
        )
        table = {c.geom[1] for c in data.contact if c.geom[0] == m.geom("table").id}
        assert table == set(m.geom("sphere0").id + np.flatnonzero(z < piece["geom_rbound"]))


def test_the_blade_follows_its_motion_and_codes_tell_what_is_amiss(native):
    params, actions = model.draw(2, 24)
    params[3, 1], actions[5, 0] = np.nan, 3.0
    out = native(params, actions, np.tile([0.5, 0.1], (24, 1)))
    assert np.flatnonzero(out.code).tolist() == [3, 5] and set(out.code[[3, 5]]) == {model.UNFIT}
    assert out.state.shape == (24, 100, 6) and np.isfinite(out.state).all()
    start, drive = scene.make_drive(ScoopOptions(), scene.DT)(
        jnp.array(params[0]), jnp.array(actions[0])
    )
    speed = np.cumsum(np.asarray(drive), 0) * scene.DT
    pose = np.asarray(start)[3:] + np.cumsum(speed, 0) * scene.DT
    np.testing.assert_allclose(
        out.state[0, :, 3:] - [0.5, 0, 0], pose[scene.rows(scene.DT)], atol=3e-5
    )


@pytest.mark.slow
def test_mjx_ends_as_native_does(native):
    """48 random trials of all three shapes in one program: one may end otherwise (over 200,
    docs/results/scooping.md).
    """
    params, actions = model.draw(7, 48)
    params[::5, 2] = model.BOX
    ours = native(params, actions, np.zeros((48, 2)))
    theirs = backends.make_backend("mjx", dt=0.005, batch=48).simulate
    coarse = backends.make_backend("native", dt=0.005).simulate(params, actions, np.zeros((48, 2)))
    found = theirs(params, actions, np.zeros((48, 2)))
    assert not found.code.any() and not ours.code.any()
    won = model.outcome(found.state)[0]
    assert 0.2 < won.mean() < 0.9 and np.sum(won != model.outcome(coarse.state)[0]) <= 1
    assert np.median(np.abs(found.state - coarse.state).max((1, 2))) < 1e-4


def test_steps_that_do_not_make_rows_are_refused():
    with pytest.raises(BadInput, match="divide"):
        backends.make_backend("native", dt=0.004)
