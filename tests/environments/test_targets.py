"""Targets in MuJoCo C: as the simulator where they are the same, otherwise where they say so; and
the interface.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from adaptsim_jax.commands.parser import read_target
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import play_in, task_of
from tests.environments.small import make
from tests.environments.test_mended import NUMBERS, written

SAME = {"integrator": "Euler", "steps": 1}
TARGETS = {
    "same": SAME,
    "heavy": {"body:cart.mass": 3.0} | SAME,
    "dry": {"joint:slide.frictionloss": 2.0} | SAME,
    "stuck": {"joint:slide.frictionloss": 5.0},
    "late": {"delay": 0.04} | SAME,
    "half_late": {"delay": 0.02, "engine": "simulator"},
    "weak": {"action_scale": 0.5} | SAME,
}


@pytest.fixture(scope="module")
def setting():
    return setting_of(make(), EnvironmentConfig(targets=TARGETS))


def track(play, values, steps=12, seen=lambda live: live.obs):
    """Observations `[steps, 2]` under full push."""

    @jax.jit
    def run(values):
        world = play.world(values)
        live = play.reset(world, jax.random.key(0))

        def one(live, _):
            return (lambda after: (after, seen(after)))(play.step(world, live, jnp.ones(1)))

        return jax.lax.scan(one, live, None, steps)[1]

    return np.asarray(run(jnp.asarray(values, jnp.float32)))


@pytest.fixture(scope="module")
def tracks(setting):
    found = {name: track(*play_in(setting, target)) for name, target in setting.targets.items()}
    nominal = [f.nominal for f in setting.fields[: setting.space.dim]]
    return found | {
        "simulator": track(setting.play, nominal),
        "triple": track(setting.play, [3.0, 0.4]),
    }


def test_the_same_model_moves_alike_in_both(tracks):
    # single precision over 24 steps
    np.testing.assert_allclose(tracks["same"], tracks["simulator"], atol=2e-5)
    np.testing.assert_allclose(tracks["heavy"], tracks["triple"], atol=2e-5)


def test_it_does_so_to_twelve_digits_in_double_precision():
    with jax.enable_x64(True):
        setting = setting_of(make(), EnvironmentConfig(targets={"same": SAME}))

        def place(live):
            return live.state.data.qpos

        same = track(*play_in(setting, setting.targets["same"]), seen=place)
        ours = track(
            setting.play, [f.nominal for f in setting.fields[: setting.space.dim]], seen=place
        )
    assert same.dtype == np.float64
    np.testing.assert_allclose(same, ours, atol=1e-12)


def test_what_omega_cannot_say_acts(tracks):
    speed = {name: track[-1, 1] for name, track in tracks.items()}
    assert 0.4 * speed["same"] < speed["dry"] < 0.6 * speed["same"]  # 2 N of 4 N are lost
    assert abs(speed["stuck"]) < 0.01
    np.testing.assert_allclose(
        tracks["weak"][:, 1], 0.5 * tracks["same"][:, 1], atol=2e-5
    )  # linear in the push


def test_a_delay_is_whole_steps_or_between(tracks):
    np.testing.assert_allclose(tracks["late"][1:], tracks["same"][:-1], atol=2e-5)
    between = 0.5 * (tracks["simulator"][1:, 1] + tracks["simulator"][:-1, 1])
    np.testing.assert_allclose(tracks["half_late"][1:, 1], between, atol=2e-5)


@pytest.mark.parametrize(
    ("table", "tells"),
    [
        ({"joint:sldie.damping": 1.0}, "did you mean 'joint:slide'?"),
        ({"body:cart.mass": -1.0}, "targets.t: 'body:cart.mass' = -1.0"),
        ({"engine": "mujco"}, "did you mean 'mujoco'?"),
        ({"integrator": "RK5"}, "did you mean 'RK4'?"),
        ({"steps": 0}, "whole number of 1 or more"),
    ],
)
def test_a_target_that_makes_no_sense_is_one_line(table, tells):
    with pytest.raises(BadInput) as error:
        setting_of(make(), EnvironmentConfig(targets={"t": table}))
    assert tells in str(error.value) and "\n" not in str(error.value)


class Raw:
    """An environment that knows nothing of ours: it calls MJX by itself."""

    action_size, dt, length = 1, 0.02, 20

    def __init__(self, step):
        self.mj_model = make().mj_model
        self.mjx_model, self._step = mjx.put_model(self.mj_model), step

    def state(self, data):
        obs = jnp.concatenate([data.qpos, data.qvel])
        return SimpleState(data, obs, -jnp.abs(data.qpos[0]), jnp.zeros(()))

    def reset(self, key):
        return self.state(mjx.forward(self.mjx_model, mjx.make_data(self.mjx_model)))

    def step(self, state, action):
        return self.state(self._step(self.mjx_model, state.data.replace(ctrl=action)))


class SimpleState(NamedTuple):
    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


def test_an_environment_that_calls_mjx_by_itself_meets_the_target_too():
    own = EnvironmentConfig(
        fields={"body:cart.mass": (0.5, 4.0)}, targets={"same": SAME, "stuck": TARGETS["stuck"]}
    )
    setting = setting_of(Raw(lambda model, data: mjx.step(model, data)), own)
    same, stuck = (track(*play_in(setting, setting.targets[name])) for name in ("same", "stuck"))
    assert abs(stuck[-1, 1]) < 0.1 * abs(same[-1, 1])


def test_a_step_that_no_target_can_reach_is_refused():
    own = EnvironmentConfig(
        fields={"body:cart.mass": (0.5, 4.0)}, targets={"stuck": TARGETS["stuck"]}
    )
    kept = mjx.step  # as `from mujoco.mjx import step` has it
    setting = setting_of(Raw(lambda model, data: kept(model, data)), own)
    with pytest.raises(BadInput, match="does not reach the target's physics"):
        track(*play_in(setting, setting.targets["stuck"]))


PUSHED = """
<mujoco>
  <option timestep="0.02" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="hand" mocap="true" pos="0 1 0"/>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.4"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
    <body name="led">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <equality><weld body1="hand" body2="led"/></equality>
  <actuator><motor joint="slide" gear="4" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Pushed(Raw):
    """Its step pushes the cart by forces of two kinds, and leads a body by the hand."""

    def __init__(self):
        self.mj_model = mujoco.MjModel.from_xml_string(PUSHED)
        self.mjx_model = mjx.put_model(self.mj_model)

    def step(self, state, action):
        data = state.data.replace(
            ctrl=0.0 * action,
            xfrc_applied=state.data.xfrc_applied.at[2, 0].set(3.0),
            qfrc_applied=state.data.qfrc_applied.at[0].set(2.0),
            mocap_pos=state.data.mocap_pos + 0.01,
        )
        return self.state(mjx.step(self.mjx_model, data))


