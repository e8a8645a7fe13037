"""What `carried.toml` calls exact of model.xml is so: MuJoCo C moves as `replay` of model.toml."""

from pathlib import Path

import mujoco
import pytest

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.own import ModelEnvironment
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
