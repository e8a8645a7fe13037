"""Damaged files: whatever bytes are lost or changed, a log is read or refused in one line that
names a file.
"""

import shutil

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion, numbered

ARM = ("shoulder", "elbow")
M = motion(2)


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """`data` cut short, with bytes changed, or with a piece twice."""
    if not data:
        return data
    how, at = rng.integers(3), int(rng.integers(len(data)))
    if how == 0:
        return data[:at]
    if how == 1:
        out = bytearray(data)
        for i in rng.integers(len(data), size=8):
            out[i] = rng.integers(256)
        return bytes(out)
    return data[:at] + data[max(at - 40, 0) :]


def make(kind: str, path):
    if kind in ("csv", "meta.toml"):
        meta = (
            'ignore = ["q9"]\n[units]\nangle = "rad"\n[angles]\nzero = {elbow = 0.1}\n'
            '[trials]\ncommands = {a = ["t*"]}\n'
        )
        folder(path, meta, t=numbered(M, "q", "v", "tau"))
        return path / ("t.csv" if kind == "csv" else "meta.toml")
    path.mkdir()
    if kind == "npz":
        np.savez(path / "run.npz", time=M["time"], q=M["q"], tau=M["tau"])
        return path / "run.npz"
    if kind == "parquet":
        pytest.importorskip("pyarrow", reason="extra 'lerobot' is not installed")
        from tests.logs.test_lerobot import data_set

        return next(data_set(path / "set").rglob("*.parquet"))
    pytest.importorskip("rosbags", reason="extra 'ros' is not installed")
    from tests.logs.test_bags import Bag, states

    bag = Bag(kind)
    states(bag)
    bag.array("/arm/commands", 1_700_000_000_000_000_000, [1.0, 2.0])
    written = bag.write(path)
    return next(written.glob("*.db3")) if kind == "ros2" else written


@pytest.mark.parametrize("kind", ["csv", "meta.toml", "npz", "parquet", "bag", "ros2", "mcap"])
def test_damage_is_refused_in_one_line(tmp_path, kind):
    file = make(kind, tmp_path / "whole")
    whole, rng, refusals = file.read_bytes(), np.random.default_rng(0), 0
    source = {
        "parquet": tmp_path / "whole" / "set",
        "ros2": file.parent,
        "bag": file,
        "mcap": file,
    }.get(kind, file.parent)
    for _ in range(40):
        file.write_bytes(damaged(whole, rng))
        try:
            read_log(source, ARM)
        except BadInput as error:
            refusals += 1
            assert "\n" not in str(error) and str(tmp_path) in str(error)
    assert refusals > 5
    shutil.rmtree(tmp_path / "whole")
