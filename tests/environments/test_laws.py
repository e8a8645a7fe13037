"""The laws that act beside MJX: each effect of the catalogue as `replay` has it, what a file asks
of MJX that MJX ignores, and numbers as arguments.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.joints.catalogue import OWN
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.environments.setting import EnvironmentConfig, environment, setting_of
from tests.environments import catalogue

MOST = 2.0  # times the difference of both integrators with nothing added


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return catalogue.replayed(catalogue.written(tmp_path_factory.mktemp("plain"), "nothing"))


@pytest.fixture(scope="module")
def integrators(tmp_path_factory, plain):
    return catalogue.difference(tmp_path_factory.mktemp("nothing"), "nothing", plain).error.max()


def test_every_effect_of_the_catalogue_has_a_world():
    assert {e.name for e in OWN} <= set(catalogue.WORLDS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return catalogue.Whole(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("world", [w for w in catalogue.WORLDS if w != "nothing"])
def test_a_mended_environment_moves_as_replay_does(world, plain, integrators, whole, tmp_path):
    one = None if world in catalogue.OF_ITS_OWN else whole
    found = catalogue.difference(tmp_path, world, plain, one)
    assert found.error.max() <= MOST * integrators, (found, integrators)
    assert found.effect.max() > MOST * integrators  # else the world shows nothing


LATE = catalogue.ARM.replace('joint="shoulder"', 'joint="shoulder" delay="0.1" nsample="60"')
CURVED = catalogue.ARM.replace('damping="0.3"', 'damping="0.3 0.4 0.05"')


def in_c(mjcf: str) -> np.ndarray:
    """Angles [T + 1, 2] of MuJoCo C under the same commands."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    data.qpos[:] = catalogue.START
    rows = [data.qpos.copy()]
    for action in catalogue.ACTIONS:
        data.ctrl[:] = action * [6.0, 2.0]
        mujoco.mj_step(model, data, round(catalogue.CONTROL / catalogue.STEP))
        rows.append(data.qpos.copy())
    return np.array(rows)


def of_file(mjcf: str) -> ModelEnvironment:
    env = catalogue.arm()
    return ModelEnvironment(mjcf, env.observe, env.reward, start=env.start, length=env.length)


@pytest.mark.parametrize("mjcf", [LATE, CURVED], ids=["delay", "damping"])
def test_what_a_file_asks_of_mjx_that_mjx_ignores_acts(mjcf):
    found, expected = catalogue.rolled(of_file(mjcf)), in_c(mjcf)
    ignored = np.abs(in_c(catalogue.ARM) - expected).max()
    # before the first command has come C has 0, and the law the first command
    assert np.abs(found - expected).max() < 0.1 * ignored


def test_a_delay_that_is_at_no_joint_is_refused():
    site = '<body name="fore" pos="0 0 -0.3"><site name="hand"/>'
    mjcf = LATE.replace('joint="shoulder" delay', 'site="hand" delay')
    mjcf = mjcf.replace('<body name="fore" pos="0 0 -0.3">', site)
    with pytest.raises(BadInput, match="which MJX ignores, and is at no joint"):
        environment(of_file(mjcf))


def test_numbers_of_laws_are_fields_and_one_program_serves_all_of_them(tmp_path):
    path = catalogue.written(tmp_path, "stribeck")
    name, excess = "effect:shoulder.stribeck.excess", (0.0, 0.5)
    config = EnvironmentConfig(fields={name: list(excess)}, model=str(path))
    setting = setting_of(catalogue.arm(), config)
    assert setting.fields[0].nominal == pytest.approx(0.2) and setting.fields[0].unit == "N m"
    traces = []

    @jax.jit
    def end(values):
        traces.append(1)
        world = setting.play.world(values)

        def step(live, action):
            return setting.play.step(world, live, action), None

        first = setting.play.reset(world, jax.random.key(0))
        return jax.lax.scan(step, first, jnp.asarray(catalogue.ACTIONS, jnp.float32))[0].obs

    ends = np.array([end(jnp.array([z])) for z in excess])
    both = np.asarray(jax.vmap(end)(jnp.array(excess)[:, None]))
    assert len(traces) == 1
    np.testing.assert_allclose(ends, both, atol=1e-5)
    assert np.abs(ends[1] - ends[0]).max() > 1e-3
    found = catalogue.written(tmp_path, "stribeck")
    zero = found.read_text().replace("value = 0.2", "value = 0.0")
    found.write_text(zero)
    np.testing.assert_allclose(
        catalogue.rolled(mended(catalogue.arm(), found))[-1], ends[0], atol=1e-4
    )


def test_a_target_may_have_a_model_of_its_own(tmp_path):
    path = catalogue.written(tmp_path, "actuator_lag")
    targets = {"found": {"model": str(path)}, "heavy": {"body:fore.mass": 0.9}}
    config = EnvironmentConfig(fields={"body:fore.mass": [0.3, 1.0]}, targets=targets)
    setting = setting_of(catalogue.arm(), config)
    assert setting.targets["found"].engine == "simulator"
    assert setting.targets["heavy"].engine == "mujoco" and setting.sim.laws is None
    with pytest.raises(BadInput, match="give 0 or more"):
        bad = path.read_text().replace("value = 0.05", "value = -0.05")
        path.write_text(bad)
        setting_of(catalogue.arm(), replace(config, model=str(path)))
