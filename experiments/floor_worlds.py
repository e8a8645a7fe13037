"""A quadruped that walks on a floor by position commands, with one thing that its model file lacks:
what `diagnose` names.

    python experiments/floor_worlds.py ROBOTS OUT --robot unitree_go1__go1 --worlds \\
        floor_friction null --seeds 100 101

ROBOTS: a folder of MJCF files, one of which has legs driven by position servos. Each world: 8
trials of 4 s at 100 Hz of a trot whose speed, stride and turn are drawn, made by MuJoCo at the
file's own step (or `--fine` s), angles with noise of 2e-4 rad, the base's pose with 3e-4 m and 5e-4
rad (with `--imu`: its gyro and accelerometer instead). A line of JSON a world: what was hidden,
what was named, whether that is right, seconds of wall and of processor.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

RATE = 100  # Hz
NOISE = {
    "q": 2e-4,
    "place": 3e-4,
    "turn": 5e-4,
    "gyro": 5e-3,
    "accelerometer": 5e-2,
}  # rad, m, rad, rad/s, m/s^2
WORLDS = ("floor_friction", "payload", "calf_friction", "late", "weak_motor", "tilted", "null")
NAMES = {
    "floor_friction": "floor friction",
    "payload": "payload",
    "calf_friction": "coulomb",
    "late": "delay",
    "weak_motor": "gain",
    "tilted": "tilted",
}


def floored(path: Path, folder: Path) -> mujoco.MjSpec:
    """The robot over a floor, with an IMU at its base, written as `model.xml`; without its
    meshes.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.cone = (
        mujoco.mjtCone.mjCONE_PYRAMIDAL
    )  # the file's elliptic cone takes 2.2 times as long a step
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20, 20, 0.1])
    base = next(j.parent for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE)
    base.add_site(name="imu_place", pos=[0.02, 0.0, 0.03])
    for kind, name in (
        (mujoco.mjtSensor.mjSENS_GYRO, "imu_gyro"),
        (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "imu_accel"),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu_place")
    spec.compile()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(spec.to_xml())
    return spec


def hidden(model: mujoco.MjModel, world: str, rng: np.random.Generator) -> dict:
    """Change the model as the world has it; what was changed, with the name and place that are
    right. A delay [s] is the caller's.
    """
    out = {"world": world, "delay": 0.0, "right": NAMES.get(world, ""), "where": ""}
    driven = [(k, int(model.actuator_trnid[k, 0])) for k in range(model.nu)]
    calves = [
        (k, j) for k, j in driven if "calf" in model.joint(j).name or "knee" in model.joint(j).name
    ]
    if world == "floor_friction":
        out["size"] = float(rng.uniform(0.3, 0.55))
        model.geom_friction[:, 0] *= out["size"]
    elif world == "payload":
        base = int(model.jnt_bodyid[0])
        out |= {"size": float(rng.uniform(1.0, 2.5)), "where": model.body(base).name}
        share = out["size"] / model.body_mass[base]
        place = rng.uniform([-0.1, -0.04, 0.05], [0.1, 0.04, 0.1])
        model.body_ipos[base] = (model.body_ipos[base] + share * place) / (1.0 + share)
        model.body_mass[base] *= 1.0 + share
        model.body_inertia[base] *= 1.0 + share
    elif world == "calf_friction":
        k, j = calves[rng.integers(len(calves))]
        out |= {"size": float(rng.uniform(1.0, 2.0)), "where": model.joint(j).name}
        model.dof_frictionloss[model.jnt_dofadr[j]] += out["size"]
    elif world == "late":
        out |= {"delay": float(rng.uniform(0.008, 0.02))}
        out["size"] = out["delay"]
    elif world == "weak_motor":
        k, j = driven[rng.integers(len(driven))]
        out |= {"size": float(rng.uniform(0.6, 0.8)), "where": model.actuator(k).name}
        model.actuator_gainprm[k, :3] *= out["size"]
        model.actuator_biasprm[k, :3] *= out["size"]
    elif world == "tilted":
        way, size = rng.uniform(0, 2 * np.pi), float(rng.uniform(0.03, 0.06))
        out["size"] = size
        half = 0.5 * size
        model.geom_quat[model.geom("floor").id] = [
            np.cos(half),
            np.cos(way) * np.sin(half),
            np.sin(way) * np.sin(half),
            0,
        ]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return out


def gait(model: mujoco.MjModel, rest: np.ndarray, rng: np.random.Generator):
    """t -> [nu]: a trot from `rest` [nu], its pace, stride, lift, sway and turn drawn."""
    names = [model.joint(int(model.actuator_trnid[k, 0])).name.upper() for k in range(model.nu)]
    pair = np.array([0.0 if n[:2] in ("FL", "RR") else np.pi for n in names])
    side = np.array([1.0 if n[1] == "L" else -1.0 for n in names])
    part = [next(i for i, w in enumerate(("HIP", "THIGH", "CALF")) if f"{w}_" in n) for n in names]
    pace, stride, lift = rng.uniform(1.5, 2.8), rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.45)
    sway, turn = rng.uniform(0.03, 0.12), rng.uniform(-0.5, 0.5)

    def told(t: float) -> np.ndarray:
        phase = 2 * np.pi * pace * t + pair
        forth = stride * (1.0 + turn * side) * np.sin(phase)
        up = lift * np.maximum(np.cos(phase), 0.0)
        move = np.stack([sway * np.sin(phase + 0.7), forth + 0.5 * up, -up])
        return rest + min(1.0, 2.0 * t) * move[part, np.arange(len(part))]

    return told


