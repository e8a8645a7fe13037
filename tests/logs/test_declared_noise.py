"""What `[noise]` of a meta.toml declares is the least that readings count as."""

import numpy as np
import pytest

from adaptsim_jax.attribution.load import load
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.log_meta import LogMeta


def test_the_nearest_name_counts():
    meta = LogMeta(noise={"angle": 1e-4, "q_elbow": 3e-4, "v": 0.01})
    assert meta.least_noise("q", ("hip", "elbow")) == pytest.approx([1e-4, 3e-4])
    assert meta.least_noise("v", ("hip", "elbow")) == pytest.approx([0.01, 0.01])
    assert meta.least_noise("q", ()).shape == (0,)


def test_a_channel_counts_as_no_better_than_declared(tmp_path):
    (tmp_path / "model.xml").write_text(
        '<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/>'
        '<geom size=".02" pos="0 0 -.3" mass="1"/></body></worldbody></mujoco>'
    )
    time = np.arange(0.0, 4.0, 0.01)
    rng = np.random.default_rng(1)
    rows = np.stack([time, 0.5 * np.cos(5.7 * time) + rng.normal(0.0, 1e-4, len(time))], 1)
    np.savetxt(tmp_path / "run.csv", rows, "%.7f", ",", header="time,q_hip", comments="")
    meta, floor = 'task = "mechanism"\nmodel = "model.xml"\n', []
    for more in ("", "[noise]\nq = 5e-4\n", "[noise]\nq = 1e-6\n"):
        (tmp_path / "meta.toml").write_text(meta + more)
        floor.append(load(tmp_path).problem(MACHINE).floor[0])
    assert floor[0] == pytest.approx(1e-4, rel=0.2)
    assert floor[1] == 5e-4 and floor[2] == floor[0]
