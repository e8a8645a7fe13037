"""Machines of position servos whose law is not the file's: what `diagnose` says of it.

    python experiments/servo_law_worlds.py ROBOTS OUT --seed 1 --worlds 0 1 2

ROBOTS: a folder of MJCF files. A world is a robot, how it is moved and logged, and what its servos
have that the file lacks: kp and kv at all joints, friction, a limit, a no-load speed, a late or
filtered target, gravity fed forward, a payload. MuJoCo steps the truth every 0.2 ms, with dry
friction that holds. Six worlds of 24 hide nothing. A line of JSON a world.
"""

import argparse
import json
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.closed_loop.imposed import heavier
from adaptsim_jax.simulators.closed_loop.law import Servo, ServoLaw, put_law, servos_of
from adaptsim_jax.simulators.closed_loop.recording import recording_of
from adaptsim_jax.simulators.closed_loop.whole import simulate
from experiments.robot_worlds import welded

FINE = 2e-4  # s
IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
PENDULUM = """<mujoco><option timestep="0.002"/><worldbody><body name="arm">
<joint name="servo" axis="0 1 0" armature="0.006" frictionloss="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.06"/>
<geom type="sphere" pos="0 0 -0.2" size="0.03" mass="0.25"/></body></worldbody>
<actuator><position name="servo" joint="servo" kp="30" kv="3" forcerange="-3 3"/></actuator></mujoco>"""  # noqa: E501
ARMS = {
    "lite6": "ufactory_lite6__lite6",
    "xarm7": "ufactory_xarm7__xarm7_nohand",
    "panda": "franka_emika_panda__panda_nohand",
    "ur5e": "universal_robots_ur5e__ur5e",
    "ur10e": "universal_robots_ur10e__ur10e",
    "so101": "robotstudio_so101__so101",
    "so100": "trs_so_arm100__so_arm100",
    "koch": "low_cost_robot_arm__low_cost_robot_arm",
    "rizon": "flexiv_rizon4__flexiv_rizon4",
    "fr3": "franka_fr3__fr3",
    "go1": "unitree_go1__go1",
    "g1": "unitree_g1__g1",
}
STYLES = ("smooth", "steps", "holds")
EXTRAS = ("friction", "friction", "limit", "unloaded", "delay", "filter", "lift", "payload")


@dataclass(frozen=True)
class World:
    """A robot, rows a second, how it moves, and what is hidden: factors of kp and kv, and extras
    with their sizes.
    """

    robot: str
    rate: int
    style: str
    hidden: dict = field(default_factory=dict)


def world(seed: int, number: int) -> World:
    """World `number` of 24 of a seed: every fourth hides nothing."""
    rng = np.random.default_rng([seed, number])
    robots = ["pendulum", *(r for r in ARMS if r not in ("go1", "g1"))]
    robot = robots[int(rng.integers(len(robots)))]
    rate, style = int(rng.choice([30, 50, 100])), str(rng.choice(STYLES))
    if number % 4 == 3:
        return World(robot, rate, style)
    hidden = {"kp": float(rng.uniform(0.4, 2.0)), "kv": float(rng.uniform(0.1, 0.6))}
    extra = str(rng.choice(EXTRAS))
    if robot == "pendulum" and extra in ("lift", "payload"):
        extra = "unloaded"
    sizes = {
        "friction": rng.uniform(0.1, 0.3),
        "limit": rng.uniform(0.6, 0.9),
        "unloaded": rng.uniform(1.3, 1.8),
        "delay": rng.uniform(0.01, 0.04),
        "filter": rng.uniform(0.015, 0.05),
        "lift": rng.uniform(0.6, 1.0),
        "payload": rng.uniform(0.3, 0.8),
    }
    return World(robot, rate, style, hidden | {extra: float(sizes[extra])})


@dataclass(frozen=True)
class _Names:
    """What `servos_of` reads of a log."""

    input_kind: str
    joint_names: tuple[str, ...]
    input_names: tuple[str, ...]


class _Made:
    def __init__(self, model: mujoco.MjModel):
        self.model = model


def machine(path: Path) -> tuple[mujoco.MjModel, np.ndarray, tuple[Servo, ...]]:
    """The welded robot without contact, its home pose and its servos."""
    model, pose = welded(path)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    driven = [k for k in range(model.nu) if model.actuator_trntype[k] == 0]
    tied = set(model.eq_obj1id) | set(model.eq_obj2id) if model.neq else set()
    driven = [k for k in driven if model.actuator_trnid[k, 0] not in tied]
    joints = tuple(model.joint(model.actuator_trnid[k, 0]).name for k in driven)
    inputs = tuple(model.actuator(k).name for k in driven)
    return model, pose, servos_of(_Made(model), _Names("command", joints, inputs))


