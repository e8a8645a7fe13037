"""Small machines and logs of them, made by MuJoCo: one of each kind that the searches treat
otherwise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

RATE = 100.0  # rows a second
LENGTHS = (1.6, 1.2, 2.0)  # s of each trial
META = 'task = "mechanism"\nmodel = "{file}"\n'

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.05"/>
<inertial pos="0 0 -0.15" mass="1.0" diaginertia="0.01 0.01 0.002"/>
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.03" {elbow}/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.004 0.004 0.001"/>{more}</body></body></worldbody>
{equality}<actuator>{actuators}</actuator></mujoco>"""  # noqa: E501
MOTORS = '<motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
SERVOS = (
    '<position name="shoulder" joint="shoulder" kp="60" kv="3"/>'
    '<position name="elbow" joint="elbow" kp="{kp}" kv="1.5"/>'
)
FOLLOWER = (
    '<body name="finger" pos="0 0 -0.2"><joint name="finger" axis="0 1 0" damping="0.01"/>'
    '<inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/></body>'
)
TIED = '<equality><joint joint1="finger" joint2="elbow" polycoef="0 0.5 0 0 0"/></equality>'
URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.15"/><mass value="1.0"/>
<inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="package://nowhere/upper.stl"/></geometry></visual></link>
<link name="lower"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<dynamics damping="0.05"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/><dynamics damping="0.03"/></joint></robot>"""  # noqa: E501


def arm(elbow: str = "", more: str = "", equality: str = "", actuators: str = MOTORS) -> str:
    """MJCF of an arm of two joints that hangs."""
    return ARM.format(elbow=elbow, more=more, equality=equality, actuators=actuators)


@dataclass(frozen=True)
class Machine:
    """A model file, what the machine is really (MJCF), the size of its inputs by joint, and whether
    these are angles.
    """

    file: str
    own: str
    size: tuple[float, ...]
    angles: bool = False
    name: str = "model.xml"


MACHINES: dict[str, Machine] = {
    "motors": Machine(arm(), arm('frictionloss="0.15"'), (1.5, 0.5)),
    "servos": Machine(
        arm(actuators=SERVOS.format(kp=30)),
        arm(actuators=SERVOS.format(kp=12)),
        (0.5, 0.6),
        angles=True,
    ),
    "stop": Machine(
        arm('limited="true" range="-0.3 0.3"'),
        arm('limited="true" range="-0.3 0.3" frictionloss="0.02"'),
        (0.5, 0.5),
    ),
    "follower": Machine(
        arm(more=FOLLOWER, equality=TIED),
        arm(more=FOLLOWER, equality=TIED, elbow='frictionloss="0.1"'),
        (1.5, 0.5),
    ),
    "urdf": Machine(URDF, arm('armature="0.01"'), (1.5, 0.5), name="arm.urdf"),
}


def commanded(rng: np.random.Generator, size: tuple[float, ...]) -> Callable[[float], np.ndarray]:
    """Sums of three sines that begin at rest, as a function of time (s)."""
    speed = rng.uniform(1.5, 9.0, (3, len(size)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, len(size)))
    return lambda t: np.array(size) * np.sin(speed * t + phase).sum(0) * min(1.0, 4.0 * t)


def record(folder: Path, name: str, noise: float = 1e-4) -> Path:
    """Three trials of unlike length of a machine in a folder, with its model file; angles have
    noise (rad).
    """
    folder.mkdir(exist_ok=True)
    made = MACHINES[name]
    (folder / made.name).write_text(made.file)
    (folder / "meta.toml").write_text(META.format(file=made.name))
    model, rng = mujoco.MjModel.from_xml_string(made.own), np.random.default_rng(5)
    joints = [model.joint(k).name for k in range(model.njnt)]
    kind = "ctrl" if made.angles else "tau"
    head = ["time", *(f"q_{j}" for j in joints), f"{kind}_shoulder", f"{kind}_elbow"]
    every = round(1.0 / (RATE * model.opt.timestep))
    for trial, seconds in enumerate(LENGTHS):
        data, told, rows = mujoco.MjData(model), commanded(rng, made.size), []
        for k in range(int(seconds * RATE)):
            data.ctrl[:] = told(k / RATE)
            angles = data.qpos + noise * rng.standard_normal(model.njnt)
            rows.append([k / RATE, *angles, *data.ctrl])
            mujoco.mj_step(model, data, every)
        path = folder / f"run_{trial}.csv"
        np.savetxt(path, rows, "%.9g", ",", header=",".join(head), comments="")
    return folder
