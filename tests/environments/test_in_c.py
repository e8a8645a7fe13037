"""What `carried.toml` calls exact of model.xml is so: MuJoCo C moves as `replay` of model.toml."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.environments.setting import environment
from adaptsim_jax.mend import export
from adaptsim_jax.mend.mjcf import MARK
from tests.environments import catalogue
from tests.environments.in_c import error, mjcf_of

CARRIED = config.read(Path(export.__file__).with_name("carried.toml"))
EXACT = [w for w in catalogue.WORLDS if CARRIED.get(w, {}).get("mjcf", "").startswith("exact")]
MOST = 2.0  # times the difference of both integrators with nothing added


@pytest.fixture(scope="module")
def integrators(tmp_path_factory):
    return error(tmp_path_factory.mktemp("nothing"), "nothing").max()


@pytest.mark.parametrize("world", [*EXACT, "hard_stop"])
def test_model_xml_in_mujoco_moves_as_replay_of_model_toml_does(world, integrators, tmp_path):
    assert error(tmp_path, world).max() <= MOST * integrators


@pytest.mark.parametrize("world, zero", [("quadratic_drag", 0.0), ("encoder_offset", 0.2)])
def test_a_tree_that_is_read_from_model_xml_has_it_too(world, zero, tmp_path, monkeypatch):
    path = catalogue.written(tmp_path, world)
    expected, text = catalogue.replayed(path), mjcf_of(path)
    catalogue.written(tmp_path, "nothing")
    (tmp_path / "declared.xml").write_text(text)
    monkeypatch.setattr(catalogue, "START", np.add(catalogue.START, [0.0, zero]))  # as it is read
    np.testing.assert_allclose(catalogue.replayed(path), expected, atol=1e-6)


def test_a_drag_of_the_file_acts_once_in_a_mended_environment(tmp_path):
    path = catalogue.written(tmp_path, "nothing")
    text = catalogue.ARM.replace('damping="0.3"', 'damping="0.3 0.4"')
    (tmp_path / "declared.xml").write_text(text)
    arm = catalogue.arm()
    env = ModelEnvironment(text, arm.observe, arm.reward, start=arm.start, length=arm.length)
    laws = environment(mended(env, path)).laws
    assert laws.values.effects["quadratic_drag"]["drag"][0, 0] == pytest.approx(0.4)
    assert not laws.damping.any()


def test_a_model_that_has_what_was_found_is_not_mended_again(tmp_path):
    path = catalogue.written(tmp_path, "quadratic_drag")
    spec = mujoco.MjSpec.from_string(mjcf_of(path))
    spec.add_text(name=MARK, data="nothing lost")
    spec.compile()
    arm = catalogue.arm()
    twice = ModelEnvironment(
        spec.to_xml(), arm.observe, arm.reward, start=arm.start, length=arm.length
    )
    with pytest.raises(BadInput, match="has what was found; make the environment of the declared"):
        mended(twice, path)
