"""`mujoco.sysid` and our fit on one real rig, side by side: the same stretches, start, parameters
and held-out data.

    PYTHON benchmarks/mujoco_sysid_rig.py [RIG]     rig_c of
    ../shared/data/measured_double_pendulum, or ADAPTSIM_DATA's PYTHON
    benchmarks/mujoco_sysid_rig.py leg       the quadruped's front left leg, position commands

PYTHON has this package and `mujoco[sysid]`. Fitted: viscous and dry friction at each joint
(`damping`, `frictionloss`), of a rig also mass, centre and moment of each link, on all trials but
the last three (of the leg: on `train.csv`). Scored on these (`validation.csv`) by the error of
`adaptsim replay` (0.5 s). Prints JSON: seconds (ours once compiled; `compile`: of the first call),
median errors (rad) declared and fitted.
"""

import json
import os
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid

from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import machine as joined
from adaptsim_jax.attribution.parameters import Entry
from adaptsim_jax.attribution.pendulum import declared_machine, in_the_plane
from adaptsim_jax.attribution.pendulum_diagnosis import first_parameters
from adaptsim_jax.attribution.problem import nuisances, prepare
from adaptsim_jax.attribution.replay import replay
from adaptsim_jax.diagnosis import read_pendulum
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.mechanisms.mjcf import read_mechanism

DATA = Path(os.environ.get("ADAPTSIM_DATA", Path(__file__).parents[2] / "shared" / "data"))
LEFT_OUT, HORIZON, STEP = 3, 0.5, 0.002


def ours(machine, nuisance: Callable) -> tuple[dict, object]:
    problem = prepare(
        machine.tree, machine.tracks, MACHINE, machine.actuator, machine.gear, HORIZON
    )
    rubbing = [
        Entry("coulomb", "level", (j,), 0.05, 0.0, 0.0, 2.0, "N m") for j in range(problem.joints)
    ]
    vector = nuisance(problem).with_entries(rubbing)
    took = []
    for _ in range(2):
        began = time.perf_counter()
        found = fit(problem, vector, rounds=15)
        took.append(time.perf_counter() - began)
    return {
        "seconds": took[1],
        "compile": took[0] - took[1],
        "rounds": found.rounds,
        "code": found.code,
    }, found.vector


