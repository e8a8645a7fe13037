"""An environment of a person's own: what its functions may return, an error in one of them, a file
that imports its neighbour.
"""

import sys

import jax
import jax.numpy as jnp
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.simulated import simulated
from tests.environments import small
from tests.environments.small import make

MJCF = small.MJCF.format(constraint="enable")


def changed(**functions):
    env = make()
    for name, function in functions.items():
        setattr(env, name, function)
    return env


@pytest.mark.parametrize(
    "functions",
    [
        {"reward": lambda data, action: jnp.abs(data.qpos)},
        {"done": lambda data: jnp.abs(data.qpos[0]) > 0.6},
        {"done": lambda data: jnp.abs(data.qpos) > 0.6},
        {"reward": lambda data, action: jnp.where(data.qpos[0] > 0.2, 1, 0)},
        {"reward": lambda data, action: 1},
        {"observe": lambda data: data.qpos[0]},
    ],
    ids=["one of a row", "bool", "row of bools", "whole", "Python's", "one observation"],
)
def test_what_is_one_number_in_another_dress_is_taken(functions):
    setting = setting_of(changed(**functions), EnvironmentConfig())
    state = setting.trainer.begin(jax.random.key(0), setting.trainer.init(jax.random.key(0)))
    assert state.live.reward.shape == state.live.done.shape == (256,)
    assert state.live.reward.dtype == state.live.obs.dtype == jnp.float32
    assert state.live.obs.shape == (256, 1 if "observe" in functions else 2)

    def step(key):
        world = setting.play.world(jnp.array([1.0, 0.4]))
        return setting.play.step(world, setting.play.reset(world, key), jnp.zeros(1))

    one = jax.eval_shape(step, jax.random.key(0))
    assert one.reward.shape == one.done.shape == () and one.reward.dtype == jnp.float32


@pytest.mark.parametrize(
    ("functions", "tells"),
    [
        ({"reward": lambda data, action: jnp.zeros(2)}, "reward(data, action): has the shape (2,)"),
        ({"done": lambda data: jnp.zeros(2, bool)}, "done(data): has the shape (2,)"),
        ({"observe": lambda data: jnp.zeros((2, 3))}, "observe(data): has the shape (2, 3)"),
        ({"observe": lambda data: {"q": data.qpos}}, "observe(data): is a dict"),
        ({"reward": lambda data, action: None}, "reward(data, action): is a NoneType"),
        ({"start": lambda key, q: (q, jnp.zeros(2))}, "start: its qvel has the shape (2,)"),
    ],
    ids=["reward", "done", "observe", "dict", "nothing", "start"],
)
def test_another_shape_is_one_line_that_names_the_function(functions, tells):
    with pytest.raises(BadInput) as error:
        setting_of(changed(**functions), EnvironmentConfig())
    assert tells in str(error.value) and "wanted" in str(error.value)


def test_the_same_of_an_environment_that_is_not_ours():
    class Theirs:
        action_size, dt, mj_model, mjx_model = 1, 0.02, make().mj_model, make().mjx_model

        def reset(self, key):
            state = make().reset(key)
            return state._replace(reward=jnp.zeros(3))

        step = reset

    sim = simulated(Theirs())
    with pytest.raises(BadInput, match=r"Theirs\.reward: has the shape \(3,\)"):
        sim.observed(sim.reset(sim.model, jax.random.key(0)))


RIG = '''
import jax.numpy as jnp
from gauge import far
from adaptsim_jax.environments.own import ModelEnvironment

def make():
    return ModelEnvironment(
        """{mjcf}""",
        lambda data: jnp.concatenate([data.qpos, data.qvel]),
        lambda data, action: far(data) @ jnp.zeros({zeros}),
        control_dt=0.04, fields={{"body:cart.mass": (0.5, 2.0)}},
    )
'''


def written(folder, zeros):
    (folder / "gauge.py").write_text("def far(data):\n    return data.qpos\n")
    rig = RIG.format(mjcf=MJCF, zeros=zeros)
    (folder / "rig.py").write_text(rig)
    (folder / "env.toml").write_text('env = "rig.py:make"\n')
    return 1 + rig[: rig.index("far(data) @")].count("\n")


def test_a_file_may_import_its_neighbour(tmp_path, monkeypatch):
    from adaptsim_jax.environments.peers import load

    monkeypatch.setattr("sys.path", list(sys.path))
    written(tmp_path, 1)
    assert isinstance(load(f"{tmp_path / 'rig.py'}:make"), ModelEnvironment)


def test_a_file_that_is_not_python_is_one_line(tmp_path, capsys):
    (tmp_path / "rig.py").write_text("def make():\n    return (\n")
    (tmp_path / "env.toml").write_text('env = "rig.py:make"\n')
    assert main(["train", str(tmp_path / "env.toml"), "--run", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "rig.py, line 2" in said and said.count("\n") == 1


def test_an_error_in_a_persons_own_reward_says_where(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.path", list(sys.path))
    line = written(tmp_path, 3)
    assert main(["train", str(tmp_path / "env.toml"), "--run", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert f"in your rig.py, line {line}: TypeError" in said and said.count("\n") == 1
    assert not (tmp_path / "run").exists()