def test_forces_and_mocap_poses_of_a_step_reach_the_target():
    own = EnvironmentConfig(fields={"body:cart.mass": (0.5, 4.0)}, targets={"same": SAME})
    setting = setting_of(Pushed(), own)
    same = track(*play_in(setting, setting.targets["same"]))
    ours = track(setting.play, [1.0])
    assert ours[-1, 0] > 0.1 and ours[-1, 1] > 0.01  # the cart, and the body that is led
    np.testing.assert_allclose(same[:, :4], ours[:, :4], atol=2e-4)


def test_a_file_says_a_target_by_any_field_or_by_a_mended_model(tmp_path):
    setting = setting_of(make(), EnvironmentConfig())
    task = task_of(setting)
    task = task.preparation.ready(task.preparation.blank(jax.random.key(1)))
    mended = written(tmp_path, NUMBERS)
    named = tmp_path / "rail.toml"
    named.write_text(
        '"body:cart.mass" = 1.2\n"joint:slide.damping" = 0.7\n"joint:slide.armature" = 0.05\n'
        '"joint:slide.frictionloss" = 0.3\n'
    )
    other = tmp_path / "nominal.toml"
    other.write_text("[params]\n")
    seen = {}
    for path in (mended, named, other):
        name, params, world = read_target(str(path), task)
        assert name == path.stem and params.shape == (2,) and world.reference(params).shape == (2,)
        roll = jax.jit(world.rollout)
        seen[path] = roll(jax.random.key(0), task.init_policy(jax.random.key(0)), params).features
    np.testing.assert_allclose(seen[mended], seen[named], atol=1e-5)
    assert np.abs(seen[mended] - seen[other]).max() > 1e-3
    (tmp_path / "odd.toml").write_text('"joint:sldie.damping" = 1.0')
    with pytest.raises(BadInput, match=r"odd\.toml: 'joint:sldie\.damping'.*'joint:slide'"):
        read_target(str(tmp_path / "odd.toml"), task)
