"""Machines with position servos, logged every 10 or 20 ms, with one thing that their file lacks or
none: made, diagnosed, told.

    python experiments/servo_worlds.py --out runs/servos --seed 1

A belt (one slide), an arm of two joints and a hobby arm of four (12-bit encoders, 50 Hz), stepped
by MuJoCo at 1 ms: commands are held from row to row, so that a row pairs a command with the angle
before it acts. Each world is a folder with a log and its report.
"""

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose

BELT = """<mujoco><worldbody><body name="carriage">
<joint name="belt" type="slide" axis="1 0 0" damping="4" frictionloss="{rub}"/>
<geom type="box" size=".05 .05 .03" mass="{mass}"/></body></worldbody>
<actuator><position name="belt" joint="belt" kp="{kp}" kv="20" forcerange="-{limit} {limit}"/></actuator></mujoco>"""  # noqa: E501
ARM = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping=".05" armature=".02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1.5"/><body name="fore" pos="0 0 -.4">
<joint name="elbow" axis="0 1 0" damping=".03" armature=".01" frictionloss="{rub}" stiffness="{spring}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.35" size=".025" mass=".9"/><geom type="sphere" pos="0 0 -.35" size=".03" mass="{load}"/>
</body></body></worldbody><actuator>
<position name="shoulder" joint="shoulder" kp="60" kv="3" forcerange="-{limit} {limit}"/>
<position name="elbow" joint="elbow" kp="{kp}" kv="1.5"/></actuator></mujoco>"""  # noqa: E501
HOBBY = """<mujoco><option integrator="implicitfast"/><worldbody><body name="turret" pos="0 0 .1">
<joint name="pan" axis="0 0 1" damping=".1" armature=".01" frictionloss=".03"/><geom type="cylinder" size=".04 .03" mass=".3"/>
<body name="upper" pos="0 0 .05"><joint name="lift" axis="0 1 0" damping=".1" armature=".01" frictionloss=".03"/>
<geom type="capsule" fromto="0 0 0 .05 0 .2" size=".02" mass=".25"/><body name="fore" pos=".05 0 .2">
<joint name="elbow" axis="0 1 0" damping=".08" armature=".01" frictionloss="{rub}"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".018" mass=".2"/><body name="hand" pos=".2 0 0">
<joint name="wrist" axis="0 1 0" damping=".05" armature=".005" frictionloss=".02"/>
<geom type="box" size=".04 .02 .02" pos=".04 0 0" mass=".12"/><geom type="sphere" size=".02" pos=".08 0 0" mass="{load}"/>
</body></body></body></body></worldbody><actuator>
<position name="pan" joint="pan" kp="20" kv=".6" forcerange="-3 3"/><position name="lift" joint="lift" kp="20" kv=".6"
forcerange="-{limit} {limit}"/><position name="elbow" joint="elbow" kp="{kp}" kv=".6" forcerange="-3 3"/>
<position name="wrist" joint="wrist" kp="15" kv=".4" forcerange="-3 3"/></actuator></mujoco>"""  # noqa: E501


@dataclass(frozen=True)
class Kind:
    """A machine's file, its numbers there, ms between rows, sizes and speeds of its commands, noise
    of its encoders and their step.
    """

    mjcf: str
    file: dict[str, float]
    row: int
    size: tuple[float, float]
    speed: tuple[float, float]
    noise: float
    step: float = 0.0


@dataclass(frozen=True)
class World:
    kind: str
    name: str
    own: dict[str, float] = field(default_factory=dict)
    late: int = 0  # ms
    # effect and where, as a report has it; "" for none; "bodies" for a mass that is carried
    hidden: str = ""


KINDS = {
    "belt": Kind(
        BELT, {"rub": 0, "mass": 0.8, "kp": 400, "limit": 1000}, 10, (0.02, 0.08), (1, 12), 2e-5
    ),
    "arm": Kind(
        ARM,
        {"rub": 0, "spring": 0, "load": 1e-9, "kp": 40, "limit": 1000},
        10,
        (0.2, 0.6),
        (1, 8),
        2e-4,
    ),
    "hobby": Kind(
        HOBBY,
        {"rub": 0.03, "load": 1e-9, "kp": 20, "limit": 3},
        20,
        (0.1, 0.45),
        (0.5, 5),
        2e-4,
        np.pi / 2048,
    ),
}
WORLDS = (
    World("belt", "null"),
    World("belt", "friction", {"rub": 1.5}, hidden="coulomb at belt"),
    World("belt", "gain", {"kp": 120}, hidden="position_gain at belt"),
    World("belt", "mass", {"mass": 1.6}, hidden="bodies"),
    World("arm", "null"),
    World("arm", "friction", {"rub": 0.25}, hidden="coulomb at elbow"),
    World("arm", "spring", {"spring": 1.5}, hidden="spring at elbow"),
    World("arm", "gain", {"kp": 14}, hidden="position_gain at elbow"),
    World("arm", "limit", {"limit": 4}, hidden="saturation at shoulder"),
    World("arm", "delay", late=30, hidden="delay at all joints"),
    World("arm", "load", {"load": 0.4}, hidden="bodies"),
    World("hobby", "null"),
    World("hobby", "friction", {"rub": 0.18}, hidden="coulomb at elbow"),
    World("hobby", "gain", {"kp": 9}, hidden="position_gain at elbow"),
    World("hobby", "limit", {"limit": 1.0}, hidden="saturation at lift"),
    World("hobby", "delay", late=35, hidden="delay at all joints"),
    World("hobby", "load", {"load": 0.15}, hidden="bodies"),
)


def written(folder: Path, world: World, seed: int, trials: int = 4, seconds: float = 8.0) -> Path:
    """A world's folder: the file that lacks what it has, meta.toml, trials as CSV."""
    kind = KINDS[world.kind]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.xml").write_text(kind.mjcf.format(**kind.file))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "machine.xml"\n')
    model = mujoco.MjModel.from_xml_string(kind.mjcf.format(**(kind.file | world.own)))
    model.opt.timestep = 0.001
    rng, n = np.random.default_rng(seed), model.njnt
    joints = [model.joint(j).name for j in range(n)]

    def steps(z):
        return z if kind.step == 0.0 else np.round(z / kind.step) * kind.step

    for trial in range(trials):
        data, rows, sent = mujoco.MjData(model), [], []
        size, speed, phase = (rng.uniform(*z, (n, 3)) for z in (kind.size, kind.speed, (0.0, 6.0)))
        for k in range(round(1000 * seconds)):
            if k % kind.row == 0:
                target = steps(
                    (size * np.sin(speed * data.time + phase)).sum(1) * min(1.0, data.time)
                )
                rows.append(
                    [data.time, *steps(data.qpos + rng.normal(0.0, kind.noise, n)), *target]
                )
            sent.append(target)
            data.ctrl[:] = sent[max(0, k - world.late)]
            mujoco.mj_step(model, data)
        names = ",".join(["time", *(f"q_{j}" for j in joints), *(f"target_{j}" for j in joints)])
        np.savetxt(folder / f"run_{trial}.csv", rows, "%.7f", ",", header=names, comments="")
    return folder


