"""Position servos whose gains are not those of the model file: found along the measured motion, put
into the machine, told.

A file's kp of 1,000 N m/rad where the machine has 10 leaves a declared model that no search
recovers from: every other effect is judged
about it. So the gains come first, as the torque of a volt does of a drive whose constant nobody
wrote down.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, entries_of
from adaptsim_jax.attribution.criteria import PRIOR_WIDTH, SERVO
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.commands import Servo, servos
from adaptsim_jax.attribution.forecast import without_a_model
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem, own_inertia, prepare, scaled_reach
from adaptsim_jax.effects.joints.actuator import POSITION_GAIN
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.friction import COULOMB, VISCOUS

SPANS = (0.5, 1.0, 2.0, 4.0)  # s
RUBS, GAIN = COULOMB.name, POSITION_GAIN.name


def calibrated(machine: Machine, horizon: float) -> tuple[Machine, tuple[Servo, ...]]:
    """With the gains of its position servos as the motion shows them, where they are far from the
    file's; and these servos.
    """
    if not np.any(machine.actuator[2] != 0.0) or machine.tree.linear:
        return machine, ()
    problem = replace(machine, ties=None).problem(MACHINE, horizon)
    found = [
        s for b in balances(problem, machine.tracks, trusted=False) for s in servos(problem, b)
    ]
    file = {s.joint: -machine.actuator[2, s.joint] * machine.gear[s.joint] ** 2 for s in found}

    def distance(s):
        return s.separation > SERVO.significant and not _near(s.kp / file[s.joint])

    off = [
        s
        for s in found
        if s.p < SERVO.level
        and SERVO.missed * s.error < s.file
        and s.left < SERVO.better * s.file
        and distance(s)
    ]
    return with_gains(machine, off), tuple(off)


def _near(times: float) -> bool:
    """Whether a gain is so near to the file's, of which it is `times`, that the search tells it as
    any other effect.
    """
    return 1 / SERVO.gain_factor < times < SERVO.gain_factor


def with_gains(machine: Machine, off: Sequence[Servo]) -> Machine:
    """With the gains of `off`."""
    if not off:
        return machine
    law = machine.actuator.copy()
    damping = np.array(machine.declared.get((VISCOUS.name, "damping"), machine.tree.damping), float)
    times = {s.joint: float(s.kp / (-law[2, s.joint] * machine.gear[s.joint] ** 2)) for s in off}
    for s in off:
        law[:3, s.joint] *= times[s.joint]
        law[3, s.joint] = 0.0  # what damps is one with the joint's own friction
        damping[s.joint] = s.damping
    declared = machine.declared | {(VISCOUS.name, "damping"): damping}
    return replace(machine, actuator=law, declared=declared, servo_times=times)


def still_off(machine: Machine, off: tuple[Servo, ...], final: Vector) -> tuple[Servo, ...]:
    """Those of `off` whose gains the whole fit leaves far from the file's. A regression of command
    errors can be misled (by a payload, for one), and a gain that the fit brings back is the file's.
    """
    left = {
        e.joints[0]: 1.0 + float(z)
        for e, z in zip(final.entries, final.values, strict=True)
        if e.owner == GAIN
    }
    return tuple(s for s in off if not _near(machine.servo_times[s.joint] * left.get(s.joint, 1.0)))


def span_of(machine: Machine, off: tuple[Servo, ...], horizon: float) -> float:
    """Length of stretches [s] over which a machine that follows commands is judged: the shortest
    over which a straight line leaves more than
    what the regression of its command errors left.
    """
    left = np.median([s.left for s in off])
    for span in SPANS:
        if span < horizon:
            continue
        longest = min(float(t.time[-1] - t.time[0]) for t in machine.tracks)
        if span > 0.5 * longest:
            break
        problem = prepare(machine.tree, machine.tracks, (), machine.actuator, machine.gear, span)
        horizon = span
        if np.median(np.median(without_a_model(problem)[0], 0)) > 2.0 * left:
            break
    return horizon


def servo_entries(off: tuple[Servo, ...]) -> list[Entry]:
    """What is fitted of such gains whatever is named."""
    return [
        Entry(GAIN, "gain", (s.joint,), 0.0, 0.0, -0.9, 9.0, "1", PRIOR_WIDTH.servo_gain)
        for s in off
    ]


def friction_first(
    problem: TreeProblem, null: Vector, off: tuple[Servo, ...]
) -> tuple[Vector, tuple[JointCandidate, ...]]:
    """Values and effects from which a search goes on where servos have gains of their own: dry
    friction as the command errors show it, at each of them. Geared servos rub, and without it no
    gain is right.
    """
    if not problem.offers(RUBS):
        return null, ()
    reach = scaled_reach(problem, *own_inertia(problem, null))
    joints = tuple(s.joint for s in off)
    entries = entries_of(problem, reach, problem.effect(RUBS), joints, False)
    levels = [float(np.clip(s.coulomb, e.low, e.high)) for s, e in zip(off, entries, strict=True)]
    rubs = JointCandidate(RUBS, joints, "all" if len(joints) > 1 else "joint", entries)
    return null.with_entries(entries, levels), (rubs,)


def servo_rows(
    machine: Machine, declared: Machine, off: tuple[Servo, ...], final: Vector, half: np.ndarray
) -> list[dict[str, Any]]:
    """Rows of the report's effects: kp as fitted, with its interval, beside the file's. half [P]:
    of the 90 % intervals of the final vector.
    """
    rows = []
    at = {e.joints[0]: i for i, e in enumerate(final.entries) if e.owner == GAIN}
    for s in off:
        name = machine.tree.joint_names[s.joint]
        if s.joint in at:
            gain, wide = (float(final.values[at[s.joint]]), float(half[at[s.joint]]))
        else:
            gain, wide = (0.0, 0.0)
        kp = -machine.actuator[2, s.joint] * machine.gear[s.joint] ** 2
        file = -declared.actuator[2, s.joint] * declared.gear[s.joint] ** 2
        ends = {
            "value": kp * (1 + gain),
            "low": kp * max(1 + gain - wide, 0.0),
            "high": kp * (1 + gain + wide),
        }
        text = f"the position controller's stiffness; the file says {file:.4g}"
        if not s.scale:
            text += (
                ". Only ratios to it are fixed by these data: no weight or inertia gives the "
                "scale at this joint"
            )
        stiffness = ends | {"unit": _unit(machine, s.joint), "meaning": text}
        rows.append(
            {
                "name": GAIN,
                "where": name,
                "joints": [name],
                "parameters": {"kp": stiffness},
                "physics": "the stiffness of the position controller is not the file's",
                "alternatives": [],
                "held_out_gain": 1.0 - (s.left / s.file) ** 2,
                "p_value": s.p,
            }
        )
    return rows


def damped_by_file(
    rows: dict[str, dict[str, Any]], declared: Machine, off: Sequence[Servo]
) -> None:
    """Put kv of the file to the damping that rows of fitted ones have beside them: of servos with
    gains of their own both are one.
    """
    for s in off:
        kv = -declared.actuator[3, s.joint] * declared.gear[s.joint] ** 2
        if row := rows.get(f"damping of {declared.tree.joint_names[s.joint]}"):
            row["file"] += float(kv)


def _unit(machine: Machine, joint: int) -> str:
    if machine.tree.kinds[joint] == "slide":
        return "N/m"
    return "N m/rad"


def servo_notes(machine: Machine, declared: Machine, off: tuple[Servo, ...]) -> list[str]:
    """A line on gains that are not the file's."""
    if not off:
        return []

    def kp(m, j):
        return -m.actuator[2, j] * m.gear[j] ** 2

    each = []
    for s in off:
        j, doubt = s.joint, "" if s.scale else "; only a ratio is told"
        each.append(
            f"{machine.tree.joint_names[j]} {kp(machine, j):.3g} {_unit(machine, j)} "
            f"(file {kp(declared, j):.4g}{doubt})"
        )
    return [
        f"kp by the command error along the motion, before the fit: {', '.join(each)}. kv of the "
        "file is in the joints' damping."
    ]