def targets(rng, home, low, high, span, seconds: float, style: str):
    """t -> [n] rad: sums of sines, or moves to random poses with rests between."""
    n = len(home)
    if style == "smooth":
        phase, speed = rng.uniform(0, 6.28, (3, n)), rng.uniform(0.15, 1.2, (3, n))
        size = rng.uniform(0.2, 0.5, (3, n))

        def smooth(t):
            ramp = np.clip((t - 0.5) / 0.5, 0.0, 1.0)
            wave = (size * np.sin(2 * np.pi * speed * t + phase)).sum(0)
            return np.clip(home + ramp * span * wave, low, high)

        return smooth
    parts, t, at = [], 0.0, np.clip(home + rng.uniform(-1, 1, n) * span, low, high)
    while t < seconds:
        rest = float(rng.uniform(0.5, 1.2))
        lasts = float(rng.uniform(0.5, 1.0))
        to = np.clip(home + rng.uniform(-1, 1, n) * span, low, high)
        if style == "steps" and rng.random() < 0.7:
            lasts, to = 1e-3, at + 0.5 * (to - at)
        parts.append((t + rest, lasts, at, to))
        t, at = t + rest + lasts, to

    def moves(t):
        now = parts[0][2]
        for begin, lasts, a, b in parts:
            if t < begin:
                break
            s = np.clip((t - begin) / lasts, 0.0, 1.0)
            now = a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        return now

    return moves


def typical_force(model: mujoco.MjModel, servo: Servo, pose: np.ndarray) -> float:
    """N m that a joint takes: its weight, and a swing of 0.5 rad at 1 Hz."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    worst = 0.0
    for turn in (-0.6, 0.0, 0.6):
        data.qpos[servo.qpos] = pose[servo.qpos] + turn
        mujoco.mj_forward(model, data)
        worst = max(worst, abs(float(data.qfrc_bias[servo.dof])))
    inertia = 1.0 / max(float(model.dof_invweight0[servo.dof]), 1e-9)
    return worst + 10.0 * inertia


def truth(world: World, model, servos, pose, rng) -> tuple[list[ServoLaw], mujoco.MjModel, int]:
    """Laws by joint, the model that has them, and the body that carries a payload."""
    h, hand = world.hidden, int(model.jnt_bodyid[model.dof_jntid[servos[-1].dof]])
    laws = [s.law for s in servos]
    if h:
        rub_at = rng.choice(len(servos), min(2, len(servos)), replace=False)
        for j, s in enumerate(servos):
            force = typical_force(model, s, pose)
            kv = (s.law.damping - s.passive) * h.get("kv", 1.0)
            passive = s.passive * (h.get("kv", 1.0) if s.law.damping == s.passive else 1.0)
            new = s.law._replace(kp=s.law.kp * h.get("kp", 1.0), damping=kv + passive)
            if "friction" in h and j in rub_at:
                new = new._replace(rub=new.rub + h["friction"] * (force + 5.0 * new.rub))
            if "limit" in h:
                new = new._replace(limit=h["limit"] * force * 1.5)
            if "unloaded" in h:
                new = new._replace(limit=2.0 * force, inside=0.0)
                new = new._replace(damping=max(new.damping, new.limit / (h["unloaded"] * 4.0)))
            laws[j] = new._replace(
                delay=h.get("delay", 0.0), lag=h.get("filter", 0.0), lift=h.get("lift", s.law.lift)
            )
    real = model
    if "payload" in h:
        real = heavier(model, hand, h["payload"] * max(model.body_mass[hand], 0.05))
        laws = [
            law._replace(payload=h["payload"] * max(model.body_mass[hand], 0.05)) for law in laws
        ]
    else:
        real = heavier(model, hand, 0.0)
    for s, law in zip(servos, laws, strict=True):
        put_law(s, real, law)
    real.opt.timestep, real.opt.integrator = FINE, IMPLICIT
    return laws, real, hand


def written(folder: Path, path: Path, world: World, seed: int, seconds=10.0, trials=5) -> dict:
    """A world's folder, with its last trial in `val`; the truth."""
    model, pose, servos = machine(path)
    assert servos, path
    rng = np.random.default_rng(seed)
    laws, real, _ = truth(world, model, servos, pose, rng)
    if folder.exists():
        shutil.rmtree(folder)
    (folder / "val").mkdir(parents=True)
    meta = f'task = "mechanism"\nmodel = "{path.name}"\n'
    for where in (folder, folder / "val"):
        (where / "meta.toml").write_text(meta)
        shutil.copy(path, where / path.name)
    joint = [int(model.dof_jntid[s.dof]) for s in servos]
    low = np.array([model.jnt_range[k, 0] if model.jnt_limited[k] else -3.0 for k in joint]) + 0.1
    high = np.array([model.jnt_range[k, 1] if model.jnt_limited[k] else 3.0 for k in joint]) - 0.1
    reach = [(s.command_range if np.isfinite(s.command_range[0]) else (-9, 9)) for s in servos]
    low, high = np.maximum(low, np.array(reach)[:, 0]), np.minimum(high, np.array(reach)[:, 1])
    home = np.clip(pose[[s.qpos for s in servos]], low + 0.1, high - 0.1)
    span = np.minimum(rng.uniform(0.5, 1.0, len(home)), 0.5 * (high - low))
    step, noise = float(rng.choice([5e-4, 1e-3, 1.5e-3])), float(rng.choice([1e-4, 3e-4]))
    names = [s.name for s in servos]
    heads = ",".join(["time", *(f"q_{n}" for n in names), *(f"target_{n}" for n in names)])
    lift = laws[0].lift - servos[0].law.lift
    for k in range(trials):
        rows = recorded(
            real,
            servos,
            laws,
            targets(rng, home, low, high, span, seconds, world.style),
            (pose, world.rate, seconds, lift, model),
            (step, noise, rng),
        )
        where = folder / "val" if k == trials - 1 else folder
        np.savetxt(where / f"run_{k}.csv", rows, "%.7f", ",", header=heads, comments="")
    return {
        "laws": [law._asdict() for law in laws],
        "names": names,
        "file": [s.law._asdict() for s in servos],
    }


