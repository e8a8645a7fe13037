"""The recording for Rerun holds what was measured and simulated, and where the robot was."""

import sys

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.replay import Replay
from adaptsim_jax.cli import main
from adaptsim_jax.report import rerun as ours

ARM = """<mujoco><worldbody><body name="rod" pos="0 0 1"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>
<body name="tip" pos="0 0 -1"><inertial pos="0 0 -0.1" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"""


def replay(simulated):
    """Two stretches of three rows, of a trial each, with one joint."""
    time = np.array([[0.0, 0.1, 0.2], [1.0, 1.1, 1.2]])
    measured, nothing = np.pi / 2 * time[..., None], np.zeros((2, 1))
    names = (("hinge",), ("hinge",), ("a b", "c"), np.arange(2))
    return Replay(*names, nothing, time, measured, simulated * measured, nothing, 0.2)


def test_it_holds_angles_residuals_and_the_robot(tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    path = tmp_path / ours.NAME
    model = mujoco.MjModel.from_xml_string(ARM)
    ours.save_rerun(path, {"declared": replay(0.5), "mended": replay(1.0)}, model)
    columns = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            columns[chunk.entity_path, name.rpartition(":")[2]] = column.to_pylist()
    angle = [row[0] for row in columns["/c/angle/hinge/measured", "scalars"]]
    np.testing.assert_allclose(angle, np.pi / 2 * np.array([1.0, 1.1, 1.2]))
    residual = [row[0] for row in columns["/c/residual/hinge/declared", "scalars"]]
    np.testing.assert_allclose(residual, np.array(angle) / 2)
    assert not np.any(columns["/c/residual/hinge/mended", "scalars"])
    place = np.array(columns["/c/robot/measured/tip", "translation"])[:, 0]
    np.testing.assert_allclose(place[0], [-1.0, 0.0, 1.0], atol=1e-6)  # a quarter turn, at 1 s
    assert any(entity.startswith("/a\\ b/robot/mended") for entity, _ in columns)


def test_without_rerun_one_line_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "meta.toml").write_text('task = "mechanism"\nmodel = "arm.xml"\n')
    command = ["diagnose", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--rerun"]
    assert main(command) == 2
    assert "pip install 'adaptsim_jax[rerun]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
