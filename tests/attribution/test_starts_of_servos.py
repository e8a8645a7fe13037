"""Starts of long stretches of a machine that follows commands: what a start's speed does dies out
between the rows that are summed.
"""

import numpy as np

from adaptsim_jax.attribution.forecast import forecast
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import prepare
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 0 1" damping="0.5"/>
<inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""  # noqa: E501
LAW = np.array([[10.0], [0.0], [-10.0], [0.0], [-30.0], [30.0]])


def test_a_start_is_not_flung_away_for_what_is_left_elsewhere(tmp_path):
    path = tmp_path / "joint.xml"
    path.write_text(XML)
    time = np.arange(1000) / 50.0
    target = 0.3 * np.sin(2.0 * time)[:, None]
    measured = (
        0.3 * np.sin(2.0 * (time - 0.08))[:, None] + 0.01 * np.sign(np.cos(2.0 * time))[:, None]
    )
    tracks = [JointTrack("whole", time, measured, None, target)]
    problem = prepare(read_mechanism(path).tree, tracks, (MACHINE[0],), LAW, np.ones(1), 19.0)
    found = forecast(problem, Vector((), np.zeros(0)))
    off = np.abs(found.measured - found.simulated)
    assert off.max() < 0.05, "a joint that lags by 0.05 s was thrown away from its first row"
    assert found.error.max() < 0.03
