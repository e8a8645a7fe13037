"""Environments that people have: Playground's over an `mjx.Model`, also in MuJoCo C, and gymnax's;
with the extra `[environments]`.
"""

import importlib.util
import subprocess
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments import peers
from adaptsim_jax.environments.peers import load
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import play_in

SAME = {"integrator": "Euler", "steps": 1}
CARTPOLE = {"body:pole_1.mass": [0.05, 0.3], "actuator:slide.gear": [6.0, 14.0]}


def track(play, values, steps):
    """Observations `[steps, O]` and rewards under actions that swing."""

    @jax.jit
    def run(values):
        world = play.world(values)

        def one(live, i):
            after = play.step(world, live, jnp.full(play.sim.action_dim, jnp.sin(0.2 * i)))
            return after, (after.obs, after.reward)

        return jax.lax.scan(one, play.reset(world, jax.random.key(0)), jnp.arange(steps))[1]

    return [np.asarray(x) for x in run(jnp.asarray(values, jnp.float32))]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_playground_steps_with_fields_as_arguments_and_in_mujoco_c():
    pytest.importorskip("mujoco_playground", reason="Playground is an extra")
    env = load("playground:CartpoleSwingup")
    targets = {
        "same": SAME,
        "heavy": SAME | {"body:pole_1.mass": 0.3, "joint:slider.frictionloss": 0.5},
    }
    setting = setting_of(env, EnvironmentConfig(fields=CARTPOLE, targets=targets))
    assert setting.sim.length == 1000 and setting.sim.dt == 0.01
    nominal = [f.nominal for f in setting.fields[:2]]
    assert nominal == pytest.approx([0.1, 10.0])
    ours, same, heavy = (
        track(setting.play, nominal, 30),
        *(track(*play_in(setting, t), 30) for t in setting.targets.values()),
    )
    for a, b in zip(ours, same, strict=True):
        np.testing.assert_allclose(
            a, b, atol=2e-4
        )  # single precision, 30 steps of a chaotic system at its start
    assert np.abs(heavy[0] - same[0]).max() > 0.05
    with pytest.raises(BadInput, match="did you mean 'CartpoleSwingup'"):
        load("playground:CartpoleSwingupp")


@pytest.mark.filterwarnings("ignore")
def test_gymnax_moves_with_its_parameters():
    pytest.importorskip("gymnax", reason="gymnax is an extra")
    fields = {"params.m": [0.5, 2.0], "params.g": [5.0, 15.0]}
    setting = setting_of(load("gymnax:Pendulum-v1"), EnvironmentConfig(fields=fields))
    assert setting.space.names == ("params.m", "params.g") and setting.sim.native is None
    light, heavy = (track(setting.play, [m, 10.0], 10)[0] for m in (0.5, 2.0))
    assert np.abs(light - heavy).max() > 0.1
    with pytest.raises(BadInput, match="actions on a continuum"):
        setting_of(
            load("gymnax:CartPole-v1"), EnvironmentConfig(fields={"params.gravity": [5.0, 15.0]})
        )


@pytest.mark.parametrize(
    "name, tells", [("playground:X", "pip install playground"), ("gymnax:X", "pip install gymnax")]
)
def test_a_peer_that_is_not_there_is_told_with_what_to_install(name, tells, monkeypatch):
    import importlib

    real = importlib.import_module

    def absent(module, *rest):
        if module.partition(".")[0] in ("mujoco_playground", "gymnax"):
            raise ModuleNotFoundError(name=module)
        return real(module, *rest)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(BadInput, match=tells):
        load(name)


@pytest.mark.filterwarnings("ignore")
def test_an_option_that_playground_has_not_is_refused():
    pytest.importorskip("mujoco_playground", reason="Playground is an extra")
    with pytest.raises(
        BadInput,
        match=r"options.control_dt: 'CartpoleSwingup' has no such option; did you mean 'ctrl_dt'",
    ):
        load("playground:CartpoleSwingup", {"control_dt": 0.02})
    if importlib.util.find_spec("warp") is None:
        with pytest.raises(
            BadInput, match=r'impl = "warp": needs warp-lang .* pip install warp-lang'
        ):
            load("playground:CartpoleSwingup", {"impl": "warp"})


@pytest.mark.parametrize(
    "error",
    [
        subprocess.CalledProcessError(128, ["git", "clone"]),
        FileNotFoundError(2, "No such file or directory", "git"),
    ],
)
def test_playground_without_a_network_is_one_line_with_what_to_do(monkeypatch, error):
    def load_(name, config_overrides):
        raise error

    registry = SimpleNamespace(ALL_ENVS=["Go1"], get_default_config=lambda name: {}, load=load_)
    monkeypatch.setattr(peers, "_peer", lambda *given: SimpleNamespace(registry=registry))
    with pytest.raises(BadInput, match="copy a checkout of Menagerie to") as told:
        load("playground:Go1")
    assert "git" in str(told.value) and "\n" not in str(told.value)
