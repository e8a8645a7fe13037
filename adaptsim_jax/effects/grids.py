"""Shapes at which force effects are scored, from what the data cover, and where fits of them
start.
"""

import numpy as np

FINEST = 1.0 / 12.0  # Hz between frequencies of the grid
STIFF = 30.0  # N m/rad for each N m of the rig's torque


def speeds(reach, joint):
    top = float(reach.speed[joint])
    return [{"speed": top * s} for s in (0.05, 0.1, 0.2, 0.4)]


def orders(reach, joint):
    return [{"order": float(k)} for k in range(2, 31)]


def frequencies(reach, joint):
    """Half a cycle of a trial apart, so that no frequency between two points goes unseen; at most
    half of Nyquist. In long trials no finer than `FINEST`.
    """
    top = min(15.0, 0.25 / reach.dt)
    step = max(0.5 / reach.duration, FINEST)
    return [{"frequency": float(f)} for f in np.arange(step, top, step)[:160]]


def stops(reach, joint):
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    span = high - low
    upper = [{"angle": high - span * s, "side": 1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]
    return upper + [{"angle": low + span * s, "side": -1.0} for s in (0.03, 0.08, 0.15, 0.25, 0.4)]


def deflections(reach, joint):
    span = float(reach.q_high[joint] - reach.q_low[joint])
    fitting = [d for d in (0.005, 0.012, 0.03, 0.07) if d < 0.3 * span] or [0.1 * span + 1e-3]
    return [{"deflection": d, "damping": s} for d in fitting for s in (0.0, 0.01)]


def decays(reach, joint):
    return [{"decay": reach.duration * s} for s in (0.1, 0.2, 0.4, 1.0)]


def stiff_stops(reach, joint):
    """Stops as hard as most are, where the motion ends and a little before. One that is hit hard
    throws the model so far off that a linear score makes it soft and puts it well inside. From
    there no fit finds the way to it.
    """
    low, high = float(reach.q_low[joint]), float(reach.q_high[joint])
    stiff = {"stiffness": STIFF * float(reach.torque[joint]), "loss": 0.0, "damping": 0.0}
    inside = [0.015 * s * (high - low) for s in (0.0, 1.0)]
    return [stiff | {"angle": high - d, "side": 1.0} for d in inside] + [
        stiff | {"angle": low + d, "side": -1.0} for d in inside
    ]
