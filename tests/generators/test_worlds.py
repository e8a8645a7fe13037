"""The generators' mechanics against energy, SciPy's integrator, matrix exponentials and MuJoCo."""

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tests.generators import Spec, make_datasets
from tests.generators import dataset as making
from tests.generators.conditions import CONDITIONS
from tests.generators.effects import Table
from tests.generators.simulate import simulate
from tests.generators.sizing import measure
from tests.generators.worlds import G, Rig, acceleration, bias_torque, lanes_of, mass_matrix


def made(spec: Spec, table: Table | None = None, step: float = 5e-4):
    """(draft, drive, run) of one quiet data set."""
    d = making.draft(spec)
    drive = making.stack([d]).quiet()
    lanes = drive.times.shape[1]
    return d, drive, simulate(lanes_of([d.rig], [lanes]), table or Table(lanes), drive, step)


def test_nothing_here_imports_the_package():
    for file in Path(__file__).parent.glob("*.py"):
        if file.name.startswith("test_scor"):
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] in ("adaptsim_jax", "jax") for n in names), file


def energy(rig: Rig, state: np.ndarray) -> np.ndarray:
    """Kinetic plus potential energy from the positions of the centres of mass, `[K, 4]` ->
    `[K]`.
    """
    q1, q12 = state[:, 0], state[:, 0] + state[:, 1]
    w1, w12 = state[:, 2], state[:, 2] + state[:, 3]
    l1, (c1, c2) = rig.l[0], rig.c
    vx = l1 * np.cos(q1) * w1 + c2 * np.cos(q12) * w12
    vy = l1 * np.sin(q1) * w1 + c2 * np.sin(q12) * w12
    kinetic = rig.m[0] * c1**2 * w1**2 + rig.inertia[0] * w1**2 + rig.m[1] * (vx**2 + vy**2)
    kinetic = 0.5 * (kinetic + rig.inertia[1] * w12**2)
    height = rig.m[0] * c1 * np.cos(q1) + rig.m[1] * (l1 * np.cos(q1) + c2 * np.cos(q12))
    return kinetic - rig.sign * G * height


@pytest.mark.parametrize("zero", ["hanging", "upright"])
def test_energy_is_kept_without_damping_and_torque(zero):
    d = making.draft(Spec(3, "swings", angle_zero="hanging"))
    rig = Rig(
        "rigid_body",
        d.rig.m,
        d.rig.l,
        d.rig.c,
        d.rig.inertia,
        np.zeros(2),
        1.0 if zero == "hanging" else -1.0,
    )
    drive = making.stack([d]).quiet()
    drive.feedforward[:] = 0.0
    run = simulate(lanes_of([rig], [6]), Table(6), drive, 1e-3)
    for lane in range(6):
        e = energy(rig, run.state[..., lane])
        assert np.ptp(e) < 1e-5 * np.ptp(rig.gravity_torque()), (lane, np.ptp(e))


@pytest.mark.parametrize("condition", ["clean", "jitter"])
def test_rows_follow_scipy_with_the_torque_of_the_row_before(condition):
    """A torque holds from its row to the next: SciPy, started at row k under torque k, must land on
    row k + 1.
    """
    d, drive, run = made(Spec(11, condition, n_trials=2, seconds=1.0, angle_zero="hanging"))
    p = lanes_of([d.rig], [1])

    def rhs(t, x, u):
        q, v = x[:2, None], x[2:, None]
        return np.concatenate([x[2:], acceleration(p, q, v, u[:, None] - p.b * v)[:, 0]])

    for lane in range(2):
        for k in (5, 60, 150):
            t0, t1 = drive.times[k, lane], drive.times[k + 1, lane]
            u = run.command[k, :, lane]
            x = solve_ivp(
                rhs, (t0, t1), run.state[k, :, lane], args=(u,), rtol=1e-11, atol=1e-13
            ).y[:, -1]
            assert np.abs(x - run.state[k + 1, :, lane]).max() < 1e-8
            wrong = solve_ivp(
                rhs, (t0, t1), run.state[k, :, lane], args=(run.command[k + 1, :, lane],)
            ).y[:, -1]
            assert np.abs(wrong - run.state[k + 1, :, lane]).max() > 1e-6


