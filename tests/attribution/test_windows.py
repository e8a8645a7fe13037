"""Speeds, weights and windows of a balance of torques."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.attribution.equation.balance import inside
from adaptsim_jax.attribution.equation.solve import compared
from adaptsim_jax.attribution.equation.windows import runs_of
from adaptsim_jax.attribution.stretches import JointTrack


def test_speeds_are_those_of_the_motion_where_a_stiff_controller_shows_them():
    time = np.arange(0.0, 8.0, 0.005)
    q = np.stack([np.sin(2 * np.pi * 1.2 * time)], 1)
    (run,) = runs_of([JointTrack("a", time, q, None, np.zeros_like(q))], np.full(1, 1e-6))
    true = 2 * np.pi * 1.2 * np.cos(2 * np.pi * 1.2 * run.time)
    assert (
        np.abs(run.v[0] - true)[20:-20].max() < 1e-4 * np.abs(true).max()
    )  # 2e-3 by the slope of a local quadratic


def test_a_joint_that_neither_set_explains_does_not_outweigh_the_others():
    blocks = np.arange(20)
    rows = SimpleNamespace(fold=blocks // 5, block=blocks)

    def loss(first):
        return SimpleNamespace(loss=np.stack([np.full(20, first), np.full(20, 100.0)], 1))

    test = compared(rows, loss(1.0), loss(0.1), [0, 1])
    assert test.gain == pytest.approx(
        1.0 - (0.5 * (0.1 + 1.0) + 0.1) / 1.1
    )  # one of two joints by nine tenths, floor 0.1
    assert test.p < 0.01


def test_windows_within_an_encoders_offset_of_the_end_of_a_range_are_left_out():
    tree = SimpleNamespace(
        range=np.array([[-2.0, 2.0], [0.0, 0.04], [0.0, 0.0]]),
        limited=np.array([True, True, False]),
    )
    q = np.array([[1.9, 1.97], [0.001, 0.0005], [9.0, -9.0]])
    assert inside(tree, q).tolist() == [[True, False], [True, False], [True, True]]
