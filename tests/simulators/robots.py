"""Small robots and logs of them, made by MuJoCo: independent of the package."""

import mujoco
import numpy as np

HOPPER = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
<body name="trunk" pos="0 0 0.42"><freejoint name="root"/><geom name="box" type="box" size="0.15 0.1 0.05" mass="4"/>
{legs}</body></worldbody><actuator>{servos}</actuator></mujoco>"""  # noqa: E501
LEG = """<body name="{n}_thigh" pos="{x} {y} 0"><joint name="{n}_hip" axis="0 1 0" range="-1.5 1.5" damping="0.2" frictionloss="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/><body name="{n}_shin" pos="0 0 -0.2">
<joint name="{n}_knee" axis="0 1 0" damping="0.2"/><geom type="capsule" fromto="0 0 0 0 0 -0.18" size="0.015" mass="0.2"/>
<geom name="{n}_foot" type="sphere" pos="0 0 -0.2" size="0.02" mass="0.05" friction="0.5 0.01 0.001"/></body></body>"""  # noqa: E501
CORNERS = {"fl": (0.15, 0.1), "fr": (0.15, -0.1), "bl": (-0.15, 0.1), "br": (-0.15, -0.1)}


def quadruped() -> str:
    """Four legs of two joints on a free base, over a floor."""
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, (x, y) in CORNERS.items())
    names = [f"{n}_{j}" for n in CORNERS for j in ("hip", "knee")]
    servos = "".join(
        f'<position name="{n}" joint="{n}" kp="40" kv="1" forcerange="-20 20"/>' for n in names
    )
    return HOPPER.format(legs=legs, servos=servos)


def record(
    folder,
    text: str,
    *,
    truth: str = "",
    told=None,
    trials: int = 2,
    seconds: float = 1.2,
    every: int = 5,
    base: bool = False,
):
    """Logs of `truth` (the model itself where empty) into `folder`, with `model.xml`; told(t,
    trial) -> commands [nu].
    """
    folder.mkdir(exist_ok=True)
    (folder / "model.xml").write_text(text)
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model = mujoco.MjModel.from_xml_string(truth or text)
    data = mujoco.MjData(model)
    joints = [k for k in range(model.njnt) if model.jnt_type[k] >= 2]
    head = [
        "time",
        *(f"q_{model.joint(k).name}" for k in joints),
        *(f"ctrl_{model.actuator(k).name}" for k in range(model.nu)),
    ]
    head += [f"base_{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz")] if base else []
    for trial in range(trials):
        mujoco.mj_resetData(model, data)
        rows = []
        for row in range(int(seconds / (every * model.opt.timestep))):
            t = row * every * model.opt.timestep
            data.ctrl[:] = told(t, trial)
            angles = [data.qpos[model.jnt_qposadr[k]] for k in joints]
            rows.append([t, *angles, *data.ctrl, *(data.qpos[:7] if base else [])])
            for _ in range(every):
                mujoco.mj_step(model, data)
        np.savetxt(
            folder / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(head),
            comments="",
            fmt="%.12g",
        )
    return folder


def walk(t: float, trial: int) -> np.ndarray:
    """Hips and knees of four legs that push to and fro."""
    phase = np.array([0.0, np.pi, np.pi, 0.0]) + trial
    hip = 0.35 * np.sin(2 * np.pi * 1.5 * t + phase)
    return np.stack([0.3 + hip, -0.6 + 0.3 * np.cos(2 * np.pi * 1.5 * t + phase)], 1).ravel()
