"""A mechanism's log that contradicts its model is told with what to write; the healthy one is not
doubted.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from tests.generators.mechanism_worlds import write_world
from tests.logs.log_files import folder


def SAME(x):
    return x


@pytest.fixture(scope="module", params=["arm3", "furuta"])
def healthy(request, tmp_path_factory):
    """Three driven joints, and two of which one has no drive."""
    folder = tmp_path_factory.mktemp(request.param)
    write_world(folder, "null", 5, machine=request.param, mode="torque")
    return load(folder / "recording")


def spoiled(machine, q=SAME, u=SAME):
    """Angles and speeds, and torques, otherwise in every trial."""

    def each(t):
        return replace(t, q=q(t.q), v=None if t.v is None else q(t.v), u=u(t.u))

    return replace(machine, tracks=tuple(each(t) for t in machine.tracks))


def swap(x):
    return np.concatenate([x[:, [1, 0]], x[:, 2:]], 1)


def times(j, factor):
    return lambda x: x * np.where(np.arange(x.shape[1]) == j, factor, 1.0)


def moved(machine, q):
    """The last angle a quarter turn on; speeds as they are."""
    own = next((t for t in machine.tracks if t.q is q), None)
    return (
        q if own is None else q + np.where(np.arange(q.shape[1]) == q.shape[1] - 1, np.pi / 2, 0.0)
    )


def model(machine, length=1.0, mass=1.0):
    """The machine whose file has lengths and masses otherwise."""
    tree = machine.tree
    size = mass * np.array([1.0, *[length] * 3, *[length**2] * 6])
    other = replace(
        tree, place=length * np.asarray(tree.place), inertial=np.asarray(tree.inertial) * size
    )
    return replace(machine, mechanism=replace(machine.mechanism, tree=other))


WRONG = {
    "joints": (lambda m: spoiled(m, swap, swap), "look swapped"),
    "torques": (lambda m: spoiled(m, u=swap), "the torques of .* look swapped"),
    "signs": (lambda m: spoiled(m, u=lambda u: -u), "all torques have the other sign"),
    "angle": (lambda m: spoiled(m, times(1, -1.0)), "turn the signs of columns q_"),
    "degrees": (lambda m: spoiled(m, times(1, 180 / np.pi)), '= "deg" under'),
    "radians": (lambda m: spoiled(m, times(1, np.pi / 180)), '= "rad" under'),
    "turns": (lambda m: spoiled(m, times(1, 0.5 / np.pi)), '= "rev" under'),
    "zero": (
        lambda m: spoiled(m, lambda q: moved(m, q)),
        "a quarter turn from where the model has its zero",
    ),
    "mm": (lambda m: model(m, length=1e3), "lengths 0.001 times those"),
    "short": (lambda m: model(m, length=0.1), "lengths 10 times those"),
    "grams": (lambda m: model(m, mass=1e3), "masses in grams"),
    "mNm": (lambda m: spoiled(m, u=lambda u: 1e3 * u), "torques in mN m"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_contradicts_the_model_is_refused_with_a_mend(healthy, name):
    spoil, says = WRONG[name]
    with pytest.raises(BadInput, match=f"{says}.*--as-declared$"):
        check_conventions(spoil(healthy))


def test_a_healthy_log_is_not_doubted(healthy):
    assert check_conventions(healthy) == ()


def test_a_free_swing_says_nothing_of_the_torques_unit(tmp_path):
    write_world(tmp_path, "null", 5, machine="pendulum", mode="torque")
    machine = spoiled(load(tmp_path / "recording"), u=np.zeros_like)
    assert all(f.kind != "masses" for f in check_conventions(machine))


def test_masses_that_are_somewhat_off_and_late_logs_are_warned_of(healthy):
    (found,) = check_conventions(model(healthy, mass=0.1))
    assert found.severity == "warn" and "times those that the masses of" in found.message
    (found,) = check_conventions(spoiled(healthy, u=lambda u: np.roll(u, 3, axis=0)))
    assert "ahead of the torque that makes it" in found.message


def test_inertias_a_little_off_are_no_lengths_far_off(tmp_path):
    write_world(tmp_path / "world", "null", 10043)
    assert check_conventions(load(tmp_path / "world/recording", None)) == ()


WHEEL = """<mujoco><worldbody><body><joint name="axle" axis="0 1 0" damping="0.01" armature="0.002"/>
  <geom type="cylinder" size="0.12 0.02" euler="90 0 0" mass="1.2"/></body></worldbody>
  <actuator><motor name="drive" joint="axle" gear="30"/></actuator></mujoco>"""  # noqa: E501


def wheel(path, units, size=1.0):
    """A wheel that turns five times under a torque command: rad and N m / 30, or `size` times that
    command.
    """
    time = np.arange(1200) * 0.005
    inertia = 0.5 * 1.2 * 0.12**2 + 0.002
    columns = []
    for rate in (0.4, 0.7):
        q = 16.0 * (1 - np.cos(2 * rate * time)) + np.sin(5 * time) - 5 * time
        v = 32.0 * rate * np.sin(2 * rate * time) + 5 * np.cos(5 * time) - 5
        a = 64.0 * rate**2 * np.cos(2 * rate * time) - 25 * np.sin(5 * time)
        columns.append(
            {"time": time, "q_axle": q, "ctrl_drive": size * (inertia * a + 0.01 * v) / 30}
        )
    folder(
        path,
        f'model = "wheel.xml"\n[units]\n{units}\n',
        **{f"spin{k}": c for k, c in enumerate(columns)},
    )
    (path / "wheel.xml").write_text(WHEEL)
    return load(path)


def test_torques_off_by_the_unit_of_angles_say_so_and_each_mend_works(tmp_path):
    assert check_conventions(wheel(tmp_path / "rad", "")) == ()
    with pytest.raises(
        BadInput, match='right size if the angles are in radians, not degrees; write angle = "rad"'
    ) as error:
        check_conventions(wheel(tmp_path / "deg", 'angle = "deg"'))
    assert check_conventions(wheel(tmp_path / "mended", 'angle = "rad"')) == ()
    line = re.search(r"the commands' unit under \[units\] \((ctrl = [\d.e-]+)\)", str(error.value))[
        1
    ]
    assert check_conventions(wheel(tmp_path / "torques", f'angle = "deg"\n{line}')) == ()
    with pytest.raises(BadInput, match="masses in tonnes, or torques in mN m") as error:
        check_conventions(wheel(tmp_path / "milli", "", 1e3))
    assert "degrees" not in str(error.value)
    line = re.search(r"ctrl = [\d.e-]+", str(error.value))[0]
    assert check_conventions(wheel(tmp_path / "newton", line, 1e3)) == ()
