"""A camera's record of scoops as the task observes it, and the records that are refused with their
row.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import measured, model
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, ScoopingPolicy
from adaptsim_jax.tasks.scooping.trial import PLACES

CONFIG = ScoopingConfig(hidden=(16,))
NAF = scooping.make_scooping_naf(CONFIG)
POLICY = ScoopingPolicy(NAF.init(jax.random.key(1)).online)
SCOOPS = measured.trials_to_make(jax.random.key(7), 2, POLICY, CONFIG)


def AT(i):
    return f"record.csv: line {i + 2}"


def record(fps=60):
    """Both scoops: pieces that lie for 0.2 s and then go 0.2 m at 0.4 m/s; the first ends on the
    spatula.
    """
    time = np.arange(0, 1.02, 1 / fps)
    rows = [
        np.stack(
            [
                np.full_like(time, n),
                time,
                0.5 + 0.001 * n + 0.4 * np.clip(time - 0.2, 0, 0.5),
                0.02 + 0 * time,
                on * (time > 0.9),
            ],
            1,
        )
        for n, on in zip(SCOOPS.numbers, (1.0, 0.0), strict=True)
    ]
    return dict(zip(measured.COLUMNS, np.concatenate(rows).T, strict=True))


def told(columns):
    return measured.measured_trajectory(columns, AT, "record.csv", SCOOPS)


def test_the_same_session_asks_for_the_same_scoops():
    again = measured.trials_to_make(jax.random.key(7), 2, POLICY, CONFIG)
    other = measured.trials_to_make(jax.random.key(7), 3, POLICY, CONFIG)
    assert again.numbers.tolist() == [5, 6] and other.numbers.tolist() == [7, 8]
    np.testing.assert_array_equal(again.contexts, SCOOPS.contexts)
    assert not np.allclose(other.contexts, SCOOPS.contexts) and np.all(
        np.abs(SCOOPS.contexts) <= PLACES
    )
    assert np.all(SCOOPS.actions >= np.array(model.ACTION_LOW) - 1e-6)
    assert np.all(SCOOPS.actions <= np.array(model.ACTION_HIGH) + 1e-6)


def test_a_record_is_seen_from_where_the_piece_lay():
    got = told(record())
    expected = 0.4 * np.clip(np.array(model.OBSERVED_AT) - 0.2, 0, 0.5)
    np.testing.assert_allclose(got.points[:, :, 0], np.tile(expected, (2, 1)), atol=4e-3)
    np.testing.assert_allclose(got.points[:, :, 1], 0.0, atol=1e-6)
    assert got.success.tolist() == [1.0, 0.0] and float(got.tested) == 0.5
    assert scooping.observed(got).shape == (32,)


def _without(columns, name):
    return {key: value for key, value in columns.items() if key != name}


def _changed(columns, name, rows, value):
    columns[name][rows] = value
    return columns


LINES = len(record()["time"]) // 2


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda c: _without(c, "on"), "column 'on' is missing"),
        (lambda c: _changed(c, "trial", slice(0, 1), 4), "line 2: trial 4 was told already"),
        (lambda c: _changed(c, "trial", slice(0, 1), 9), "trial 9 was never asked for"),
        (lambda c: _changed(c, "trial", slice(LINES, None), 5), "runs backwards"),
        (lambda c: {k: v[:LINES] for k, v in c.items()}, "trial 6 is missing"),
        (lambda c: _changed(c, "x", slice(0, 1), 500.0), "mm or cm"),
        (lambda c: _changed(c, "on", slice(3, 4), 0.5), "line 5: on = 0.5"),
        (lambda c: {k: v[c["time"] < 0.8] for k, v in c.items()}, "ends at"),
        (lambda c: {k: v[c["time"] > 0.25] for k, v in c.items()}, "begins at"),
        (
            lambda c: {k: v[(c["time"] < 0.4) | (c["time"] > 0.55)] for k, v in c.items()},
            "nothing was recorded from",
        ),
        (lambda c: _changed(c, "x", slice(20, 21), 0.9), "jumps"),
    ],
)
def test_records_that_are_refused(spoil, says):
    with pytest.raises(BadInput, match=says):
        told(spoil(record()))


def test_a_policy_comes_back_from_its_file(tmp_path):
    path = tmp_path / "best.toml"
    configs.write(path, {"hidden": [16], "policy": {"weights": POLICY.weights.tolist()}})
    act = measured.read_policy(path)
    place = jnp.array([0.01, -0.02])
    np.testing.assert_allclose(act(place), scooping.make_policy(CONFIG)(POLICY, place), rtol=1e-5)
    configs.write(path, {"hidden": [8], "policy": {"weights": POLICY.weights.tolist()}})
    with pytest.raises(BadInput, match="no policy of scooping"):
        measured.read_policy(path)
