"""The hydroelastic engine by itself: depth at rest, Coulomb's law, energy, momentum, gradients, and
convergence.

Almost all of it is one compiled program: a piece of any shape on a table at rest, under any
gravity, in double precision.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping import hydro_contact as contact
from adaptsim_jax.tasks.scooping import hydro_sap as sap
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping.hydro import PieceState
from adaptsim_jax.tasks.scooping.model import Numerics

G = model.GRAVITY
TABLE = Numerics(dt=2e-3, relaxation=0.02, grid=((16, 4),))
STEPS = 300


def on_table(params, pose, velocity, gravity, dt=TABLE.dt, grid=TABLE.grid, steps=STEPS):
    """Poses and velocities `[steps, 3]`, impulses `[steps, 3]` and the largest residual of a piece
    on a table.
    """
    piece, ground = shapes.body(params[2], params[3]), contact.table(params[0])
    numerics = replace(TABLE, dt=dt, grid=grid)

    def one(state, _):
        state, info = hydro.step(
            piece, params[1], state, ground, numerics, (gravity[0], gravity[1])
        )
        return state, (state.pose, state.velocity, info.impulse, info.residual)

    _, (poses, velocities, impulses, residuals) = jax.lax.scan(
        one, PieceState(pose, velocity), None, steps
    )
    return poses, velocities, impulses, residuals.max()


@pytest.fixture(scope="module")
def run():
    compiled = jax.jit(on_table)

    def call(
        params, pose=(0.0, 0.02, 0.0), velocity=(0.0, 0.0, 0.0), gravity=(0.0, -G), dt=TABLE.dt
    ):
        with jax.enable_x64(True):
            out = compiled(
                *(jnp.asarray(v, jnp.float64) for v in (params, pose, velocity, gravity, dt))
            )
            return tuple(np.asarray(v) for v in out)

    return call


def resting(params):
    with jax.enable_x64(True):
        params = jnp.asarray(params, jnp.float64)
        return np.asarray(hydro.at_rest(shapes.body(params[2], params[3]), params[1]).pose)


@pytest.mark.parametrize("g", [0, 1, 2])
@pytest.mark.parametrize("e", [1e4, 2e5])
def test_a_dropped_piece_sinks_as_deep_as_its_weight_asks(run, g, e):
    """The field integrated over the section by hand: an ellipsoid sinks by about hz sqrt(4 rho g hz
    / 3 e), a cylinder or a box by rho g h core / e and a little more at its rim.
    """
    h, params = 0.02, (0.3, e, g, 0.02)
    poses, velocities, _, residual = run(params, pose=(0.0, h / 2 + 5e-4, 0.0))
    depth = h / 2 - poses[-1, 1]
    first = h / 2 * np.sqrt(4 * 1000 * G * h / 2 / (3 * e)) if g == 0 else 1000 * G * h * 0.01 / e
    assert depth == pytest.approx(first, rel=0.05)
    assert depth == pytest.approx(
        h / 2 - resting(params)[1], rel=0.02
    )  # 2 %: the section by 16 by 4 points
    assert np.abs(velocities[-1]).max() < 1e-3 and residual < 1e-8


@pytest.mark.parametrize("g, mu, speed", [(1, 0.3, 0.4), (2, 0.25, 0.3), (1, 0.4, 0.45)])
def test_a_piece_slides_as_far_as_coulomb_says(run, g, mu, speed):
    params = (mu, 1e5, g, 0.015)
    poses, velocities, _, _ = run(params, pose=resting(params), velocity=(speed, 0.0, 0.0))
    # the step moves with the velocity at its end, which takes half a step off
    assert poses[-1, 0] == pytest.approx(speed**2 / (2 * mu * G) - speed * TABLE.dt / 2, rel=3e-3)
    assert abs(velocities[-1, 0]) < 1e-4


def test_an_incline_holds_below_the_angle_of_friction_and_not_above(run):
    params = (0.3, 1e5, 1, 0.015)
    for share in (0.97, 1.03):
        angle = np.arctan(0.3 * share)
        down, normal = G * np.sin(angle), G * np.cos(angle)
        _, velocities, _, _ = run(params, pose=resting(params), gravity=(down, -normal))
        seconds = STEPS * TABLE.dt
        if share < 1:
            assert abs(velocities[-1, 0]) < 1e-4  # regularised friction creeps
        else:
            # the speed is a small difference of two large impulses, so what friction there was is
            # what can be compared
            friction = (down * seconds - velocities[-1, 0]) / (normal * seconds)
            assert friction == pytest.approx(0.3, rel=0.005)
            assert velocities[-1, 0] > 0.5 * (down - 0.3 * normal) * seconds


@pytest.mark.parametrize("g", [0, 1, 2])
def test_energy_is_never_gained_and_goes_where_it_should(run, g):
    """Thrown onto the table tilted, sliding and spinning; what the surface stores comes from what
    the piece loses.
    """
    params = (0.35, 3e4, g, 0.018)
    poses, velocities, _, _ = run(params, pose=(0.0, 0.03, 0.5), velocity=(0.3, -0.2, 6.0))
    with jax.enable_x64(True):
        piece = shapes.body(jnp.asarray(float(g)), jnp.asarray(0.018))
    mass, inertia = float(piece.mass), float(piece.inertia)
    kinetic = 0.5 * mass * (velocities[:, :2] ** 2).sum(1) + 0.5 * inertia * velocities[:, 2] ** 2
    energy = kinetic + mass * G * poses[:, 1]
    start = 0.5 * mass * (0.3**2 + 0.2**2) + 0.5 * inertia * 36.0 + mass * G * 0.03
    assert energy.max() <= start * (1 + 1e-6)
    assert energy[-1] < 0.5 * start and kinetic.max() > 10 * kinetic[-1]


@pytest.mark.parametrize("g", [0, 1, 2])
def test_momentum_changes_by_gravity_and_contact_alone(run, g):
    params = (0.35, 3e4, g, 0.018)
    _, velocities, impulses, residual = run(
        params, pose=(0.0, 0.03, 0.5), velocity=(0.3, -0.2, 6.0)
    )
    with jax.enable_x64(True):
        piece = shapes.body(jnp.asarray(float(g)), jnp.asarray(0.018))
    mass = np.array([piece.mass, piece.mass, piece.inertia])
    change = (
        mass * np.diff(velocities, axis=0)
        - impulses[1:]
        - mass * TABLE.dt * np.array([0.0, -G, 0.0])
    )
    assert np.abs(change / mass).max() < 1e-8 and residual < 1e-8
    assert (np.abs(impulses[:, 1]) > 0).any() and np.abs(impulses[0]).max() == 0.0  # it falls first


def test_with_no_contact_it_flies(run):
    poses, velocities, _, _ = run(
        (0.3, 1e5, 1, 0.02), pose=(0.0, 5.0, 0.2), velocity=(0.1, 2.0, 3.0)
    )
    t = STEPS * TABLE.dt
    np.testing.assert_allclose(velocities[-1], [0.1, 2.0 - G * t, 3.0], rtol=1e-9)
    np.testing.assert_allclose(
        poses[-1], [0.1 * t, 5 + 2 * t - G * t * (t + TABLE.dt) / 2, 0.2 + 3 * t], rtol=1e-9
    )


def test_convergence_in_step(run):
    """The place where a thrown cylinder comes to rest after 0.4 s: errors fall with the step."""
    end = {}
    for rows in (75, 150, 300):
        poses, _, _, _ = run(
            (0.3, 5e4, 1, 0.02), (0.0, 0.0105, 0.0), (0.4, 0.0, 0.0), dt=0.4 / rows
        )
        end[rows] = poses[rows - 1, 0]
    coarse, fine = abs(end[75] - end[300]), abs(end[150] - end[300])
    assert fine < 0.6 * coarse and fine < 1e-3


@pytest.mark.slow
def test_gradients_are_finite_differences(x64):
    """Of where a sliding, then resting piece is after 80 ms by friction, modulus, height and first
    speed.
    """

    def place(z):
        params = jnp.stack([z[0], jnp.exp(z[1]), jnp.ones(()), z[2]])
        pose = hydro.at_rest(shapes.body(params[2], params[3]), params[1]).pose
        velocity = jnp.stack([z[3], jnp.zeros(()), jnp.zeros(())])
        poses, _, _, _ = on_table(
            params, pose, velocity, jnp.array([0.0, -G]), grid=((8, 2),), steps=40
        )
        return poses[-1]

    z = np.array([0.3, np.log(5e4), 0.016, 0.45])
    jacobian = np.asarray(jax.jit(jax.jacrev(place))(jnp.asarray(z)))
    go = jax.jit(place)
    for i in range(4):
        d = 1e-8 * np.eye(4)[i]
        numeric = (np.asarray(go(jnp.asarray(z + d))) - np.asarray(go(jnp.asarray(z - d)))) / 2e-8
        np.testing.assert_allclose(jacobian[:, i], numeric, rtol=2e-3, atol=1e-6)
    assert abs(jacobian[0, 0]) > 0.01 and abs(jacobian[1, 1]) > 1e-6


def least_of(s, piece, free, v):
    """What Newton's method minimises, kg m^2/s^2; the solver itself needs only its slopes."""
    law = sap._law(s, *sap._relative(s, v))
    mass = jnp.stack([piece.mass, piece.mass, piece.inertia])
    motion = jnp.sum(mass * (v - free) ** 2)
    return 0.5 * (motion + sap._sum(law.normal**2 / s.stiff + law.tangent**2 / s.grip))


