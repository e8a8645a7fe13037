"""The same sweep on one device, on four, and by two programs that join over loopback: equal but for
rounding.
"""

import json
import socket

import numpy as np
import pytest

from adaptsim_jax.adaptation.sweep_plan import choose_split
from tests.sweep.small import SPEC, run, start, write

FEW = (
    SPEC.replace("[0.1, 0.15]", "[0.1]")
    .replace("[3e-4, 1e-3]", "[1e-3]")
    .replace("seeds = 2", "seeds = 3")
)


def test_members_are_split_first_then_trajectories():
    assert choose_split(4, 64, 50) == (4, 1)
    assert choose_split(4, 2, 50) == (2, 2)
    assert choose_split(4, 1, 50) == (
        4,
        1,
    )  # 50 trajectories do not divide by four: padded with copies
    assert choose_split(4, 1, 100) == (1, 4)
    assert choose_split(4, 3, 8) == (2, 2)  # the fourth place of each is a copy
    assert choose_split(4, 2, 0) == (4, 1)


def rows(folder):
    return json.loads((folder / "results.json").read_text())["rows"]


def same(a, b):
    """Equal to what float32 sums in another order leave, over the whole training."""
    assert [(r["member"], r["status"]) for r in a] == [(r["member"], r["status"]) for r in b]
    for one, other in zip(a, b, strict=True):
        np.testing.assert_allclose(one["curve"], other["curve"], rtol=1e-4, atol=1e-4)
        for name, found in one["targets"].items():
            np.testing.assert_allclose(
                found["rewards"], other["targets"][name]["rewards"], rtol=1e-4, atol=1e-4
            )


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    run([write(folder, FEW), "--out", folder / "out"])
    return rows(folder / "out")


@pytest.mark.slow
@pytest.mark.parametrize(("at_once", "split"), [(3, "2 x 2"), (4, "2 x 2"), (1, "1 x 4")])
def test_four_devices_find_what_one_does(alone, tmp_path, at_once, split):
    said = run([write(tmp_path, FEW), "--out", tmp_path / "out", "--at-once", at_once], devices=4)
    assert f"over {split} devices" in said
    same(rows(tmp_path / "out"), alone)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.slow
def test_two_programs_over_loopback_find_what_one_does(alone, tmp_path):
    spec, where = write(tmp_path, FEW), f"127.0.0.1:{free_port()}"
    words = [
        spec,
        "--out",
        tmp_path / "out",
        "--hosts",
        where,
        "--processes",
        "2",
        "--save-every",
        "0",
    ]
    both = [start([*words, "--process", i]) for i in range(2)]
    said = [p.communicate(timeout=400)[0] for p in both]
    assert [p.returncode for p in both] == [0, 0], said
    assert "3 members done" in said[0] and "members" not in said[1]
    same(rows(tmp_path / "out"), alone)
