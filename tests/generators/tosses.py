"""Worlds of tosses: poses that motion capture would record of a cube on a table, with or without an
effect.

Shares no code with the package. MuJoCo steps one toss after the other at 0.5 ms, half of what the
written model declares; what depends on the motion is set at each step from the contacts that are
there.

    # a folder for each world
    python -m tests.generators.tosses --suite singles --seed 1 --count 14 --out worlds/
"""

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np

STEP, RATE, HALF, MASS = 5e-4, 148.0, 0.05, 0.4
NOISE, NOISE_TURN = 1e-4, 1e-3  # m, rad
XML = """<mujoco>
  <option timestep="{step}" cone="elliptic" impratio="10" gravity="0 0 -9.81"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="cube"><freejoint/>
      <inertial pos="{centre}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
      <geom type="box" size="{half} {half} {half}" friction="{friction} 0 0" solref="{time} {damping}"/>
    </body>
  </worldbody>
</mujoco>
"""  # noqa: E501
SIZES = {
    "speed_friction": (0.4, 0.8),
    "grain": (0.3, 0.5),
    "restitution": (0.5, 1.0),
    "body_size": (0.02, 0.04),
    "inertia": (0.15, 0.3),
    "centre_of_mass": (0.002, 0.004),
    "drag": (0.3, 0.8),
    "tilt": (0.02, 0.04),
    "length_scale": (0.015, 0.04),
    "clock_scale": (0.015, 0.04),
    "plane_height": (0.0015, 0.003),
    "plane_turn": (0.01, 0.03),
    "body_offset": (0.002, 0.004),
    "body_turn": (0.02, 0.05),
}


def xml(
    step, friction, time, damping, inertia=MASS * (2 * HALF) ** 2 / 6, half=HALF, centre="0 0 0"
):
    return XML.format(
        step=step,
        mass=MASS,
        inertia=inertia,
        half=half,
        friction=friction,
        time=time,
        damping=damping,
        centre=centre,
    )


def rotation(v):
    """Quaternion of the turn by |v| about v."""
    q = np.zeros(4)
    angle = np.linalg.norm(v)
    mujoco.mju_axisAngle2Quat(q, np.asarray(v, float) / max(angle, 1e-12), angle)
    return q


def product(a, b):
    out = np.zeros(4)
    mujoco.mju_mulQuat(out, a, b)
    return out


def turned(q, v):
    out = np.zeros(3)
    mujoco.mju_rotVecQuat(out, np.asarray(v, float), q)
    return out


def slips(model, data):
    """Velocity `[2]` m/s in the plane of the contacts' mean, and the fastest approach m/s; None
    where nothing touches.
    """
    if not data.ncon:
        return None
    points = np.array([data.contact[i].pos for i in range(data.ncon)])
    spin = turned(data.qpos[3:7], data.qvel[3:6])
    speed = data.qvel[:3] + np.cross(spin, points - data.qpos[:3])
    return speed[:, :2].mean(0), float(max(-speed[:, 2].min(), 0.0))


def toss(model, start, seconds, truth, effect):
    """Poses `[N, 7]` every `STEP` of one toss; effect: its size(s) by name."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[:7], start[7:]
    rows, touched = [data.qpos.copy()], False
    drag = effect.get("drag", 0.0)
    special = {"speed_friction", "grain", "restitution"} & set(effect)
    for _ in range(int(seconds / STEP)):
        if drag:
            data.xfrc_applied[1, :3] = -MASS * drag * data.qvel[:3]
        seen = slips(model, data) if special else None
        if seen is not None:
            speed, angle = np.linalg.norm(seen[0]), np.arctan2(seen[0][1], seen[0][0])
            friction = truth["friction"] * (1 + effect.get("speed_friction", 0.0) * speed)
            size, along = effect.get("grain", (0.0, 0.0))
            model.geom_friction[1, 0] = friction * (1 + size * np.cos(2 * (angle - along)))
            if not touched:
                hard = max(seen[1], 0.1)
                model.geom_solref[1, 1] = truth["damping"] * (hard / 0.7) ** effect.get(
                    "restitution", 0.0
                )
        touched = seen is not None
        mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows)


def drawn(rng, name):
    """An effect's size, of either sign where it has one."""
    low, high = SIZES[name]
    size = rng.uniform(low, high)
    if name in ("tilt", "plane_turn"):
        angle = rng.uniform(0, 2 * np.pi)
        return (size * np.cos(angle), size * np.sin(angle))
    if name in ("centre_of_mass", "body_offset", "body_turn"):
        way = rng.normal(size=3)
        return tuple(size * way / np.linalg.norm(way))
    if name == "grain":
        return (size, rng.uniform(0, np.pi))
    return size if name == "drag" else size * rng.choice([-1.0, 1.0])


