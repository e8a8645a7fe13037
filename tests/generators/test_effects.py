"""Each hidden effect does what it says, is nothing at zero size, and comes in the size that was
asked for.
"""

import numpy as np
import pytest

from tests.generators import Spec, effects, forces, make_datasets
from tests.generators import dataset as making
from tests.generators.effects import EFFECTS, Table
from tests.generators.excitation import mass_at_rest
from tests.generators.simulate import Delay, play, simulate
from tests.generators.suites import PLACES
from tests.generators.worlds import lanes_of

SHORT = {"n_trials": 3, "seconds": 2.0, "angle_zero": "hanging"}
RULER = effects.Scale(torque=1.0, torque_peak=0.5, speed=2.0, q_low=-1.0, q_high=1.0, inertia=0.05)


def run_with(table_of, seed=21, **kwargs):
    """A quiet run of one short data set with the table that `table_of(lanes)` makes."""
    d = making.draft(Spec(seed, "clean", **(SHORT | kwargs)))
    drive = making.stack([d]).quiet()
    lanes = drive.times.shape[1]
    table = table_of(lanes)
    return d, drive, simulate(lanes_of([d.rig], [lanes]), table, drive, table.step())


def table_with(name, joint=0, **changes):
    def build(lanes):
        t = Table(lanes)
        if name:
            params = effects.draw(name, np.random.default_rng(5), RULER) | changes
            t.add(name, joint, slice(0, lanes), params)
        return t

    return build


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_nothing_at_zero_size(name):
    short = {"n_trials": 2, "seconds": 0.6}
    _, _, null = run_with(table_with(""), **short)
    _, _, zero = run_with(table_with(name, size=0.0), **short)
    assert np.abs(null.measured - zero.measured).max() < 1e-6
    reached = {"angle": 0.0} if name == "hard_stop" else {}
    _, _, some = run_with(table_with(name, **reached), **short)
    assert np.abs(null.measured - some.measured).max() > 1e-4


def test_friction_forces_take_energy_and_hard_stops_only_push():
    rng = np.random.default_rng(0)
    q, v, u = rng.normal(size=(3, 2, 40))
    inertia, phase = np.full((2, 40), 0.02), np.zeros(40)
    for name in ("coulomb", "stribeck", "quadratic_drag", "friction_drift", "load_friction"):
        (force,) = forces.force_terms(table_with(name, 1)(40), inertia, 1e-4, phase)
        power = force(q, v, 0.3, u) * v
        assert np.all(power <= 0) and power[1].min() < 0 and np.all(power[0] == 0)
    (stop,) = forces.force_terms(
        table_with("hard_stop", 1, side=1.0, angle=0.5)(40), inertia, 1e-4, phase
    )
    push = stop(q, v, 0.0, u)[1]
    assert np.all(push <= 0) and np.all(push[q[1] < 0.5] == 0) and push.min() < 0


def test_command_effects_by_value():
    u = np.array([[0.02], [3.0]])
    t = Table(1)
    t.add("torque_gain", 0, slice(0, 1), {"size": 0.2, "sign": -1.0})
    t.add("dead_zone", 0, slice(0, 1), {"size": 0.01})
    t.add("saturation", 1, slice(0, 1), {"size": 0.5, "peak": 4.0})
    np.testing.assert_allclose(forces.static_command(t, u), [[0.02 * 0.8 - 0.01], [2.0]])


def test_delay_shifts_by_rows_and_averages_fractions():
    times = np.arange(5)[:, None] * 0.1
    commands = np.arange(1.0, 6.0)[:, None, None] * np.ones((5, 2, 1))
    late = Delay(np.array([[0.1], [0.05]]), times, commands)
    seen = np.array([late(times[k], np.array([0.1]))[:, 0] for k in range(5)])
    np.testing.assert_allclose(seen[:, 0], [0, 1, 2, 3, 4], atol=1e-9)  # a whole row late
    np.testing.assert_allclose(
        seen[:, 1], [0.5, 1.5, 2.5, 3.5, 4.5], atol=1e-9
    )  # half a row: the mean


