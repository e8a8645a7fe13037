"""Recordings of machines whose truth is known, by MuJoCo's C engine: a declared MJCF, the machine as it is, trials.

    write_world(folder, kind, seed)     kind: null, single, multi; seeds 0-999 are for tuning, from 10000 on for scoring

leaves `recording/` (what a user has), `true.xml` and `truth.json`. Nothing here shares code with the package.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from tests.generators.mechanism_draw import KINDS, draw_effect, extras_of, scales
from tests.generators.mechanism_drive import home, inertia, make_drive, servo_gains
from tests.generators.mechanism_engine import Drive, Plant, Run, simulate
from tests.generators.mechanism_forces import Effect
from tests.generators.mechanism_machines import MACHINES, Machine, draw_machine, misjudged, to_xml

SUITES = ("null", "single", "multi")


@dataclass(frozen=True)
class World:
    """q, v `[K, R, n]` and command as logged; clean_q, clean_v `[K, R, n]` as they are; declared, true: MJCF."""

    machine: Machine
    mode: str
    effects: tuple[Effect, ...]
    drive: Drive
    run: Run
    q: np.ndarray
    v: np.ndarray | None
    command: np.ndarray
    clean_q: np.ndarray
    clean_v: np.ndarray
    declared: str
    true: str
    truth: dict


def plant_of(machine: Machine, mode: str, gains: np.ndarray, effects: tuple[Effect, ...]) -> Plant:
    model = mujoco.MjModel.from_xml_string(to_xml(machine, mode, gains, extras_of(machine, effects, False), False))
    model.dof_solref[:] = [2e-3, 1.0]
    model.dof_solimp[:] = [0.99, 0.999, 1e-3, 0.5, 2.0]
    return Plant(model, mode, machine.driven, gains)


def make_world(
    kind: str, seed: int, machine: str | None = None, mode: str | None = None, effect: str | None = None
) -> World:
    """machine, mode and effect are drawn where not given. Raises ValueError for an unknown kind or effect."""
    if kind not in SUITES:
        raise ValueError(f"no kind of worlds {kind!r}; there are {', '.join(SUITES)}")
    rng = np.random.default_rng([SUITES.index(kind), seed, 44])
    drawn = (str(rng.choice(MACHINES)), str(rng.choice(["torque", "position"])), str(rng.choice(list(KINDS))))
    mode, effect = mode or drawn[1], effect or drawn[2]
    m = draw_machine(rng, machine or drawn[0])
    bare = mujoco.MjModel.from_xml_string(to_xml(m, mode, np.zeros((m.n, 2)), actuators=False))
    gains = servo_gains(rng, m, bare) if mode == "position" else np.zeros((m.n, 2))
    declared = misjudged(rng, m)
    known = mujoco.MjModel.from_xml_string(to_xml(declared, mode, gains, actuators=False))
    forked = int(rng.integers(2**31))
    for wide in (1.0, 0.75, 0.5, 0.3):
        again = np.random.default_rng(forked)
        drive = make_drive(again, m, known, mode, wide)
        pilot = simulate(plant_of(m, mode, gains, ()), drive.first(3, 600))
        effects = (
            () if kind == "null" else (draw_effect(again, m, effect, scales(pilot, inertia(bare, home(m)), gains)),)
        )
        if tame(pilot) and tame(run := simulate(plant_of(m, mode, gains, effects), drive, effects)):
            break
    else:
        raise RuntimeError(f"{kind} world {seed} of {m.name} turns over however little it is driven")
    pick = lambda z: z[drive.rows, np.arange(len(drive.rows))[:, None]]
    clean_q, clean_v = pick(run.q), pick(run.v)
    speeds = bool(again.integers(2))
    return World(
        m, mode, effects, drive, run, clean_q + drive.noise[:, :, 0], clean_v + drive.noise[:, :, 1] if speeds else None,
        run.command, clean_q, clean_v, to_xml(declared, mode, gains), to_xml(m, mode, gains, extras_of(m, effects, True)),
        _truth(kind, seed, m, mode, effects, run),
    )  # fmt: skip


def tame(run: Run) -> bool:
    """Whether nothing turns over or runs away."""
    return bool(np.all(np.isfinite(run.q)) and np.ptp(run.q, axis=0).max() < 1.8 * np.pi and np.abs(run.v).max() < 25)


def _truth(kind: str, seed: int, machine: Machine, mode: str, effects: tuple[Effect, ...], run: Run) -> dict:
    rms = lambda x: np.sqrt(np.mean(x**2, (0, 1)))
    told = []
    for e, part in zip(effects, run.parts, strict=True):
        joints = [machine.joints[j] for j in e.joints]
        share = rms(part)[list(e.joints)] / np.maximum(rms(run.u), 1e-9)[list(e.joints)]
        told.append({"name": e.name, "joints": joints, "outside": e.outside, "size": dict(zip(joints, e.params, strict=True)),
                     "share": dict(zip(joints, map(float, share), strict=True)),
                     "accept": [{"name": e.name, "joints": joints}]})  # fmt: skip
    return {
        "kind": kind,
        "seed": seed,
        "machine": machine.name,
        "mode": mode,
        "joints": machine.joints,
        "effects": told,
    }


def write_world(folder: str | Path, kind: str, seed: int, **given: str) -> Path:
    """Write `recording/`, `true.xml` and `truth.json` into `folder`; returns it. `given`: as of `make_world`."""
    w, out = make_world(kind, seed, **given), Path(folder)
    (out / "recording").mkdir(parents=True, exist_ok=True)
    (out / "recording" / "model.xml").write_text(w.declared)
    (out / "recording" / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    (out / "true.xml").write_text(w.true)
    (out / "truth.json").write_text(json.dumps(w.truth, indent=1, default=float))
    label = "tau" if w.mode == "torque" else "target"
    n, driven = w.machine.n, list(w.machine.driven)
    names = ["time", *(f"q{j + 1}" for j in range(n)), *(f"v{j + 1}" for j in range(n) if w.v is not None)]
    names += [f"{label}{j + 1}" for j in driven]
    for k, t in enumerate(w.drive.times):
        columns = [t[:, None], w.q[k], *([] if w.v is None else [w.v[k]]), w.command[k][:, driven]]
        np.savetxt(out / "recording" / f"trial_{k:02d}.csv", np.hstack(columns), fmt="%.9g", delimiter=",",
                   header=",".join(names), comments="")  # fmt: skip
    return out
