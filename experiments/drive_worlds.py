"""Arms of three joints, driven by torque, of which one drive gives: rotor and link turn against
each other. Made, diagnosed, counted.

    python experiments/drive_worlds.py OUT --seed 1 --count 6

A spring between rotor and link, which MuJoCo has as a joint of its own; the encoder is on the
rotor's side in even worlds and on the link's side in odd ones. A controller holds the motors at
200 Hz. 6 trials of 4 s at 200 Hz, swings of 0.6 rad below 3 Hz, noise of 0.1 mrad. A line of JSON a
world; a last line of how many have the drive named at its joint.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np

NOISE, ROW, FINE, SWING, FASTEST = 1e-4, 5e-3, 2.5e-4, 0.6, 3.0  # rad, s, s, rad, Hz
TRIALS, SECONDS, FAST = 6, 4.0, 20.0  # FAST: rad/s of the controller
NAMES = ("drive_elasticity", "drive_compliance", "drive_backlash")
LINKS = ((0.0, 0.15, 2.0, "0 0 1"), (0.15, 0.3, 1.5, "0 1 0"), (0.3, 0.25, 0.8, "0 1 0"))
ROTORS = (0.05, 0.04, 0.015)  # kg m2


def arm(spring: int | None, stiffness: float = 0.0, dashpot: float = 0.0) -> str:
    """MJCF of the arm; spring: the joint whose drive gives (N m/rad, N m s/rad)."""
    text, ends = "", ""
    for j, (up, length, mass, axis) in enumerate(LINKS):
        joint = (
            f'<joint name="j{j + 1}" axis="{axis}" damping="0.2" armature="{ROTORS[j]}" '
            'range="-2 2"/>'
        )
        geom = f'<geom type="capsule" fromto="0 0 0 0 0 {length}" size=".03" mass="{mass}" contype="0" conaffinity="0"/>'  # noqa: E501
        text += f'<body name="b{j + 1}" pos="0 0 {up}">{joint}'
        if spring == j:
            tiny = '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
            text += f'{tiny}<body><joint name="spring" axis="{axis}" stiffness="{stiffness}" damping="{dashpot}"/>'  # noqa: E501
            ends += "</body>"
        text += geom
        ends += "</body>"
    motors = "".join(f'<motor name="j{j}" joint="j{j}"/>' for j in (1, 2, 3))
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{FINE}" integrator="RK4"/>'
        f"<worldbody>{text}{ends}</worldbody>"
        f"<actuator>{motors}</actuator></mujoco>"
    )


def recorded(folder: Path, rng: np.random.Generator, link: bool) -> dict:
    """The folder of a world; what is hidden in it. link: the encoder is on the link's side."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(arm(None))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "arm.xml"\ninput = "torque"\n')
    nominal = mujoco.MjModel.from_xml_string(arm(None))
    j = int(rng.integers(3))
    stiffness = float(ROTORS[j] * (2.0 * np.pi * rng.uniform(8.0, 16.0)) ** 2)
    dashpot = float(0.1 * np.sqrt(stiffness * ROTORS[j]))
    model = mujoco.MjModel.from_xml_string(arm(j, stiffness, dashpot))
    rotors = [model.joint(f"j{k}").qposadr[0] for k in (1, 2, 3)]
    spring = int(model.joint("spring").qposadr[0])
    for trial in range(TRIALS):
        speed, phase = rng.uniform(0.3, FASTEST, (4, 3)), rng.uniform(0, 6.3, (4, 3))
        data, ideal, rows = mujoco.MjData(model), mujoco.MjData(nominal), []
        inertia = 1.0 / nominal.dof_invweight0

        def target(t, speed=speed, phase=phase):
            return SWING / 4.0 * np.sin(2 * np.pi * speed * t + phase).sum(0)

        data.qpos[rotors] = target(0.0)
        for k in range(round((SECONDS + 1.0) / ROW)):
            ideal.qpos[:] = data.qpos[rotors]
            mujoco.mj_forward(nominal, ideal)
            late = target(k * ROW) - data.qpos[rotors]
            torque = ideal.qfrc_bias + inertia * FAST * (FAST * late - 2.0 * data.qvel[rotors])
            data.ctrl[:] = torque
            if k * ROW >= 1.0:
                angles = data.qpos[rotors].copy()
                angles[j] += link * data.qpos[spring]
                angles += NOISE * rng.standard_normal(3)
                rows.append([k * ROW - 1.0, *angles, *torque])
            mujoco.mj_step(model, data, round(ROW / FINE))
        np.savetxt(
            folder / f"t{trial}.csv",
            rows,
            fmt="%.8g",
            delimiter=",",
            header="time,q_j1,q_j2,q_j3,tau_j1,tau_j2,tau_j3",
            comments="",
        )
    return {"joint": f"j{j + 1}", "stiffness": stiffness, "link": link}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=6)
    given = parser.parse_args()
    from adaptsim_jax.attribution.diagnose import diagnose

    named = 0
    for k in range(given.count):
        folder = given.out / f"{given.seed}_{k}"
        truth = recorded(folder, np.random.default_rng([given.seed, k]), bool(k % 2))
        began = time.monotonic()
        report = diagnose(folder, out=folder / "out")
        found = [(row["name"], row["where"]) for row in report["effects"]]
        right = any((name, truth["joint"]) in found for name in NAMES)
        named += right
        row = truth | {"named": found, "right": right, "judge": report["yardsticks"]["judge"]}
        row |= {"error": report["error"], "seconds": round(time.monotonic() - began)}
        print(json.dumps(row), flush=True)
    print(json.dumps({"named": named, "worlds": given.count}))


if __name__ == "__main__":
    main()