def test_a_stuck_joint_stays():
    """Friction above the torque holds joint 2: it creeps slower than the width of the smoothed
    sign.
    """
    level = 5.0
    d, _, run = run_with(table_with("coulomb", 1, size=level))
    _, _, free = run_with(table_with(""))
    mass = mass_at_rest(d.rig)
    width = forces.stick_speed(np.array(level), np.linalg.det(mass) / mass[0, 0], 2.5e-4)
    assert np.abs(run.state[100:, 3]).max() < width
    assert np.all(10 * np.ptp(run.state[100:, 1], axis=0) < np.ptp(free.state[100:, 1], axis=0))


def test_play_keeps_its_distance():
    z, path = np.zeros(1), []
    for q in [0.05, 0.2, 0.15, 0.02, -0.2]:
        z = play(np.array([q]), z, np.array([0.2]))
        path.append(float(z[0]))
    np.testing.assert_allclose(path, [0.0, 0.1, 0.1, 0.1, -0.1])


def test_tilt_is_an_offset_of_the_first_encoder():
    """The two that no recording can tell apart, in open loop: q1 + a against gravity, or the frame
    turned by a.
    """
    d = making.draft(Spec(21, "clean", **SHORT))
    drive = making.stack([d]).quiet()
    drive.gain[:] = 0.0
    p = lanes_of([d.rig], [3])
    tilt, offset = Table(3), Table(3)
    tilt.add("tilt", 0, slice(0, 3), {"size": 0.1, "sign": 1.0})
    offset.add("encoder_offset", 0, slice(0, 3), {"size": 0.1, "sign": -1.0})
    a = simulate(p, tilt, drive, 1e-3)
    drive.start[0] += 0.1
    b = simulate(p, offset, drive, 1e-3)
    assert np.abs(a.measured - b.measured).max() < 1e-9


def test_lag_of_the_sensor_trails_the_motion():
    _, _, run = run_with(table_with("sensor_lag", 1, size=0.02))
    k = slice(40, None)
    lagged, true, slope = run.clean[k, 1], run.state[k, 1], run.state[k, 3]
    gain = np.sum((true - lagged) * slope) / np.sum(slope**2)
    assert gain == pytest.approx(0.02, rel=0.15)


@pytest.mark.slow
def test_small_sizes_are_in_proportion():
    """A two-hundredth of what just matters is a twentieth of its tenth."""
    tenth, tiny = (
        make_datasets([Spec(70, "clean", (("coulomb", 2, m),), **SHORT)])[0].truth["effects"][0]
        for m in (0.1, 0.005)
    )
    assert tiny["parameters"]["size"] == pytest.approx(tenth["parameters"]["size"] / 20)
    assert tiny["multiple_reached"] == pytest.approx(tenth["multiple_reached"] / 20)


@pytest.mark.slow
def test_sizes_are_what_was_asked_for():
    """Three times the size that just matters: the declared model leaves 9 % of the torque
    unexplained.
    """
    specs = [Spec(70 + i, "clean", ((n, j, 3.0),), **SHORT) for i, (n, j) in enumerate(PLACES)]
    for ds in make_datasets(specs):
        (e,) = ds.truth["effects"]
        share = e["share_raw"] if e["confounded"] else e["share_unexplained"]
        assert share == pytest.approx(0.03 * e["multiple_reached"])
        at_bound = e["parameters"]["size"] in (
            effects.LARGEST.get(e["name"]),
            effects.SMALLEST.get(e["name"]),
        )
        assert at_bound or e["multiple_reached"] == pytest.approx(3.0, rel=0.25), e
        assert e["confounded"] == ((e["name"], e["where"]) == ("rotor_inertia", "joint1"))
