"""Stretches, parameters and tests by themselves."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.attribution.acting import Values, actuated
from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.parameters import (
    BODY_NUMBERS,
    Entry,
    Vector,
    inertial_of,
    inertias,
    pseudo_inertia,
)
from adaptsim_jax.attribution.problem import (
    Group,
    TreeProblem,
    beginnings,
    noise,
    nuisances,
    prepare,
)
from adaptsim_jax.attribution.stretches import JointTrack, cut
from adaptsim_jax.attribution.tree_objective import acting_joints
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.testing import sign_flip
from adaptsim_jax.effects.base import unit_at
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.drives import drive_play
from adaptsim_jax.effects.joints.sensor import sensor_delay
from adaptsim_jax.mechanisms.tree import make_tree

ROD = np.array([0.6, 0.0, 0.0, -0.09, 0.02, 0.0, 0.0, 0.02, 0.0, 1e-4])


def track(rows=600, rate=250.0, gap=None):
    time = np.arange(rows) / rate
    if gap is not None:
        time[gap:] += 1.0
    q = np.stack([np.sin(3.0 * time), np.cos(2.0 * time)], 1)
    return JointTrack("a", time, q, None, np.stack([time, -time], 1))


def test_pseudo_inertia_and_back():
    with jax.enable_x64(True):
        np.testing.assert_allclose(np.asarray(inertial_of(pseudo_inertia(ROD))), ROD, atol=1e-12)


def test_inertias_are_the_declared_ones_at_zero_and_admissible_anywhere():
    of = inertias(ROD[None])
    np.testing.assert_allclose(of.at(np.zeros((1, len(BODY_NUMBERS))))[0][0], ROD)
    rng = np.random.default_rng(0)
    for _ in range(20):
        value, _ = of.at(rng.normal(size=(1, len(BODY_NUMBERS))))
        own = np.linalg.eigvalsh(np.asarray(pseudo_inertia(value[0])))
        assert own[0] > -1e-6 * own[-1]  # a moment far out leaves single precision's rounding


def test_the_derivative_of_inertias_is_that_of_differences():
    of = inertias(ROD[None])
    numbers = 0.1 * np.random.default_rng(1).normal(size=(1, len(BODY_NUMBERS)))
    _, slope = of.at(numbers)
    for k in range(len(BODY_NUMBERS)):
        step = 1e-6 * np.eye(len(BODY_NUMBERS))[k][None]
        change = (of.at(numbers + step)[0] - of.at(numbers - step)[0])[0] / 2e-6
        np.testing.assert_allclose(slope[0, :, k], change, atol=1e-7)


def test_stretches_cover_a_trial_and_hold_its_command():
    s = cut([track()], 0.5)
    assert (s.count, s.rows, s.joints) == (4, 125, 2)
    np.testing.assert_allclose(s.time[0], [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(s.q[:, 0, 1], np.sin(3.0 * s.time[:, 1]))
    rows = s.command[s.past : s.past + s.rows]
    np.testing.assert_allclose(rows[:, 0], s.time[:-1], atol=1e-9)  # held from its row to the next
    np.testing.assert_allclose(s.start[0], np.sin(3.0 * s.time[0]), atol=1e-4)


def test_no_stretch_spans_a_gap():
    s = cut([track(gap=200)], 0.5)
    assert np.diff(s.time, axis=0).max() < 0.01


def test_a_trial_too_short_is_refused():
    with pytest.raises(BadInput, match=r"unbroken stretch of 5 s"):
        cut([track()], 5.0)


def test_the_sign_flip_test_is_exact_for_few_units():
    assert sign_flip(np.ones(5)) == pytest.approx(1 / 32)
    assert sign_flip(np.array([1.0, -1.0])) == pytest.approx(0.75)
    rng = np.random.default_rng(0)
    low = [sign_flip(rng.normal(size=8)) < 0.05 for _ in range(400)]
    assert 0.01 < np.mean(low) < 0.1


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.008, 0.03])
def test_a_late_sensor_says_what_was_before_between_uneven_rows(delay):
    with jax.enable_x64(True):
        steps = 0.004 + 0.001 * np.random.default_rng(0).random(99)
        t = np.cumsum(np.concatenate([[0.0], steps]))[:, None, None]

        def angle(t):
            return np.concatenate([np.sin(7 * t + 0.3), np.cos(5 * t)], 1)

        def speed(t):
            return np.concatenate([7 * np.cos(7 * t + 0.3), -5 * np.sin(5 * t)], 1)

        def read(d):
            return sensor_delay(
                {"delay": d}, jnp.asarray(t), jnp.asarray(angle(t)), jnp.asarray(speed(t)), None
            )

        at, known = jnp.full((1, 2, 1), delay), int(np.ceil(delay / 0.004))
        (q, v), (slope, _) = jax.jvp(read, (at,), (jnp.ones_like(at),))
        q, v, slope = np.asarray(q), np.asarray(v), np.asarray(slope)
    np.testing.assert_allclose(q[known:], angle(t - delay)[known:], atol=1e-8)
    np.testing.assert_allclose(v[known:], speed(t - delay)[known:], atol=2e-3)
    np.testing.assert_allclose(slope[known + 1 :], -speed(t - delay)[known + 1 :], atol=1e-4)
    np.testing.assert_allclose(
        q[:known], angle(t - delay)[:known], atol=2e-3
    )  # the motion went on at its first acceleration


def test_of_a_stretch_only_the_beginning_is_seen():
    group = Group(
        cast(Any, None),
        (0, 1),
        cut([track()], 0.5),
        np.zeros((6, 2)),
        np.ones(2),
        inertias(ROD[None]),
    )
    whole = TreeProblem(
        (group,),
        ("a", "b"),
        ("hinge",) * 2,
        (),
        cast(Any, None),
        np.zeros(4, int),
        ("a",),
        {},
        np.zeros(4),
    )
    (short,) = beginnings(whole, 0.2).groups
    assert short.stretches.seen[:26].all() and not short.stretches.seen[26:].any()
    assert group.stretches.seen.all()


def test_an_effect_at_all_joints_is_told_where_it_acts():
    entries = tuple(Entry("coulomb", "level", (j,), 0.0, 0.0, 0.0, 1.0, "N m") for j in range(3))
    everywhere = JointCandidate("coulomb", (0, 1, 2), "all", entries)
    acting, still = acting_joints(Vector(entries, np.array([0.0, 0.2, 0.0])), everywhere)
    assert (acting.joints, acting.sharing, still) == (
        (1,),
        "joint",
        [entries[0].key, entries[2].key],
    )
    assert acting_joints(Vector(entries, np.zeros(3)), everywhere) == (everywhere, [])


@pytest.mark.parametrize(
    ("unit", "slide"),
    [("N m", "N"), ("kg m^2", "kg"), ("rad/(N m)", "m/N"), ("1", "1"), ("s", "s")],
)
def test_units_are_those_of_the_joint(unit, slide):
    assert (unit_at(unit, "hinge"), unit_at(unit, "slide")) == (unit, slide)


@pytest.mark.parametrize("target", [-1.0, -0.01, 0.003, 0.03, 1.0])
def test_a_controller_behind_play_answers_to_what_its_encoder_reads(target):
    """kp (target - reading), with the link held at 0: none of it acts while the motor is between
    the sides of the play.
    """
    kp, gap, width = 40.0, 0.0625, 0.01

    def wide(z):
        return jnp.full((1, 1), z)

    law = jnp.array([kp, 0.0, -kp, 0.0, -np.inf, np.inf])[:, None, None]
    effects = {"drive_play": {"gap": wide(gap), "width": wide(width)}}
    torque = actuated(
        Values(None, None, law, wide(1.0), effects), wide(0.0), wide(0.0), wide(target)
    )[0]
    time, still = jnp.arange(4.0)[:, None], jnp.zeros((4, 1))
    reading = drive_play(
        {"gap": gap, "width": width}, time, still, still, still[0], torque + still
    )[0]
    np.testing.assert_allclose(torque[0], kp * (target - reading[0]), rtol=1e-4, atol=1e-5)
    assert abs(float(reading[0, 0])) <= gap / 2 and (
        abs(target) > gap / 2 or abs(float(torque[0, 0])) < width
    )


def test_a_joint_that_nothing_drives_may_have_friction_though_its_file_has_none():
    """Its torque scale is that of its own weight, not of an actuator it lacks: a bound of 0 would
    hold its damping there.
    """
    tree = make_tree(
        ["hinge"],
        [-1],
        np.zeros((1, 3)),
        np.array([[[0, 0, -1.0], [0, 1.0, 0], [1.0, 0, 0]]]),
        np.array([[1.0, 0.0, 0.0, 0.3, 0.1, 0.0, 0.0, 0.1, 0.0, 0.01]]),
    )
    time = np.arange(0.0, 4.0, 0.005)
    track = JointTrack(
        "swing", time, 0.5 * np.sin(5.0 * time)[:, None], None, np.zeros((len(time), 1))
    )
    problem = prepare(tree, (track,), tuple(e for e in MACHINE if e.name == "viscous"))
    (high,) = (e.high for e in nuisances(problem).entries if e.owner == "viscous")
    assert high > 0.1


def test_an_encoder_that_mostly_rests_has_the_noise_of_its_steps():
    """Steps of 1 mrad, at rest two thirds of the time: rounding of the file is no noise."""
    time = np.arange(600) * 0.02
    moving = np.where(time % 6.0 < 2.0, 0.3 * np.sin(np.pi * time), 0.0)
    q = (np.round((0.4 + moving) / 1e-3) * 1e-3)[:, None]
    assert np.median(np.abs(np.diff(q, 3, axis=0))) < 1e-12
    (size,) = noise([JointTrack("t", time, q, None, 0.0 * q)])[:1]
    assert 1e-4 < size < 1e-3