def test_newtons_method_finds_the_least_cost(x64):
    """The solve's velocity against SciPy on the same cost, which shares no slope or Hessian with
    it.
    """
    from scipy.optimize import minimize

    piece = shapes.body(jnp.ones(()), jnp.asarray(0.02))
    points = contact.touch(
        piece,
        jnp.asarray(5e4),
        jnp.array([0.0, 0.0095, 0.02]),
        contact.table(jnp.asarray(0.3)),
        TABLE.grid,
    )
    fixed = sap.springs(points, piece, 2e-3, 0.02, 0.1, 0.0)
    free = jnp.array([0.05, -0.1, 1.0])
    found = sap.solve(fixed, contact.firsts(TABLE.grid), piece, free, free, 30)
    scale = np.array([1.0, 1.0, 100.0])
    cost = jax.jit(lambda z: least_of(fixed, piece, free, z * scale) * 1e4)
    by_scipy = minimize(
        lambda z: float(cost(jnp.asarray(z))),
        np.zeros(3),
        method="Nelder-Mead",
        options={"xatol": 1e-10, "fatol": 1e-14, "maxiter": 4000, "maxfev": 4000},
    )
    np.testing.assert_allclose(found.velocity, by_scipy.x * scale, atol=1e-5)
    assert float(cost(found.velocity / scale)) <= by_scipy.fun * (1 + 1e-9)


