"""A bus slower than its topic: each reading stands in several rows."""

import itertools

import numpy as np
import pytest

from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion, named

M = motion(2, rows=600, dt=0.002)
ARM = ("shoulder", "elbow")


def held(x, ratio):
    """What is read every `ratio` rows, published in each row."""
    first = (np.floor(np.arange(len(x)) / ratio) * ratio + 0.5).astype(int)
    return x[first]


@pytest.mark.parametrize("ratio", [5, 2, 4.4])
def test_readings_that_stand_in_several_rows_are_taken_once(tmp_path, ratio):
    new = np.concatenate([[0], np.flatnonzero(np.any(np.diff(held(M["q"], ratio), axis=0), 1)) + 1])
    columns = M | {s: held(M[s], ratio) for s in ("q", "v")} | {"target": M["tau"]}
    log = read_log(folder(tmp_path, "", run=named(columns, ARM, "q", "v", "target")), ARM)
    (trial,) = log.trials
    np.testing.assert_allclose(trial.time, M["time"][new], atol=1e-12)
    np.testing.assert_array_equal(trial.q, held(M["q"], ratio)[new])
    assert trial.v is not None
    np.testing.assert_array_equal(trial.v, held(M["v"], ratio)[new])
    means = [M["tau"][a:b].mean(0) for a, b in itertools.pairwise(new)]
    np.testing.assert_allclose(trial.u[:-1], means, atol=1e-12)
    assert any("each reading stands in about" in note for note in log.notes)


def test_steps_of_a_coarse_encoder_are_no_repeated_readings(tmp_path):
    """A slow joint stands on each count for ten rows."""
    count = 2 * np.pi / 1024
    slow = np.floor(np.arange(600) / 10)[:, None] * count * np.ones((1, 2))
    for q in (slow, np.round(M["q"] / count) * count):
        data = folder(tmp_path / f"{q[7, 1]}", "", run=named(M | {"q": q}, ARM, "q", "tau"))
        assert len(read_log(data, ARM).trials[0].time) == 600


def test_a_joint_that_rests_now_and_then_is_read_once_all_the_same(tmp_path):
    rests = np.where(
        (np.arange(600) // 100 % 2 == 0)[:, None], M["q"], M["q"][100 * (np.arange(600) // 100)]
    )
    data = folder(tmp_path, "", run=named(M | {"q": held(rests, 5)}, ARM, "q", "tau"))
    trial = read_log(data, ARM).trials[0]
    assert len(trial.time) < 100 and np.all(np.isin(trial.time, M["time"]))
