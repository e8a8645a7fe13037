"""Recordings of machines whose truth is known, by MuJoCo's C engine: a declared MJCF, the machine
as it is, trials.

    # one world (kind, seed), to look at
    python -m tests.generators.mechanism_worlds single 3 FOLDER

`write_world` leaves `recording/` (what a user has), `true.xml` (the machine, with what MJCF can
hold of the effects) and `truth.json`. Kinds: `null`; `single`, one effect; `multi`, 3 to 5 of which
one is in no catalogue. Seeds 0-999 are for tuning, from 10000 on for scoring. Nothing here shares
code with the package.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from tests.generators.mechanism_draw import (
    ABSORBED,
    Plan,
    draw_effects,
    extras_of,
    owners,
    plan,
    scales,
    tilted,
)
from tests.generators.mechanism_drive import home, inertia, make_drive, servo_gains
from tests.generators.mechanism_engine import Drive, Plant, Run, simulate
from tests.generators.mechanism_forces import Effect
from tests.generators.mechanism_log import logged_command, readings
from tests.generators.mechanism_machines import MACHINES, Machine, draw_machine, misjudged
from tests.generators.mechanism_mjcf import to_xml
from tests.generators.mechanism_seen import SEEN, Sight

SUITES = ("null", "single", "multi")


@dataclass(frozen=True)
class World:
    """q, v `[K, R, n]` and command as logged (v None: no speeds); clean_q, clean_v `[K, R, n]` as
    they are; declared, true: MJCF.
    """

    machine: Machine
    mode: str
    effects: tuple[Effect, ...]
    drive: Drive
    q: np.ndarray
    v: np.ndarray | None
    command: np.ndarray
    clean_q: np.ndarray
    clean_v: np.ndarray
    declared: str
    true: str
    truth: dict


def plant_of(machine: Machine, mode: str, gains: np.ndarray, effects: tuple[Effect, ...]) -> Plant:
    """The true machine; its actuators and most effects are left to `simulate`."""
    model = mujoco.MjModel.from_xml_string(
        to_xml(machine, mode, gains, extras_of(machine, effects, False), False)
    )
    model.dof_solref[:] = [2e-3, 1.0]
    model.dof_solimp[:] = [0.99, 0.999, 1e-3, 0.5, 2.0]
    at = np.array([model.joint(name).dofadr[0] for name in machine.joints])
    bent = [j for e in effects if e.name in ("drive_elasticity", "drive_play") for j in e.joints]
    return Plant(
        model,
        mode,
        machine.driven,
        gains,
        at,
        {j: int(model.joint(f"twist_{machine.joints[j]}").dofadr[0]) for j in bent},
    )


def with_rotors(rng: np.random.Generator, machine: Machine, plans: list[Plan]) -> Machine:
    """A drive with a spring behind it has a rotor, which is declared."""
    links = list(machine.links)
    own = inertia(
        mujoco.MjModel.from_xml_string(
            to_xml(machine, "torque", np.zeros((machine.n, 2)), actuators=False)
        ),
        home(machine),
    )
    for kind, joints in plans:
        for j in joints:
            if kind in ("drive_elasticity", "drive_play"):
                links[j] = replace(
                    links[j], armature=links[j].armature + float(rng.uniform(0.3, 0.8) * own[j])
                )
    return replace(machine, links=tuple(links))


def tame(run: Run) -> bool:
    """Whether nothing turns over or runs away."""
    return bool(
        np.all(np.isfinite(run.q))
        and np.ptp(run.q, axis=0).max() < 1.8 * np.pi
        and np.abs(run.v).max() < 25
    )


def make_world(
    kind: str,
    seed: int,
    machine: str | None = None,
    mode: str | None = None,
    effect: str | None = None,
) -> World:
    """machine, mode and effect (of a single) are drawn where not given. A world whose effects are
    too small to see is drawn again with larger ones, one that turns over with smaller motion.
    Raises ValueError for an unknown kind or effect.
    """
    if kind not in SUITES:
        raise ValueError(f"no kind of worlds {kind!r}; there are {', '.join(SUITES)}")
    rng = np.random.default_rng([SUITES.index(kind), seed, 44])
    drawn = str(rng.choice(MACHINES)), str(rng.choice(["torque", "position"]))
    mode = mode or drawn[1]
    m = draw_machine(rng, machine or drawn[0])
    plans = plan(rng, m, mode, kind, effect)
    m = with_rotors(rng, m, plans)
    zero = np.zeros((m.n, 2))
    bare = mujoco.MjModel.from_xml_string(to_xml(m, mode, zero, actuators=False))
    own, gains = inertia(bare, home(m)), servo_gains(rng, m, bare) if mode == "position" else zero
    declared = misjudged(rng, m)
    known = mujoco.MjModel.from_xml_string(to_xml(declared, mode, gains, actuators=False))
    again = int(rng.integers(2**31))
    wide, factors = 1.0, [1.0] * len(plans)
    for _ in range(6):
        fork = np.random.default_rng(again)
        drive = make_drive(fork, m, known, mode, wide)
        pilot = simulate(plant_of(m, mode, gains, ()), drive.first(3, 400))
        effects = draw_effects(fork, m, plans, scales(pilot, own, gains), factors)
        plant = plant_of(m, mode, gains, effects)
        if not tame(pilot) or not tame(run := simulate(plant, drive, effects)):
            wide *= 0.7
            continue
        sight = Sight(m, plant, drive, run, effects, tilted(effects), own)
        told = [_told(m, sight, k) for k in range(len(effects))]
        small = {i for i, e in zip(owners(plans), told, strict=True) if _too_small(e)}
        if not small or max(factors) > 2.5:
            break
        factors = [1.7 * f if i in small else f for i, f in enumerate(factors)]
    else:
        raise RuntimeError(
            f"{kind} world {seed} of {m.name} turns over however little it is driven"
        )
    truth = {
        "kind": kind,
        "seed": seed,
        "machine": m.name,
        "mode": mode,
        "joints": m.joints,
        "effects": told,
    }
    lane = np.arange(len(drive.rows))[:, None]
    q, v = (z[drive.rows, lane] for z in readings(run, effects))
    speeds = bool(np.random.default_rng([seed, 45]).integers(2))
    return World(
        m,
        mode,
        effects,
        drive,
        q + drive.noise[:, :, 0],
        v + drive.noise[:, :, 1] if speeds else None,
        logged_command(run, drive, effects),
        run.q[drive.rows, lane],
        run.v[drive.rows, lane],
        to_xml(declared, mode, gains),
        to_xml(m, mode, gains, extras_of(m, effects, True)),
        truth,
    )


def _too_small(told: dict) -> bool:
    """Whether nobody need name it only because there is so little of it."""
    seen, share = (sum(told[k].values()) for k in ("seen", "share"))
    return (
        not told["outside"]
        and bool(told["seen"])
        and seen > 0.05 * share
        and max(told["seen"].values()) < SEEN
    )


def _told(machine: Machine, sight: Sight, k: int) -> dict:
    """What `truth.json` says of an effect. accept: names that are right, with the joints where each
    must be told; also_right: names that are not wrong; absorbed: nothing need be told, since
    inertias and damping do the same.
    """
    e = sight.effects[k]
    names = [machine.joints[j] for j in e.joints]
    sizes = (
        dict(zip(names, e.params, strict=True))
        if len(names) == len(e.params)
        else {"+".join(names) or "base": e.params[0]}
    )
    told = {"name": e.name, "joints": names, "outside": e.outside, "size": sizes} | sight.judge(k)
    if e.name in ABSORBED:
        told["absorbed"] = True
    if e.name in (
        "backlash",
        "drive_elasticity",
        "drive_play",
    ):  # a kink of the kinematics, not a torque
        told |= {"absorbed": False, "share": {}, "seen": {}}
    return told


def write_world(folder: str | Path, kind: str, seed: int, **given: str) -> Path:
    """Write `recording/`, `true.xml` and `truth.json` into `folder`; returns it. `given`: as of
    `make_world`.
    """
    w, out = make_world(kind, seed, **given), Path(folder)
    (out / "recording").mkdir(parents=True, exist_ok=True)
    (out / "recording" / "model.xml").write_text(w.declared)
    (out / "recording" / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    (out / "true.xml").write_text(w.true)
    (out / "truth.json").write_text(json.dumps(w.truth, indent=1, default=float))
    label = "tau" if w.mode == "torque" else "target"
    n, driven = w.machine.n, list(w.machine.driven)
    names = [
        "time",
        *(f"q{j + 1}" for j in range(n)),
        *(f"v{j + 1}" for j in range(n) if w.v is not None),
    ]
    names += [f"{label}{j + 1}" for j in driven]
    for k, t in enumerate(w.drive.times):
        columns = [t[:, None], w.q[k], *([] if w.v is None else [w.v[k]]), w.command[k][:, driven]]
        np.savetxt(
            out / "recording" / f"trial_{k:02d}.csv",
            np.hstack(columns),
            fmt="%.9g",
            delimiter=",",
            header=",".join(names),
            comments="",
        )
    return out


if __name__ == "__main__":
    print(write_world(sys.argv[3], sys.argv[1], int(sys.argv[2])) / "truth.json")
