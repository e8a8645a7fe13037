"""Torques that come from outside of the mechanism, or repeat with the angle or with time."""

import jax.numpy as jnp

from adaptsim_jax.core.trig import sin_cos
from adaptsim_jax.effects import grids
from adaptsim_jax.effects.base import Effect, Motion, Parameter


def bias(p, m: Motion):
    return p["torque"] + 0.0 * m.q


def cogging(p, m: Motion):
    """A ripple and its second harmonic, which is written as a share of the first and turned with
    it.
    """
    at = p["order"] * m.q
    sine, cosine, ahead, across = p["sine"], p["cosine"], p["second_sine"], p["second_cosine"]
    sin, cos = sin_cos(at)
    second_sine, second_cosine = sine * ahead - cosine * across, sine * across + cosine * ahead
    return (
        sine * sin
        + cosine * cos
        + second_sine * 2.0 * sin * cos
        + second_cosine * (cos * cos - sin * sin)
    )


def at_phase(p, m: Motion):
    """What goes on between trials, so that each trial meets it at another phase."""
    phase = 2.0 * jnp.pi * p["frequency"] * (m.t if m.clock is None else m.clock)
    sin, cos = sin_cos(phase)
    return p["sine"] * sin + p["cosine"] * cos


def periodic_disturbance(p, m: Motion):
    return at_phase(p, m) + 0.0 * m.q


BIAS = Effect(
    "bias",
    "force",
    (Parameter("torque", "N m", -1.0, 1.0, 0.0),),
    bias,
    "a constant torque: torque-sensor zero, cable pull, imbalance",
    "a wide range of angles",
    ("tilt", "encoder_offset", "spring"),
    formula="torque",
)

COGGING = Effect(
    "cogging",
    "force",
    (
        Parameter("sine", "N m", -1.0, 1.0, 0.0),
        Parameter("cosine", "N m", -1.0, 1.0, 0.0),
        Parameter("order", "1", 2.0, 200.0, 7.0, None, meaning="periods a turn"),
        Parameter(
            "second_sine",
            "1",
            -1.0,
            1.0,
            0.0,
            None,
            optional=True,
            meaning="second harmonic",
            late=True,
        ),
        Parameter(
            "second_cosine",
            "1",
            -1.0,
            1.0,
            0.0,
            None,
            optional=True,
            meaning="second harmonic",
            late=True,
        ),
    ),
    cogging,
    "torque ripple periodic in the joint's angle (magnets, gear teeth)",
    "slow sweeps over many periods",
    ("spring",),
    grid=grids.orders,
    formula="sine sin(order q) + cosine cos(order q) + second harmonic",
)

PERIODIC_DISTURBANCE = Effect(
    "periodic_disturbance",
    "force",
    (
        Parameter("sine", "N m", -1.0, 1.0, 0.0),
        Parameter("cosine", "N m", -1.0, 1.0, 0.0),
        Parameter("frequency", "Hz", 0.05, 60.0, 2.0, None),
    ),
    periodic_disturbance,
    "a torque periodic in time: a fan, mains, a neighbouring machine",
    "long trials whose commands leave that frequency free",
    ("cogging",),
    grid=grids.frequencies,
    formula="sine sin(2 pi frequency t) + cosine cos(2 pi frequency t), t through all trials",
)
