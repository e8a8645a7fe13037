"""A model file gets the numbers that were found, compiles to the model that was simulated, and says
what it cannot hold.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.acting import OUTSIDE
from adaptsim_jax.simulators.mujoco.diagnosed import simulator
from adaptsim_jax.simulators.mujoco.fields import with_values
from adaptsim_jax.simulators.mujoco.mended import _put, mended_mjcf
from tests.simulators.robots import quadruped, record, walk

ARRAYS = (
    "dof_damping dof_frictionloss dof_armature body_mass body_inertia body_ipos geom_friction "
    "geom_solref geom_solimp geom_pos geom_quat actuator_gainprm actuator_biasprm"
).split()


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    data = tmp_path_factory.mktemp("walked")
    return simulator(
        *read_source_and_log(record(data, quadruped(), told=walk, trials=3, seconds=1.0, base=True))
    )


def moved(f) -> float:
    """A value that shows."""
    return f.default * 1.2 if f.default else min(0.03, 0.1 * f.high, 0.02 + f.step)


def test_every_number_of_the_catalogue_comes_back_from_the_file(walked):
    values = {f.name: moved(f) for f in walked.quantities}
    text = mended_mjcf(walked.stepped_model, walked.quantities, values)
    got = mujoco.MjModel.from_xml_string(text)
    own = [f for f in walked.quantities if f.field not in OUTSIDE]
    want = with_values(walked.stepped_model.model, own, [values[f.name] for f in own])
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=2e-6, err_msg=name)
    for f in walked.quantities:
        assert (f"not in this file: {f.name} = " in text) is (
            f.field in OUTSIDE and f.name != "command.delay"
        )
    assert 'delay="' in text


def test_contact_changes_in_proportion_so_that_nothing_jumps_where_it_hardly_changes(walked):
    friction = next(f for f in walked.quantities if f.name == "contact.friction[0]")
    file = walked.stepped_model.model
    assert len(set(file.geom_friction[:, 0])) > 1
    near = with_values(file, (friction,), (friction.default * 1.001,))
    np.testing.assert_allclose(near.geom_friction[:, 0], 1.001 * file.geom_friction[:, 0])


def test_feet_without_friction_have_no_share_of_it_to_change(tmp_path):
    bare = quadruped().replace('friction="0.5 0.01 0.001"', 'friction="0 0 0" priority="1"')
    made = simulator(
        *read_source_and_log(
            record(tmp_path / "bare", bare, told=walk, trials=3, seconds=0.4, base=True)
        )
    )
    assert all(q.scale > 0 for q in made.quantities)
    assert not any("friction" in c.name for c in made.candidates)


def test_what_was_not_found_stays_as_it_was(walked):
    text = mended_mjcf(
        walked.stepped_model, walked.quantities, {f.name: f.default for f in walked.quantities}
    )
    got, file = (
        mujoco.MjModel.from_xml_string(text),
        mujoco.MjModel.from_xml_path(walked.stepped_model.path),
    )
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(got, name), getattr(file, name), atol=1e-9, err_msg=name)
    assert "not in this file" not in text


def test_a_number_of_what_is_not_written_is_told(walked):
    damping = next(f for f in walked.quantities if f.field == "joint.damping")
    rope = replace(damping, name="tendon:rope.damping", field="tendon.damping", default=0.0)
    with pytest.raises(BadInput, match="numbers of a tendon are not written"):
        _put(mujoco.MjSpec.from_file(walked.stepped_model.path), walked.stepped_model.model, rope)


def test_a_table_of_numbers_is_refused_with_the_file_that_holds_them(walked, tmp_path):
    table = tmp_path / "model.toml"
    table.write_text('schema = 2\ntask = "simulator"\nmodel = "model.xml"\n')
    data = Path(walked.stepped_model.path).parent
    with pytest.raises(BadInput, match=r"give the model\.xml beside it"):
        replay_files(str(table), str(data))
    (tmp_path / "model.xml").write_text(mended_mjcf(walked.stepped_model, walked.quantities, {}))
    found = replay_files(str(tmp_path / "model.xml"), str(data), horizon=0.24)
    assert np.median(found.error) < 1e-3