def record(
    model: mujoco.MjModel, folder: Path, delay: float, imu: bool, rng: np.random.Generator
) -> list[float]:
    """Eight trials into `folder`; by trial how far the base's height went down [m]."""
    data, fine = mujoco.MjData(model), float(model.opt.timestep)
    joints = [k for k in range(model.njnt) if model.jnt_type[k] >= 2]
    base = [f"base_{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    sensed = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    names = [
        "time",
        *(f"q_{model.joint(k).name}" for k in joints),
        *(f"ctrl_{model.actuator(k).name}" for k in range(model.nu)),
    ]
    names += sensed if imu else base
    table = (
        ["[channels]", *(f'{c} = "imu_{c[:-2]}[{"xyz".index(c[-1])}]"' for c in sensed)]
        if imu
        else []
    )
    (folder / "meta.toml").write_text(
        "\n".join(['task = "mechanism"', 'model = "model.xml"', 'simulator = "mujoco"', *table, ""])
    )
    rest, low = model.key_ctrl[0].copy(), []
    for trial in range(8):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        told, rows, sensor = gait(model, rest, rng), [], np.zeros(6)
        for row in range(-RATE // 2, 4 * RATE):
            shown = told(max(row, 0) / RATE)
            q, pose = data.qpos[[model.jnt_qposadr[k] for k in joints]], data.qpos[:7].copy()
            for step in range(round(1.0 / RATE / fine)):
                t = row / RATE + step * fine - delay
                data.ctrl[:] = told(max(np.floor(t * RATE + 1e-9) / RATE, 0.0))
                mujoco.mj_step(model, data)
                sensor = data.sensordata[:6].copy() if step == 0 else sensor
            if row < 0:
                continue
            q = q + NOISE["q"] * rng.standard_normal(len(q))
            pose[:3] += NOISE["place"] * rng.standard_normal(3)
            mujoco.mju_quatIntegrate(pose[3:], NOISE["turn"] * rng.standard_normal(3), 1.0)
            sensor += np.repeat([NOISE["gyro"], NOISE["accelerometer"]], 3) * rng.standard_normal(6)
            rows.append([row / RATE, *q, *shown, *(sensor if imu else pose)])
        low.append(
            float(min(r[len(joints) + model.nu + 3] for r in rows))
            if not imu
            else float(data.qpos[2])
        )
        np.savetxt(
            folder / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(names),
            comments="",
            fmt="%.9g",
        )
    return low


def judged(truth: dict, report: dict) -> str:
    """right, wrong (another name, or one too many) or missed."""
    named = [(e["name"].split(" at ")[0], e["where"]) for e in report["effects"]]
    hit = [n == truth["right"] and truth["where"] in ("", w) for n, w in named]
    if not named:
        return "right" if not truth["right"] else "missed"
    return "right" if hit == [True] else "wrong"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robot", default="unitree_go1__go1")
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[100])
    parser.add_argument("--fine", type=float, default=0.0)
    parser.add_argument("--imu", action="store_true")
    args = parser.parse_args()
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.logs.read import read_source_and_log
    from adaptsim_jax.simulators.mujoco.diagnosed import diagnose, simulator

    for seed in args.seeds:
        for world in args.worlds:
            rng = np.random.default_rng([seed, WORLDS.index(world)])
            data = args.out / f"{args.robot}_{world}_{seed}"
            model = floored(args.folder / f"{args.robot}.xml", data).compile()
            model.opt.timestep = args.fine or model.opt.timestep
            truth = hidden(model, world, rng)
            low = record(model, data, truth["delay"], args.imu, rng)
            began, busy = time.monotonic(), time.process_time()
            try:
                report = diagnose(simulator(*read_source_and_log(data)), out=data / "out")
                named = [
                    {
                        "name": e["name"],
                        "alternatives": e["alternatives"],
                        "size": {
                            k: [round(v[z], 4) for z in ("value", "low", "high")]
                            for k, v in e["parameters"].items()
                        },
                    }
                    for e in report["effects"]
                ]
                told = {
                    "judged": judged(truth, report),
                    "named": named,
                    "verdict": report["verdict"],
                    "error": [round(report["error"][k], 2) for k in ("before", "after")],
                }
            except BadInput as error:
                told = {"failed": str(error)}
            took = {
                "seconds": round(time.monotonic() - began, 1),
                "busy": round(time.process_time() - busy, 1),
            }
            print(
                json.dumps({"seed": seed} | truth | told | took | {"lowest": round(min(low), 3)}),
                flush=True,
            )


if __name__ == "__main__":
    main()