def recorded(real, servos, laws, target, how, sensor) -> np.ndarray:
    """Rows of a trial: time, angles as the encoders read them, targets."""
    (pose, rate, seconds, lift, plain), (quantum, noise, rng) = how, sensor
    data, bare = mujoco.MjData(real), mujoco.MjData(plain)
    data.qpos[:] = pose
    qpos, dof = [s.qpos for s in servos], [s.dof for s in servos]
    act = [s.actuator for s in servos]
    data.qpos[qpos] = target(0.0)
    u = arrived = target(0.0)
    sent: list[tuple[float, np.ndarray]] = []
    rows, row, steps = [], 0, round((seconds + 1.0) / FINE)
    share = 1.0 - np.exp(-FINE / laws[0].lag) if laws[0].lag > 0 else 1.0
    for i in range(steps):
        t = i * FINE - 1.0  # settles for a second
        if t >= -1e-9 and row < seconds * rate and t >= row / rate - 1e-9:
            read = data.qpos[qpos] + rng.normal(0.0, noise, len(qpos))
            now = target(row / rate)
            rows.append([row / rate, *(np.round(read / quantum) * quantum), *now])
            sent.append((t + laws[0].delay, now))
            row += 1
        while sent and sent[0][0] <= t + 1e-9:
            u = sent.pop(0)[1]
        arrived = arrived + share * (u - arrived)
        data.ctrl[act] = arrived
        if lift:
            bare.qpos[:], bare.qvel[:] = data.qpos, 0.0
            if i % 5 == 0:
                mujoco.mj_kinematics(plain, bare)
                mujoco.mj_comPos(plain, bare)
                mujoco.mj_comVel(plain, bare)
                force = np.zeros(plain.nv)
                mujoco.mj_rne(plain, bare, 0, force)
                data.qfrc_applied[dof] = lift * force[dof]
        mujoco.mj_step(real, data)
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--worlds", type=int, nargs="*", default=list(range(24)))
    args = parser.parse_args()
    for number in args.worlds:
        one = world(args.seed, number)
        folder = args.out / f"{number}_{one.robot}"
        file = args.robots / f"{ARMS.get(one.robot, 'pendulum')}.xml"
        if one.robot == "pendulum":
            args.out.mkdir(parents=True, exist_ok=True)
            file = args.out / "pendulum.xml"
            file.write_text(PENDULUM)
        true = written(folder, file, one, 1000 * args.seed + number)
        began = time.monotonic()
        report = diagnose(folder, out=args.out / f"{number}_out")
        row = {
            "world": number,
            "robot": one.robot,
            "rate": one.rate,
            "style": one.style,
            "hidden": one.hidden,
            "moves": moves(folder, true, one),
            **judged(report, true, one),
            "seconds": round(time.monotonic() - began),
        }
        print(json.dumps(row, default=float), flush=True)