def peers(machine, xml: str, links: bool) -> tuple[dict, str]:
    """What `mujoco.sysid` finds, and the MJCF with it. links: whether their inertias are fitted."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.option.timestep = STEP
    joints = machine.tree.joint_names
    n = len(joints)
    for name in joints:
        spec.add_sensor(
            name=f"{name}_angle",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    model = spec.compile()
    s = (
        prepare(machine.tree, machine.tracks, MACHINE, machine.actuator, machine.gear, HORIZON)
        .groups[0]
        .stretches
    )
    starts, controls, seen, names = [], [], [], []
    for k in range(s.count):
        if not s.seen[..., k].any():
            continue
        t = s.time[:, k] - s.time[0, k]
        keep = np.r_[True, np.diff(t) > 0]
        command = s.command[s.past : s.past + len(t), :, k]
        starts.append(sysid.create_initial_state(model, s.start[:n, k], s.start[n:, k], None))
        controls.append(sysid.TimeSeries(t[keep], command[keep]))
        seen.append(sysid.TimeSeries.from_names(t[keep], s.q[keep, :, k], model))
        names.append(f"stretch{k}")
    params = sysid.ParameterDict()

    def add(name, nominal, low, high, change):
        params.add(
            sysid.Parameter(
                name, nominal, low, high, modifier=lambda spec, p: change(spec, float(p.value[0]))
            )
        )

    for k in (1, 2) if links else ():
        body = spec.body(f"link{k}")
        centre, moment = float(body.ipos[2]), float(body.inertia[1])
        add(
            f"mass{k}",
            float(body.mass),
            0.02,
            5.0,
            lambda s, v, k=k: setattr(s.body(f"link{k}"), "mass", v),
        )
        add(
            f"centre{k}",
            centre,
            -0.6,
            0.6,
            lambda s, v, k=k: s.body(f"link{k}").ipos.__setitem__(2, v),
        )
        add(
            f"moment{k}",
            moment,
            1e-5,
            0.1,
            lambda s, v, k=k: setattr(s.body(f"link{k}"), "inertia", [v, v, v]),
        )
    for name in joints:
        damping = float(np.ravel(spec.joint(name).damping)[0])
        add(
            f"{name} damping",
            damping,
            0.0,
            2.0,
            lambda s, v, j=name: s.joint(j).damping.__setitem__(0, v),
        )
        add(
            f"{name} dry",
            0.05,
            0.0,
            2.0,
            lambda s, v, j=name: setattr(s.joint(j), "frictionloss", v),
        )
    began = time.perf_counter()
    sequences = sysid.ModelSequences("rig", spec, names, starts, controls, seen)
    found, result = sysid.optimize(
        initial_params=params,
        residual_fn=sysid.build_residual_fn(models_sequences=[sequences]),
        optimizer="mujoco",
        verbose=False,
    )
    seconds = time.perf_counter() - began
    for p in found.parameters.values():
        p.modifier(spec, p)
    values = {name: float(found[name].value[0]) for name in params.keys()}
    return {
        "seconds": seconds,
        "stretches": len(names),
        "values": values,
        "says": str(getattr(result, "message", "")),
    }, spec.to_xml()


def main(rig: str) -> None:
    whole = read_pendulum(DATA / "measured_double_pendulum" / rig)
    names = [t.name for t in whole.trials]
    train = whole.pick(names[:-LEFT_OUT])
    train = usable(train, audit(train))
    theta = first_parameters(train)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "declared.xml"
        machine = declared_machine(train, theta, path)
        rest = whole.pick(names[-LEFT_OUT:])
        test = declared_machine(usable(rest, audit(rest)), theta, Path(folder) / "test.xml")
        compare(rig, machine, test, path, lambda problem: in_the_plane(nuisances(problem)), True)


def leg() -> None:
    """One leg by itself: through the fixed base legs do not touch."""
    source = DATA / "measured_quadruped_legs"
    tree = ElementTree.parse(source / "model.xml")
    for parent in tree.iter():
        for child in list(parent):
            name = child.get("name", "")
            if child.tag in ("body", "position") and name[:2] in ("FR", "RL", "RR"):
                parent.remove(child)
    keep = ("time", *(f"{stem}{j}" for stem in ("q", "target") for j in (1, 2, 3)))
    with tempfile.TemporaryDirectory() as folder:
        parts = []
        for part in ("train", "validation"):
            at = Path(folder) / part
            at.mkdir()
            tree.write(at / "model.xml")
            (at / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
            rows = np.genfromtxt(source / f"{part}.csv", delimiter=",", names=True)
            table = np.stack([rows[name] for name in keep], 1)
            np.savetxt(
                at / "log.csv", table, delimiter=",", header=",".join(keep), comments="", fmt="%.9g"
            )
            parts.append(load(at))

        def fixed(problem):
            return nuisances(problem, inertia=False)

        compare("leg", *parts, Path(folder) / "train" / "model.xml", fixed, False)


def compare(rig: str, machine, test, path: Path, nuisance: Callable, links: bool) -> None:
    def error(machine, vector=None):
        return float(np.median(replay(machine, HORIZON, vector).error))

    mine, vector = ours(machine, nuisance)
    theirs, xml = peers(machine, path.read_text(), links)
    path.with_name("theirs.xml").write_text(xml)
    mended = joined(read_mechanism(path.with_name("theirs.xml")), test.log)
    print(
        json.dumps(
            {
                "rig": rig,
                "declared": error(test),
                "ours": mine | {"error": error(test, vector)},
                "mujoco_sysid": theirs | {"error": error(mended)},
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    leg() if sys.argv[1:] == ["leg"] else main(*(sys.argv[1:] or ["rig_c"]))
