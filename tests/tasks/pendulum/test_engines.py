"""The pendulum in every engine that is installed, against native MuJoCo, in double precision.

MJX and native MuJoCo take the same Runge-Kutta steps of the same equations, so they may differ by
rounding, grown over 500 steps of a mildly unstable motion: 1e-10 is ten thousand times
what was seen. Drake integrates with error control to 1e-10, MuJoCo with a fixed step, whose error
falls with its fourth power: 1.1e-6 at 1 ms, 6e-8 at the 0.5 ms compared here, so 1e-6 has room.
"""

import json

import jax
import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pendulum import engines as pendulum

TOLERANCE = {"mjx": 1e-10, "drake": 1e-6}


@pytest.fixture(scope="module")
def inputs():
    return pendulum.draw(seed=5, samples=4, steps=500)


@pytest.fixture(scope="module")
def reference(inputs):
    return pendulum.make_backend("native").simulate(*inputs)


@pytest.mark.slow
@pytest.mark.parametrize("name", TOLERANCE)
def test_backend_agrees_with_native_mujoco(name, inputs, reference):
    if name == "drake":
        pytest.importorskip("pydrake")
    dt = 5e-4 if name == "drake" else 1e-3
    if name == "drake":
        reference = pendulum.make_backend("native", dt).simulate(*inputs)
    with jax.enable_x64(True):
        out = pendulum.make_backend(name, dt).simulate(*inputs)
    assert out.state.shape == reference.state.shape == (4, 500, 4)
    assert not np.any(out.code) and not np.any(reference.code)
    np.testing.assert_allclose(out.state, reference.state, rtol=0, atol=TOLERANCE[name])


def test_every_parameter_reaches_every_backend(inputs):
    """A change of any one parameter moves the end state alike in both (l2 has no dynamics)."""
    params, commands, initial = (x[:1] for x in inputs)
    changed = np.repeat(params, 10, 0) * (1 + 0.1 * np.eye(10))
    batch = (changed, np.repeat(commands, 10, 0), np.repeat(initial, 10, 0))
    native = pendulum.make_backend("native")
    ends = native.simulate(*batch).state[:, -1]
    with jax.enable_x64(True):
        ours = np.asarray(pendulum.make_backend("mjx").simulate(*batch).state)[:, -1]
    np.testing.assert_allclose(ours, ends, rtol=0, atol=1e-10)
    moved = np.abs(ends - native.simulate(params, commands, initial).state[:, -1]).max(1)
    names = np.array(pendulum.PARAMETERS)
    assert set(names[moved < 1e-6]) == {"l2"}


def test_a_motion_that_diverges_is_told(inputs):
    params, commands, initial = inputs
    bad = params.copy()
    bad[1, 8] = np.nan
    with jax.enable_x64(True):
        out = pendulum.make_backend("mjx").simulate(bad, commands, initial)
    assert list(out.code) == [0, 1, 0, 0]


def test_bad_names_and_steps_are_refused():
    with pytest.raises(BadInput, match="backend 'mujoco' is unknown; known: native"):
        pendulum.make_backend("mujoco")
    with pytest.raises(BadInput, match="out of range"):
        pendulum.make_backend("native", dt=1.0)


@pytest.mark.slow
def test_the_table_of_parity(capsys):
    assert main(["parity", "pendulum", "--samples", "4", "--seed", "5", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["backend"] for row in rows] == ["native", "mjx", "drake"]
    for row in rows:
        if row["ran"]:
            assert (
                row["angle_max"] < TOLERANCE.get(row["backend"], 0.0) or row["backend"] == "native"
            )
            assert row["diverged"] == 0
        else:
            assert "not installed" in row["why"]


def test_the_table_for_a_person():
    found = {"task": "pendulum", "samples": 1, "seconds": 0.05, "reference": "native"}
    sizes = {"angle_median": 0.5, "angle_max": 1.0, "velocity_median": 0.5, "velocity_max": 2.0}
    rows = [
        {"backend": "native", "ran": True, "diverged": 0, **sizes},
        {"backend": "mjx", "ran": True, "diverged": 1},
        {"backend": "drake", "ran": False, "why": "not installed"},
    ]
    out = "\n".join(pendulum.parity_lines({**found, "rows": rows}))
    assert (
        "2.0e+00" in out and "all 1 samples diverged" in out and "did not run: not installed" in out
    )
