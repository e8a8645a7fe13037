"""One world for each effect of the catalogue, as a model.toml, and two arms that have it: an
environment that is mended, and `replay`'s own simulation from the same start.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.acting import ActingModel, Values, compliant
from adaptsim_jax.attribution.in_mjcf import columns_of
from adaptsim_jax.attribution.model_toml import applied
from adaptsim_jax.attribution.simulate import Scheme, measure, simulate, with_drives
from adaptsim_jax.core import config
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.environments.mended import declared_machine, mended
from adaptsim_jax.environments.own import ModelEnvironment
from adaptsim_jax.environments.setting import environment

OF_ITS_OWN = ("drive_elasticity", "drive_backlash", "stribeck", "servo")
"""Worlds that have a program of their own, not numbers of the one that all others share."""
STEP, CONTROL, T = 0.002, 0.02, 100  # s, s, actions
START = np.array([0.3, -0.2])
ARM = f"""
<mujoco><option timestep="{STEP}"><flag contact="disable"/></option><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
<body name="fore" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5"/></body></body></worldbody>
<actuator><motor name="shoulder" joint="shoulder" ctrlrange="-6 6"/>
<position name="elbow" joint="elbow" ctrlrange="-2 2" kp="6" kv="0.3"/></actuator></mujoco>
"""
TIMES = CONTROL * np.arange(T)
ACTIONS = np.stack(
    [0.25 * np.sin(3 * TIMES) + 0.1 * np.sin(11 * TIMES), 0.3 * np.sin(6 * TIMES + 1)], 1
)
ANGLES = {f"at{k}": v for k, v in enumerate([0.1, 0.2, 0.1, 0, 0.1, 0.3, 0.1, 0, 0.1, 0.2])}
ANGLES |= {"low": -1.0, "high": 1.0}
DRIVE = {"compliance": 0.05, "damping": 0.01}
S, E = "shoulder", "elbow"
WORLDS: dict[str, list[tuple[str, str, dict[str, float]]]] = {
    "nothing": [],
    "viscous": [("viscous", E, {"damping": 0.2})],
    "coulomb": [("coulomb", E, {"level": 0.3}), ("coulomb", S, {"level": 0.2})],
    "asymmetric_coulomb": [
        ("coulomb", S, {"level": 0.3}),
        ("asymmetric_coulomb", S, {"difference": 0.1}),
    ],
    "stribeck": [("coulomb", S, {"level": 0.1}), ("stribeck", S, {"excess": 0.2, "speed": 0.3})],
    "presliding": [("coulomb", E, {"level": 0.4}), ("presliding", E, {"compliance": 0.1})],
    "load_friction": [("load_friction", S, {"share": 0.3})],
    "quadratic_drag": [("quadratic_drag", S, {"drag": 0.3})],
    "spring": [("spring", S, {"stiffness": 1.0, "preload": 0.3})],
    "bias": [("bias", S, {"torque": 0.4})],
    "cogging": [("cogging", S, {"sine": 0.2, "cosine": 0.1, "order": 7})],
    "periodic_disturbance": [
        ("periodic_disturbance", S, {"sine": 0.3, "cosine": 0.1, "frequency": 1.3})
    ],
    "friction_drift": [("friction_drift", S, {"viscous": 0.3, "dry": 0.2, "decay": 1.0})],
    "hard_stop": [("hard_stop", E, {"stiffness": 60, "angle": 0.2, "side": 1.0})],
    "armature": [("armature", E, {"inertia": 0.03})],
    "torque_gain": [("torque_gain", S, {"gain": -0.3})],
    "torque_coupling": [("torque_coupling", E, {"onto": 0.1, "back": 0.1})],
    "friction_coupling": [("friction_coupling", E, {"damping": 0.03})],
    "position_gain": [("position_gain", E, {"gain": 0.4})],
    "saturation": [("saturation", S, {"cut": 0.5, "peak": 2.0})],
    "dead_zone": [("dead_zone", S, {"width": 0.3})],
    "delay": [("delay", S, {"delay": 0.027}), ("delay", E, {"delay": 0.011})],
    "actuator_lag": [("actuator_lag", S, {"lag": 0.05}), ("actuator_lag", E, {"lag": 0.03})],
    "encoder_offset": [("encoder_offset", E, {"offset": 0.2})],
    "encoder_scale": [("encoder_scale", E, {"scale": 0.2})],
    "sensor_delay": [("sensor_delay", E, {"delay": 0.017})],
    "sensor_lag": [("sensor_lag", E, {"lag": 0.03})],
    "angle_torque": [("angle_torque", S, ANGLES)],
    "angle_friction": [("angle_friction", S, ANGLES)],
    "drive_compliance": [("drive_compliance", E, {"compliance": 0.05})],
    "drive_play": [("drive_play", E, {"gap": 0.05, "width": 0.1})],
    "drive_elasticity": [("drive_elasticity", E, DRIVE | {"link": 1.0, "control": 0.0})],
    "drive_backlash": [("drive_backlash", E, DRIVE | {"gap": 0.06, "link": 1.0, "control": 0.0})],
    "backlash": [("backlash", E, {"gap": 0.06})],
    "tilt": [("tilt", "base", {"about_x": 0.05, "about_y": 0.1})],
    "body_mass": [],
    "inertia": [],
    "servo": [],
}
BODY = "[inertial]\nelbow = [0.8, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.02, 0.0, 0.002]\n"
OWN = {
    "body_mass": BODY,
    "inertia": BODY,
    "servo": "[servo.elbow]\nkp = 9.0\nkv = 0.2\nlimit = 1.5\noffset = 0.1\n",
}


def written(folder: Path, world: str) -> Path:
    """The model.toml of a world, with declared.xml beside it."""
    (folder / "declared.xml").write_text(ARM)
    text = f'schema = 2\ntask = "mechanism"\nmodel = "declared.xml"\n{OWN.get(world, "")}'
    for name, where, numbers in WORLDS[world]:
        text += f'[[effects]]\nname = "{name}"\nwhere = "{where}"\n'
        text += "".join(f"[effects.parameters.{k}]\nvalue = {v}\n" for k, v in numbers.items())
    path = folder / "model.toml"
    path.write_text(text)
    return path


def arm() -> ModelEnvironment:
    """What it sees are the angles."""
    return ModelEnvironment(
        ARM,
        lambda data: data.qpos,
        lambda data, action: data.qpos[0],
        start=lambda key, qpos: (qpos + START, jnp.zeros(2)),
        control_dt=CONTROL,
        length=T,
    )


def rolled(env: Any) -> np.ndarray:
    """Angles [T + 1, 2] that the policy sees, under `ACTIONS`."""
    sim = environment(env)
    return np.asarray(program(sim)(sim.model))


def program(sim: Any) -> Any:
    """`(model) -> [T + 1, 2]`, compiled."""

    @jax.jit
    def run(model):
        first = sim.reset(model, jax.random.key(0))

        def step(state, action):
            after = sim.step(model, state, action)
            return after, sim.observed(after)[0]

        seen = jax.lax.scan(step, first, jnp.asarray(ACTIONS, jnp.float32))[1]
        return jnp.concatenate([sim.observed(first)[0][None], seen])

    return run


class Whole:
    """One program with all effects on at both joints but those of drives: a world is its numbers,
    which are arguments.
    """

    def __init__(self, folder: Path):
        (folder / "declared.xml").write_text(ARM)
        text = 'schema = 2\ntask = "mechanism"\nmodel = "declared.xml"\n'
        for e in (e for e in MACHINE if e.place not in ("model", "drive")):
            for joint in (S, E):
                text += f'[[effects]]\nname = "{e.name}"\nwhere = "{joint}"\n'
                rows = (f"[effects.parameters.{a.name}]\nvalue = 1e-9\n" for a in e.amplitudes)
                text += "".join(rows)
        path = folder / "model.toml"
        path.write_text(text)
        sim = environment(mended(arm(), path))
        self.model, self.laws = sim.model
        self.run = program(sim)

    def rolled(self, env: Any) -> np.ndarray:
        """Angles [T + 1, 2] of a mended arm, by the numbers of its model and laws."""
        model = environment(env).model
        own, laws = model if isinstance(model, tuple) else (model, None)
        given = {} if laws is None else laws.values.effects
        effects = {}
        for e in self.laws.model.effects:
            off = {p.name: np.full((2, 1), p.default) for p in e.parameters}
            effects[e.name] = off | dict(given.get(e.name, {}))
        values = self.laws.values._replace(effects=effects)
        if laws is not None:
            values = values._replace(actuator=laws.values.actuator)
        names = [f.name for f in fields(self.model) if f.name not in ("opt", "stat", "_impl")]
        arrays = {n: getattr(own, n) for n in names if _is_number(getattr(self.model, n))}
        edits = arrays | {"opt.gravity": own.opt.gravity}
        edits["dof_frictionloss"] = jnp.maximum(own.dof_frictionloss, 1e-6)
        whole = self.model.tree_replace(edits)
        return np.asarray(self.run((whole, replace(self.laws, values=values))))


def _is_number(x: Any) -> bool:
    return isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.floating)


def replayed(path: Path) -> np.ndarray:
    """The same [T + 1, 2] as `replay` simulates it, from the same start."""
    machine = applied(config.read(path), str(path), declared_machine(path.parent / "declared.xml"))
    tree, columns = machine.tree, columns_of(machine)
    effects = tuple(e for e in MACHINE if e.place != "model")
    numbers = {
        e.name: {
            p.name: np.asarray(columns.get((e.name, p.name), np.full(2, p.default)))[:, None]
            for p in e.parameters
        }
        for e in effects
    }
    values = Values(
        np.asarray(tree.inertial)[..., None],
        np.asarray(tree.gravity)[:, None],
        machine.actuator[..., None],
        machine.gear[:, None],
        numbers,
        read=START[:, None],
    )
    sharp = replace(tree, friction_softness=np.zeros_like(np.asarray(tree.friction_softness)))
    model = ActingModel(sharp, effects)
    past = 4
    time = CONTROL * np.arange(T + 1)[:, None]
    stamp = CONTROL * np.arange(-past, T + 1)[:, None]
    told = ACTIONS * [6.0, 2.0]
    command = np.concatenate([np.tile(told[:1], (past, 1)), told, told[-1:]])[..., None]
    giving = np.flatnonzero(compliant(model, values))
    x0 = np.concatenate([START, np.zeros(2)])[:, None]
    with jax.enable_x64(True):
        if len(giving):
            x0 = np.asarray(with_drives(model, values, time, stamp, command, x0, past))
        yields = bool(np.any(numbers["presliding"]["compliance"]))
        scheme = Scheme(20, True, giving, past, yields)
        path_ = simulate(model, values, time, stamp, command, x0, scheme)
        # a policy reads before its command is there, a log's row has both
        before = jnp.concatenate([path_.u[:1], path_.u[:-1]])
        return np.asarray(measure(model, values, time, path_.x, before))[:, :2, 0]


@dataclass(frozen=True)
class Difference:
    """rms over time [2], rad: of the mended environment and the replay; of what the effect does."""

    error: np.ndarray
    effect: np.ndarray


def difference(
    folder: Path, world: str, plain: np.ndarray, whole: Whole | None = None
) -> Difference:
    """Of a world; plain [T + 1, 2]: the arm as declared. whole: What runs it; None: a program of
    its own.
    """
    path = written(folder, world)
    env = mended(arm(), path)
    one = rolled(env) if whole is None else whole.rolled(env)
    other = replayed(path)

    def rms(x):
        # at the first row no command is there yet, the last has no step after it
        return np.sqrt(np.mean(np.square(x[1:-1]), 0))

    return Difference(rms(one - other), rms(other - plain))


def main() -> None:
    """A line for each world."""
    with TemporaryDirectory() as one, TemporaryDirectory() as other:
        folder, whole = Path(one), Whole(Path(other))
        plain = replayed(written(folder, "nothing"))
        print("world, mrad by which both differ and that it does, shoulder and elbow")
        for world in WORLDS:
            found = difference(folder, world, plain, None if world in OF_ITS_OWN else whole)
            numbers = " ".join(f"{1e3 * z:7.2f}" for z in (*found.error, *found.effect))
            print(f"{world:22s} {numbers}", flush=True)


if __name__ == "__main__":
    main()