def judged(report: dict, true: dict, world: World) -> dict:
    """What was named, what of it is wrong, and what is missing."""
    rows = {(row["name"], row["where"]): row["parameters"] for row in report["effects"]}
    wanted, wrong, missed = set(), [], []
    for name, law, file in zip(true["names"], true["laws"], true["file"], strict=True):
        for key, found in (
            (("position_gain", name), law_judged(rows, name, law, file)),
            (("coulomb", name), number_judged(rows, ("coulomb", name, "level"), law, file, "rub")),
            (
                ("saturation", name),
                number_judged(rows, ("saturation", name, "limit"), law, file, "limit"),
            ),
        ):
            if found is not None:
                wanted.add(key)
                wrong += found[0]
                needed = key[0] != "saturation" or "unloaded" in world.hidden
                missed += found[1] if needed else []
    for number, (effect, key) in SHARED.items():
        places = [at for name, at in rows if name == effect]
        place = places[0] if places else "all joints"
        at = (effect, place, key)
        found = number_judged(rows, at, true["laws"][0], true["file"][0], number)
        if found is not None:
            wanted |= {(effect, at) for at in places}
            wrong += found[0]
            missed += found[1]
    wrong += [" at ".join(key) for key in rows if key not in wanted]
    return {
        "right": not wrong and not missed,
        "wrong": wrong,
        "missed": missed,
        "verdict": report["verdict"],
        "mrad": [round(1e3 * report["error"][k], 3) for k in ("before", "after")],
        "files": report.get("files"),
    }


SHARED = {
    "delay": ("delay", "delay"),
    "lag": ("actuator_lag", "lag"),
    "payload": ("body_mass", "mass"),
    "lift": ("gravity_compensation", "share"),
}
"""Effect and parameter by number of the law."""


NUMBER_OF = {"friction": "rub", "unloaded": "limit", "filter": "lag"}
"""Number of the law by what a world hides, where it is not called so."""


def moves(folder: Path, true: dict, world: World) -> dict[str, float]:
    """By how much what is hidden beside kp and kv moves each joint that has it: RMS over whole
    trials of the truth with it and without, times the noise. Below 1 a log hardly shows it.
    """
    made = recording_of(*read_source_and_log(folder, None))
    assert made is not None
    made = made.restepped(0.25)
    laws = [ServoLaw(**law)._replace(sharp=1.0) for law in true["laws"]]
    file, out = [ServoLaw(**law) for law in true["file"]], {}
    for extra in set(world.hidden) - {"kp", "kv"}:
        number = NUMBER_OF.get(extra, extra)
        has = [j for j, law in enumerate(laws) if getattr(law, number) != getattr(file[j], number)]
        for joints in [[j] for j in has] if number == "rub" else [has]:
            plain = [
                law._replace(**{number: getattr(file[j], number)}) if j in joints else law
                for j, law in enumerate(laws)
            ]
            with_it, without = (
                np.concatenate([m.q for m in path]) for path in simulate(made, [laws, plain])
            )
            moved = np.sqrt(np.nanmean(np.square(with_it - without), 0)) / made.noise
            place = true["names"][joints[0]] if number == "rub" else "all joints"
            out[f"{extra} at {place}"] = round(float(moved.max()), 2)
    return out


def near(value: float, truth: float, share: float) -> bool:
    """Whether a value is within a share of the truth."""
    return abs(value - truth) <= share * abs(truth)


def law_judged(rows: dict, name: str, law: dict, file: dict) -> tuple[list, list] | None:
    """(wrong, missed) of kp and damping of a joint: within 15 %, their ratio within 10 % where only
    that is claimed, what alone is said to show where one of them is said not to; None where both
    are the file's.
    """
    ratio, before = law["damping"] / law["kp"], file["damping"] / file["kp"]
    if near(law["kp"], file["kp"], 0.02) and near(ratio, before, 0.02):
        return None
    got = rows.get(("position_gain", name))
    if got is None:
        small = near(law["kp"], file["kp"], 0.15) and near(ratio, before, 0.1)
        return [], [] if small else [f"law of {name}"]
    if "damping_over_kp" not in got:
        said = [k for k in ("kp", "damping") if "do not show" not in got[k].get("meaning", "")]
        far = [k for k in said if not near(got[k]["value"], law[k], 0.15)]
        return [f"{name} {k} {got[k]['value']:.4g} for {law[k]:.4g}" for k in far], []
    claimed = got["damping_over_kp"]["value"]
    if not near(claimed, ratio, 0.1):
        return [f"{name} damping over kp {claimed:.3g} for {ratio:.3g}"], []
    if "Only ratios" not in got["kp"]["meaning"] and not near(got["kp"]["value"], law["kp"], 0.15):
        return [f"{name} kp {got['kp']['value']:.4g} for {law['kp']:.4g}"], []
    return [], []


def number_judged(
    rows: dict, at: tuple[str, str, str], law: dict, file: dict, number: str
) -> tuple[list, list] | None:
    """(wrong, missed) of another number of a law, at (effect, place, parameter): within 25 %; None
    where it is the file's.
    """
    effect, place, key = at
    if abs(law[number] - file[number]) < 1e-9:
        return None
    got = rows.get((effect, place))
    if got is None:
        return [], [f"{effect} at {place}"]
    if not near(got[key]["value"], law[number], 0.25):
        return [f"{effect} at {place} {got[key]['value']:.3g} for {law[number]:.3g}"], []
    return [], []


if __name__ == "__main__":
    main()