def world(seed, name=None, tosses=20, seconds=0.75, effect=None, height=(0.14, 0.24)):
    """truth, and poses as recorded: a list of `[R, 8]` (time, place, quaternion w first)."""
    rng = np.random.default_rng(seed)
    truth = {
        "friction": rng.uniform(0.12, 0.4),
        "time": rng.uniform(0.003, 0.006),
        "damping": rng.uniform(0.3, 0.9),
    }
    effect = {} if name is None else {name: drawn(rng, name) if effect is None else effect}

    def get(key, least=0.0):
        return effect.get(key, least)

    inertia = MASS * (2 * HALF) ** 2 / 6 * (1 + get("inertia"))
    centre = " ".join(f"{z:.9f}" for z in get("centre_of_mass", np.zeros(3)))
    contact = truth["friction"], truth["time"], truth["damping"]
    model = mujoco.MjModel.from_xml_string(
        xml(STEP, *contact, inertia, HALF * (1 + get("body_size")), centre)
    )
    model.geom_priority[1] = 1
    x, y = np.sin(get("tilt", (0.0, 0.0)))
    model.opt.gravity[:] = 9.81 * np.array([x, y, -np.sqrt(1 - x * x - y * y)])
    frame, axes = (
        rotation([*get("plane_turn", (0.0, 0.0)), 0.0]),
        rotation(get("body_turn", np.zeros(3))),
    )
    off, recorded = np.asarray(get("body_offset", np.zeros(3))), []
    for _ in range(tosses):
        q = rng.normal(size=4)
        way = rng.uniform(0, 2 * np.pi)
        speed = rng.uniform(0.5, 1.5)
        start = np.concatenate(
            [
                [rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(*height)],
                q / np.linalg.norm(q),
                [speed * np.cos(way), speed * np.sin(way), rng.uniform(-0.5, 0.5)],
                rng.normal(scale=3.0, size=3),
            ]
        )
        rows = toss(model, start, seconds * 1.06, truth, effect)
        time = np.arange(int(rng.uniform(0.85, 1.0) * seconds * RATE)) / RATE
        time = time[(rng.random(len(time)) > 0.02) | (time == 0)]
        at = (1 + get("clock_scale")) * time / STEP
        k, u = np.floor(at).astype(int), (at % 1)[:, None]
        mixed = (1 - u) * rows[k] + u * rows[k + 1]
        out = []
        for t, row in zip(time, mixed, strict=True):
            turn = row[3:] / np.linalg.norm(row[3:])
            place = (1 + get("length_scale")) * turned(frame, row[:3] + turned(turn, off))
            place[2] += get("plane_height")
            seen = product(
                product(product(frame, turn), axes), rotation(rng.normal(scale=NOISE_TURN, size=3))
            )
            out.append([t, *(place + rng.normal(scale=NOISE, size=3)), *seen])
        recorded.append(np.array(out))
    return {"kind": name or "null", "effect": effect, **truth}, recorded


def written(folder, truth, recorded, declared=None):
    """A world's folder; declared: keywords of `xml` other than what is usual."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.toml").write_text('task = "toss"\nmodel = "cube.xml"\n')
    (folder / "cube.xml").write_text(
        xml(**{"step": 1e-3, "friction": 0.25, "time": 0.004, "damping": 0.5} | (declared or {}))
    )
    for i, rows in enumerate(recorded, 1):
        lines = [",".join(f"{z:.7g}" for z in row) for row in rows]
        (folder / f"toss_{i:02d}.csv").write_text("\n".join(["time,x,y,z,qw,qx,qy,qz", *lines, ""]))
    (folder / "truth.json").write_text(json.dumps(truth, default=float))
    return folder


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--suite", choices=("nulls", "singles"), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=len(SIZES))
    parser.add_argument("--tosses", type=int, default=20)
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    for i in range(args.count):
        name = None if args.suite == "nulls" else list(SIZES)[i % len(SIZES)]
        written(
            Path(args.out) / f"{i:02d}_{name or 'null'}", *world((args.seed, i), name, args.tosses)
        )


if __name__ == "__main__":
    main()