def told(report: dict, hidden: str) -> str:
    """How a report does: right, a class with the right one in it, missed, or wrong."""
    names = {f"{e['name']} at {e['where']}": e["alternatives"] for e in report["effects"]}
    if hidden == "":
        quiet = not names and report["verdict"] == "within_noise"
        return "right" if quiet else "wrong" if names else "missed"
    if hidden == "bodies":  # a mass that the last body carries
        carried = [name for name in names if name.startswith("body_mass")]
        return "right" if len(carried) == len(names) == 1 else "wrong" if names else "missed"
    alike = {a.replace("@", " at ") for found in names.values() for a in found}
    if hidden in names:
        return "right" if len(names) == 1 else "right, and another"
    return "right, as a class" if hidden in alike else "wrong" if names else "missed"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    args = parser.parse_args()
    print(
        "| world | hidden | | named | left-out error over noise | s |\n| --- | --- | --- | --- | "
        "--- | --- |",
        flush=True,
    )
    for i, world in enumerate(WORLDS):
        folder = written(args.out / f"{world.kind}_{world.name}", world, 100 * args.seed + i)
        began = time.monotonic()
        report = diagnose(folder, out=args.out / f"{folder.name}_out")

        def values(e):
            return ", ".join(
                f"{k} {v['value']:.4g} {v['unit']}" for k, v in e["parameters"].items()
            )

        named = "; ".join(
            f"{e['name']} at {e['where']}: {values(e)}" for e in report["effects"]
        ) or report.get("unlike_file", "")
        error = report["error"]
        over = " to ".join(f"{error[k] / error['noise_floor']:.2g}" for k in ("before", "after"))
        took = time.monotonic() - began
        print(
            f"| {folder.name} | {world.hidden} | {told(report, world.hidden)} | {named} | {over} "
            f"| {took:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
