"""Worlds of a real arm's kind: torques with ripple and noise, dry friction of a third of the
torque, slow motions, inertias off.

    write_arm(folder, robot, kind, seed)     -> folder/model.xml, meta.toml, trial_*.csv; the truth
    is returned
    write_days(folder, robot, seed)          -> folder/day1, day2, ..., each such a log of one arm,
    one with a payload, one with a late clock

Shares no code with the package: MuJoCo steps it, with its own Coulomb friction (nearly rigid), and
a computed-torque controller that does
not know of the effects moves it along sums of slow sines.
"""

import re
from pathlib import Path

import mujoco
import numpy as np

KINDS = ("null", "friction", "rotor", "gain", "offset", "spring", "stribeck")
PAYLOAD = "payload"
"""Carried by the last body, which the file does not know: a kind of its own, or beside another as
in "spring+payload"."""


def write_arm(
    folder: Path,
    robot: Path,
    kind: str,
    seed: int,
    seconds: float = 30.0,
    rate: int = 100,
    noise: float = 1e-4,
) -> dict:
    """kind: `null` (the file has the friction), `friction` alone, or friction with one effect more
    at one or two joints; with `+payload`, or as `payload` alone, the last body carries 0.3 to 2 kg.
    """
    kind, _, carried = kind.replace(PAYLOAD, f"friction+{PAYLOAD}", kind == PAYLOAD).partition("+")
    rng = np.random.default_rng(seed)
    spec, n = _arm(robot)
    model = spec.compile()
    weight, reach = _torques(model, rng)
    level = weight * rng.uniform(0.2, 0.45, n)
    viscous = level * rng.uniform(0.3, 1.0, n)
    truth: dict = {
        "kind": kind,
        "coulomb": level,
        "viscous": viscous,
        "effects": [("coulomb", j) for j in range(n)],
    }
    joints = [j for j in spec.joints]
    declared, _ = _arm(robot)
    for j, joint in enumerate(joints):
        joint.frictionloss, joint.damping = level[j], [viscous[j], 0.0, 0.0]
        joint.solref_friction, joint.solimp_friction = [0.002, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
    gain, offset, stiff = np.ones(n), np.zeros(n), np.zeros(n)
    some = rng.choice(n, size=rng.integers(1, 3), replace=False)
    inertia = np.diagonal(_mass(model))
    for j in some if kind not in ("null", "friction", "stribeck") else ():
        if kind == "rotor":
            joints[j].armature = joints[j].armature + float(
                inertia[j] * rng.uniform(1.0, 3.0) + 0.02
            )
            truth["effects"].append(("armature", int(j)))
        elif kind == "gain":
            gain[j] = 1.0 + rng.choice([-1, 1]) * rng.uniform(0.2, 0.4)
            truth["effects"].append(("torque_gain", int(j)))
        elif kind == "offset":
            offset[j] = rng.choice([-1, 1]) * rng.uniform(0.15, 0.4) * weight[j]
            truth["effects"].append(("bias", int(j)))
        elif kind == "spring":
            stiff[j] = rng.uniform(0.5, 1.0) * weight[j] / reach[j]
            joints[j].stiffness = [stiff[j], 0.0, 0.0]
            truth["effects"].append(("spring", int(j)))
    if carried:
        truth["payload"] = _load(spec, np.random.default_rng([seed, 1]))
    if kind == "null":
        truth["effects"] = []
        for j, joint in enumerate(declared.joints):
            joint.frictionloss, joint.damping = level[j], [viscous[j], 0.0, 0.0]
    _disturb(declared, rng)
    folder.mkdir(parents=True)
    (folder / "model.xml").write_text(declared.to_xml())
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\ninput = "torque"\n')
    _record(folder, spec.compile(), level, viscous, gain, offset, reach, rng, seconds, rate, noise)
    return truth


def _load(spec, rng) -> float:
    """The last body carries a ball up to 8 cm from its centre. Its mass, kg."""
    body = [j.parent for j in spec.joints][-1]
    mass, place = float(rng.uniform(0.3, 2.0)), np.asarray(body.ipos) + rng.uniform(-0.08, 0.08, 3)
    ball = body.add_body(name="ball", pos=place)
    ball.mass, ball.inertia, ball.explicitinertial = mass, [4e-4 * mass] * 3, True
    return mass


def write_days(
    folder: Path,
    robot: Path,
    seed: int,
    days: int = 6,
    trials: int = 3,
    seconds: float = 10.0,
    loaded: str = "day3",
    late: str = "day5",
    payload: float = 0.5,
    rows: int = 2,
    rate: int = 100,
    noise: float = 1e-4,
) -> dict:
    """Logs of one arm with dry friction. payload: kg at the last body on the day `loaded`; rows: by
    which the torques of the day `late` come after the angles.
    """
    rng = np.random.default_rng(seed)
    spec, n = _arm(robot)
    weight, reach = _torques(spec.compile(), rng)
    level = weight * rng.uniform(0.2, 0.45, n)
    viscous = level * rng.uniform(0.3, 1.0, n)
    for j, joint in enumerate(spec.joints):
        joint.frictionloss, joint.damping = level[j], [viscous[j], 0.0, 0.0]
        joint.solref_friction, joint.solimp_friction = [0.002, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
    plain = spec.compile()
    held = [b for b in spec.bodies if b.mass > 0][-1].add_body(pos=[0.0, 0.0, 0.08])
    held.mass, held.inertia, held.explicitinertial = payload, [4e-4] * 3, True
    heavy = spec.compile()
    declared, _ = _arm(robot)
    _disturb(declared, rng)
    settings = (level, viscous, np.ones(n), np.zeros(n), reach, rng, seconds, rate, noise)
    for day in (f"day{k + 1}" for k in range(days)):
        (folder / day).mkdir(parents=True)
        (folder / day / "model.xml").write_text(declared.to_xml())
        meta = 'task = "mechanism"\nmodel = "model.xml"\ninput = "torque"\n'
        (folder / day / "meta.toml").write_text(meta)
        for k in range(trials):
            name = f"trial_{k}.csv"
            _record(folder / day, heavy if day == loaded else plain, *settings, name=name)
            if day == late:
                _delay(folder / day / name, n, rows)
    return {"coulomb": level, "viscous": viscous, "model": plain}


def _delay(path: Path, n: int, rows: int) -> None:
    """The torques of a table so many rows later."""
    names = path.read_text().splitlines()[0]
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[rows:, -n:] = table[:-rows, -n:]
    np.savetxt(path, table[rows:], delimiter=",", header=names, comments="", fmt="%.8g")


def _arm(robot: Path):
    """The robot without shapes, sensors, actuators, and with torque-free joints of its first chain
    of at most seven hinges.
    """
    text = re.sub(
        r"<(sensor|keyframe|contact|tendon|equality|actuator)>.*?</\1>",
        "",
        robot.read_text(),
        flags=re.S,
    )
    spec = mujoco.MjSpec.from_string(text)
    for kind in (
        spec.sensors,
        spec.keys,
        spec.pairs,
        spec.excludes,
        spec.actuators,
        spec.equalities,
    ):
        for item in list(kind):
            spec.delete(item)
    for body in spec.bodies:
        for geom in list(body.geoms):
            spec.delete(geom)
        body.gravcomp = 0.0
    for kind in (spec.meshes, spec.materials, spec.textures):
        for item in list(kind):
            spec.delete(item)
    for joint in spec.joints:
        joint.frictionloss, joint.damping, joint.stiffness = 0.0, [0.0] * 3, [0.0] * 3
        joint.limited, joint.actfrclimited = 0, 0
        joint.armature = max(
            joint.armature, 0.02
        )  # a rotor, which the file knows; and friction is rigid where something is heavy
    spec.option.timestep = 5e-4
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec, len(spec.joints)


def _mass(model) -> np.ndarray:
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(
        model, data, full
    )
    return full


def _torques(model, rng) -> tuple[np.ndarray, np.ndarray]:
    """Typical torque of each joint over random postures, and how far it will move."""
    data, size = mujoco.MjData(model), []
    for _ in range(60):
        data.qpos[:] = rng.uniform(-1.0, 1.0, model.nq)
        data.qvel[:], data.qacc[:] = rng.normal(0, 0.8, model.nv), rng.normal(0, 2.0, model.nv)
        mujoco.mj_inverse(model, data)
        size.append(np.abs(data.qfrc_inverse.copy()))
    return np.quantile(size, 0.7, axis=0) + 1e-3, rng.uniform(0.5, 0.9, model.nv)


def _disturb(spec, rng) -> None:
    """Masses and moments off by up to 30 %, centres by a few millimetres."""
    for body in spec.bodies:
        if body.mass > 0:
            factor = rng.uniform(0.7, 1.3)
            body.mass *= factor
            if np.all(np.isfinite(body.inertia)) and np.any(np.asarray(body.inertia) > 0):
                body.inertia = np.asarray(body.inertia) * factor * rng.uniform(0.9, 1.1)
            body.ipos = np.asarray(body.ipos) + rng.normal(0, 0.004, 3)


def _record(
    folder,
    model,
    level,
    viscous,
    gain,
    offset,
    reach,
    rng,
    seconds,
    rate,
    noise,
    name="trial_0.csv",
) -> None:
    n, data = model.nv, mujoco.MjData(model)
    waves = (
        rng.uniform(0.05, 0.35, (4, n)),
        rng.uniform(0, 2 * np.pi, (4, n)),
        rng.uniform(0.3, 1.0, (4, n)),
    )
    size = reach / waves[2].sum(0)

    def path(t):
        return (
            (size * waves[2] * np.sin(2 * np.pi * waves[0] * t + waves[1])).sum(0),
            (
                size * waves[2] * 2 * np.pi * waves[0] * np.cos(2 * np.pi * waves[0] * t + waves[1])
            ).sum(0),
            -(
                size
                * waves[2]
                * (2 * np.pi * waves[0]) ** 2
                * np.sin(2 * np.pi * waves[0] * t + waves[1])
            ).sum(0),
        )

    data.qpos[:], data.qvel[:], _ = path(0.0)
    dt, rows, steps = model.opt.timestep, [], round(1.0 / rate / model.opt.timestep)
    torque = np.zeros(n)
    inertia = np.diagonal(_mass(model))
    for k in range(round(seconds * rate)):
        q, v, a = path(k / rate)
        for _ in range(steps):
            want = a + 400.0 * (q - data.qpos) + 40.0 * (v - data.qvel)
            full = np.zeros((n, n))
            mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(
                model, data, full
            )
            push = np.clip(level / 0.02 * data.qvel, -level, level) + viscous * data.qvel
            torque = full @ want + data.qfrc_bias - data.qfrc_passive * 0.0 + push
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
            now = path(data.time)
            q, v, a = now
        ripple = 0.01 * level * np.sin(11.0 * data.qpos + 1.0)
        told = (torque - offset) / gain + 0.05 * level * rng.normal(size=n) + ripple
        rows.append(np.concatenate([[k / rate], data.qpos + noise * rng.normal(size=n), told]))
    assert np.all(np.isfinite(rows)) and np.all(inertia > 0) and dt > 0
    names = ",".join(["time", *(f"q{j + 1}" for j in range(n)), *(f"tau{j + 1}" for j in range(n))])
    np.savetxt(folder / name, rows, delimiter=",", header=names, comments="", fmt="%.8g")
