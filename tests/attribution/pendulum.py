"""A pendulum with recordings of it, made by MuJoCo's C engine."""

from pathlib import Path

import mujoco
import numpy as np

XML = """<mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="implicitfast"/><worldbody>
<body name="link"><joint name="hinge" axis="0 1 0" damping="{damping}" frictionloss="{friction}"
solreffriction="0.002 1" solimpfriction="0.99 0.999 0.001"/>
<inertial pos="0 0 -0.25" mass="{mass}" diaginertia="0.01 0.01 0.001"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""  # noqa: E501


def record(
    folder: Path,
    friction: float,
    trials: int = 6,
    seconds: float = 4.0,
    seed: int = 0,
    noise: float = 2e-4,
    rate: int = 250,
    digits: int = 8,
    held: bool = True,
) -> Path:
    """A folder with meta.toml, the declared model (mass 20 % off, no friction) and trials of the
    true one; held: whether the torque is from row to row.
    """
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(XML.format(damping=0.02, friction=friction, mass=1.0))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(XML.format(damping=0.01, friction=0.0, mass=1.2))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    steps = round(1.0 / rate / model.opt.timestep)
    for k in range(trials):
        data = mujoco.MjData(model)
        data.qpos[0] = rng.uniform(-1.0, 1.0)
        phase, speed = rng.uniform(0, 6, 3), rng.uniform(1.0, 9.0, 3)
        rows = []

        def torque(t, speed=speed, phase=phase):
            return 0.6 * np.sin(speed * t + phase).sum()

        for i in range(round(seconds * rate)):
            t = i / rate
            rows.append([t, data.qpos[0] + noise * rng.normal(), torque(t)])
            for step in range(steps):
                data.ctrl[0] = torque(t if held else t + step * model.opt.timestep)
                mujoco.mj_step(model, data)
        np.savetxt(
            folder / f"trial_{k:02d}.csv",
            rows,
            delimiter=",",
            header="time,q1,tau1",
            comments="",
            fmt=f"%.{digits}g",
        )
    return folder


def record_bristles(
    folder: Path, level: float, deflection: float, seed: int = 0, noise: float = 1e-4
) -> Path:
    """The same pendulum with LuGre friction of a break-away deflection [rad], by small steps of its
    own equations.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    (folder / "model.xml").write_text(XML.format(damping=0.01, friction=0.0, mass=1.2))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    inertia, weight, stiff, h, steps = 0.0725, 9.81 * 0.25, level / deflection, 5e-5, 80
    damped = np.sqrt(stiff * inertia)
    for k in range(6):
        phase, speed, q, v, bent, rows = (
            rng.uniform(0, 6, 3),
            rng.uniform(1.0, 9.0, 3),
            rng.uniform(-1, 1),
            0.0,
            0.0,
            [],
        )
        for i in range(1000):
            torque = 0.6 * np.sin(speed * i * steps * h + phase).sum()
            rows.append([i * steps * h, q + noise * rng.normal(), torque])
            for _ in range(steps):
                bends = v - abs(v) * bent / deflection
                rub = stiff * bent + damped * bends * np.exp(-((v / 0.1) ** 2))
                v += h * (torque - weight * np.sin(q) - 0.02 * v - rub) / inertia
                q, bent = q + h * v, bent + h * bends
        np.savetxt(
            folder / f"trial_{k:02d}.csv",
            rows,
            delimiter=",",
            header="time,q1,tau1",
            comments="",
            fmt="%.8g",
        )
    return folder