def test_sections_and_fields_by_hand(x64):
    """A horizontal line 4 mm over the centre of pieces 2 cm high, and the field at its middle."""

    def piece(g):
        return shapes.body(jnp.asarray(float(g)), jnp.asarray(0.02))

    z, zero = jnp.asarray(0.004), jnp.zeros(())
    half = [0.015 * np.sqrt(1 - 0.4**2), 0.015, 0.015]
    depth = [1 - 0.4, 0.6, 0.6]
    for g in range(3):
        cut = shapes.chord(piece(g), zero, z, jnp.ones(()), zero)
        np.testing.assert_allclose([cut.low, cut.high], [-half[g], half[g]], atol=1e-9)
        s, slope_x, slope_z = shapes.field(piece(g), zero, zero, z)
        assert s == pytest.approx(depth[g], abs=1e-6) and slope_z == pytest.approx(-100.0, rel=1e-6)
        assert slope_x == pytest.approx(0.0, abs=1e-9)
        assert shapes.half_width(piece(g), zero, z) == pytest.approx(half[g])


@pytest.mark.parametrize(
    "change", [{"dt": 0.0033}, {"slip": 0.0}, {"grid": ((2, 2),)}, {"iterations": 0}]
)
def test_bad_numerics_are_refused(change):
    with pytest.raises(BadInput):
        hydro.check_numerics(replace(Numerics(), **change))