def test_linearised_world_is_the_paper_s_matrix():
    """Exact propagation with A, B as the paper states them, unit lengths and point masses."""
    d, _, run = made(Spec(12, "clean", world="linearized", n_trials=2, seconds=1.0))
    (m1, m2), b = d.rig.m, d.rig.b
    mass = np.array([[m1 + 4 * m2, 2 * m2], [2 * m2, m2]])
    lower = np.array([[G, -G * m2 / m1], [-G, G + 2 * G * m2 / m1]])
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [lower, -inverse @ np.diag(b)]])
    system = np.zeros((6, 6))
    system[:4, :4], system[2:4, 4:] = a, inverse
    held = expm(system * 0.005)
    for k in (3, 100, 198):
        x = held[:4, :4] @ run.state[k] + held[:4, 4:] @ run.command[k]
        assert np.abs(x - run.state[k + 1]).max() < 1e-8


def test_linearised_world_is_the_slope_of_the_rigid_one():
    one = np.ones(2)
    rigid = Rig("rigid_body", np.array([1.3, 1.7]), one, one, 0 * one, np.array([1.1, 1.6]), -1.0)
    linear = Rig("linearized", rigid.m, one, one, 0 * one, rigid.b, -1.0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, u = 1e-5 * rng.normal(size=(3, 2, 1))
        both = [acceleration(p := lanes_of([r], [1]), q, v, u - p.b * v) for r in (rigid, linear)]
        np.testing.assert_allclose(both[0], both[1], rtol=1e-5)


def test_declared_truth_is_the_mass_matrix_and_gravity_of_the_world():
    d = making.draft(Spec(4, angle_zero="hanging"))
    t, p = d.rig.declared(), lanes_of([d.rig], [1])
    m11, m12, m22 = mass_matrix(p, np.array([[0.3], [np.pi / 2]]))
    assert (m11[0], m22[0]) == (pytest.approx(t["p1"]), pytest.approx(t["p3"])) and m12[
        0
    ] == pytest.approx(t["p3"])
    torque = bias_torque(p, np.array([[np.pi / 2], [0.0]]), np.zeros((2, 1)))[:, 0]
    np.testing.assert_allclose(torque, G * np.array([t["h1"] + t["h2"], t["h2"]]))


# What the second engine may differ by, as a share of what the effect changes, with the reason.
ENGINE_TOLERANCE = {
    "": 1e-7,  # RK4 in both; absolute [rad]
    "rotor_inertia": 1e-6,
    "spring": 1e-6,
    "tilt": 1e-5,
    "torque_gain": 1e-6,
    "saturation": 1e-6,
    "bias": 1e-6,
    "quadratic_drag": 5e-3,  # MuJoCo steps implicitly to first order at 0.1 ms
    "cogging": 0.03,
    "actuator_lag": 0.03,  # the same, with a first-order filter
    "delay": 0.03,  # rounded to MuJoCo's 0.1 ms steps
    "presliding": 0.03,  # both LuGre, first order in time there
    "coulomb": 0.03,  # a soft constraint there, tanh(v / 1 mrad/s) here
    "stribeck": 0.3,  # LuGre there: a bristle of 1 mrad and its damping come with it
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(ENGINE_TOLERANCE))
def test_mujoco_s_own_features_agree(name):
    hidden = ((name, 0 if name == "tilt" else 2, 3.0),) if name else ()
    size = {"n_trials": 2, "seconds": 1.5, "angle_zero": "hanging"}
    specs = [
        Spec(50, "low_noise", hidden, engine="mujoco", **size),
        Spec(50, "low_noise", hidden, **size),
        Spec(50, "low_noise", **size),
    ]
    mujoco, ours, null = make_datasets(specs)
    apart, effect = (
        max(
            np.abs(a[c] - b[c]).max()
            for a, b in zip(x.trials, ours.trials, strict=True)
            for c in ("q1", "q2")
        )
        for x in (mujoco, null)
    )
    assert apart < ENGINE_TOLERANCE[name] * (effect if name else 1.0), (apart, effect)
    if name:
        assert effect > 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("world", ["rigid_body", "linearized"])
def test_without_effects_the_declared_model_explains_everything(world):
    """In every condition the unexplained torque of a quiet null run is a small part of what just
    matters.
    """
    zero = "hanging" if world == "rigid_body" else "upright"
    names = [
        c for c in CONDITIONS if c != "one_long" and not (c == "open_loop" and zero == "hanging")
    ]
    specs = [
        Spec(60 + i, c, world=world, angle_zero=zero, seconds=3.0) for i, c in enumerate(names)
    ]
    drafts = [making.draft(s) for s in specs]
    run = making._tame(drafts, making.stack(drafts))
    for d in drafts:
        share = measure(d.rig, run, d.lanes, d.valid(len(run.times)))
        assert share.raw < 0.006, (d.spec, share)
        assert np.all(share.torque > 0)
