"""Conventions of a mechanism's log told from data, by `logs.quality.contradictions`: the torque by
unit of each body's inertia.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import jax
import numpy as np

from adaptsim_jax.attribution.command_checks import check_commands
from adaptsim_jax.attribution.criteria import CONVENTION
from adaptsim_jax.attribution.machine import Machine, actuator_of
from adaptsim_jax.attribution.pace import amperes, check_pace, held_fast
from adaptsim_jax.attribution.problem import drive_force
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import BLOCK, CONTRADICTION
from adaptsim_jax.logs.quality.audit import audit
from adaptsim_jax.logs.quality.contradictions import (
    AS_DECLARED,
    Words,
    contradiction,
    late_finding,
    lateness,
    other_sides,
)
from adaptsim_jax.logs.quality.findings import Audit, AuditFinding
from adaptsim_jax.logs.quality.hypotheses import (
    BlockMeans,
    Design,
    Hypothesis,
    Track,
    linear_fit,
    motion_of,
)
from adaptsim_jax.logs.quality.order import check_order
from adaptsim_jax.logs.quality.trials_differ import TrialDifferences, trials_differ
from adaptsim_jax.mechanisms.dynamics import compensation
from adaptsim_jax.mechanisms.equations import regressor
from adaptsim_jax.mechanisms.tree import Tree

FACTORS = {1e-3: "millimetres", 1e-2: "centimetres", 1e-1: None, 10.0: None, 1e3: "kilometres"}
UNITS = {1e-3: "masses in grams, or torques in kN m", 1e3: "masses in tonnes, or torques in mN m"}
ANGLES = (
    (180.0 / np.pi, "radians, not degrees", "rad"),
    (np.pi / 180.0, "degrees, not radians", "deg"),
)


def of_machine(machine: Machine) -> tuple[list[Track], Design] | None:
    """Tracks with torques at the joints, and the design of the declared tree; None where a
    regression of torque cannot judge them.
    """
    if any(not np.all(np.isfinite(t.q)) for t in machine.tracks):
        return None
    if machine.log.input_kind == "command" and (
        np.any(machine.actuator[2:4]) or machine.mechanism.unsupported_drives
    ):
        return (
            None  # a servo's force is of the angles themselves, and that of a muscle is not known
        )
    return _tracks(machine, range(machine.tree.n)), _design(machine.tree, _program(machine.tree.n))


def check_conventions(machine: Machine) -> tuple[AuditFinding, ...]:
    """What the motion says of the declared columns. Raises BadInput where it contradicts them, with
    what to write instead.
    """
    tree, log = machine.tree, machine.log
    program = _program(tree.n)
    if log.input_kind == "command" and not machine.mechanism.unsupported_drives:
        driven = [bool(gain) for gain in machine.actuator[0]]
        _check_order(machine, _design(tree, program), driven, ("q", "target"))
    warnings = check_commands(machine)
    found = of_machine(machine)
    if found is None:
        return warnings
    tracks, declared = found
    more = []
    for factor, unit in FACTORS.items():
        asked = f" (was it written in {unit}?)" if unit else ""
        phrase = f"lengths {factor:g} times those of {machine.mechanism.path} fit the motion{asked}"
        more.append(
            Hypothesis(
                "length",
                phrase,
                "write it in metres",
                design=_design(_resized(tree, factor), program),
            )
        )
    words = words_of(machine)
    zeros = [j for j, turns in enumerate(words.hinges) if turns]
    if other := contradiction(tracks, declared, words, more, _chain(tree), zeros):
        raise BadInput(f"{log.path}: {other.message}; {AS_DECLARED}")
    if log.input_kind == "torque":
        driven = [name in log.driven for name in tree.joint_names]
        _check_order(machine, declared, driven, ("q", "v", "tau"))
        _check_sides(machine, tracks, declared)
    if log.input_kind in ("none", "torque"):
        warnings += check_pace(machine, tracks, declared)
        warnings += held_fast(machine, tracks, declared)
    warned = warnings + (() if machine.gain_unknown else _weighed(machine, tracks, declared))
    late = lateness(tracks, declared)
    step = float(np.median([np.median(np.diff(t.time)) for t in tracks]))
    if late is None:
        return warned
    return warned + late_finding(log.path, late, step, ("the input columns",), names_late_logs=True)


def _check_order(
    machine: Machine, design: Design, driven: list[bool], stems: tuple[str, ...]
) -> None:
    """See `order.check_order`, of the columns `stems` that the log has."""
    if any(t.v is None for t in machine.tracks):
        stems = tuple(stem for stem in stems if stem != "v")
    tree, path = machine.tree, machine.log.path
    orders = partial(_tracks, machine)
    check_order(path, orders, design, tree.joint_names, tree.parent, driven, stems)


def _check_sides(machine: Machine, tracks: list[Track], declared: Design) -> None:
    """BadInput where torques of some joints are those of another side of their gears."""
    names, path = machine.tree.joint_names, machine.log.path
    told = {names[j]: size for j, size in other_sides(tracks, declared).items()}
    if not told:
        return
    times = " and ".join(f"{size:.3g} times those of {name}" for name, size in told.items())
    lines = " and ".join(f"tau_{name} = {1.0 / size:.3g}" for name, size in told.items())
    raise BadInput(
        f"{path}: the torques are {times} that move the declared masses (of a rotor, or another "
        f"unit?); write {lines} under [units] in meta.toml; {AS_DECLARED}"
    )


def _weighed(machine: Machine, tracks: list[Track], declared: Design) -> tuple[AuditFinding, ...]:
    """A warning where the torques are several times those of the declared masses; BadInput where
    they are far from them.
    """
    motion = motion_of(tracks)
    if (
        len(motion.q) < BLOCK.min_blocks or not np.ptp(motion.tau, axis=0).any()
    ):  # a free swing says nothing of the torques' unit
        return ()
    if asked := amperes(machine, tracks, declared):
        return asked
    found = linear_fit(motion, declared, first=machine.tree.n)
    if (
        found.unexplained_share > CONTRADICTION.min_doubted_share
        or 1.0 / CONTRADICTION.max_torque_ratio < found.scale < CONTRADICTION.max_torque_ratio
    ):
        return ()
    near = min(UNITS, key=lambda u: abs(np.log(found.scale / u)))
    if 1.0 / CONTRADICTION.max_torque_ratio < found.scale / near < CONTRADICTION.max_torque_ratio:
        unit = f" ({UNITS[near]}?)"
    else:
        unit = ""
    size = f"{float(f'{found.scale:.2g}'):g}"
    times = f"{size} times those that the masses of {machine.mechanism.path} need"
    phrase = f"the torques that make this motion are {times}{unit}"
    mend = f"write masses in kg and torques in N m, or {_torque_unit(machine, found.scale)}"
    if angle := _angle_unit(machine, motion, declared, found.unexplained_share):
        phrase = f"{phrase}; they are of the right size if the angles are in {angle[0]}"
        keys = [key for key, unit in machine.log.meta.units.items() if unit in ("deg", "rad")] or [
            "angle"
        ]
        lines = " and ".join(f'{key} = "{angle[1]}"' for key in keys)
        mend = f"write {lines} under [units] in meta.toml; or else {mend}"
    if 1.0 / CONVENTION.refused_scale < found.scale < CONVENTION.refused_scale:
        return (AuditFinding("masses", "warn", "", "masses", f"{phrase}; {mend}", found.scale),)
    raise BadInput(f"{machine.log.path}: {phrase}; {mend}; {AS_DECLARED}")


def _torque_unit(machine: Machine, scale: float) -> str:
    """What to write where logged torques are `scale` times too large, by what they are called in
    the log.
    """
    tree, log = machine.tree, machine.log
    driven = {
        tree.kinds[tree.joint_names.index(name)] for name in log.driven if name in tree.joint_names
    }
    quantities = [
        name for kind, name in (("hinge", "torque"), ("slide", "force")) if kind in driven
    ]
    if log.input_kind == "command":
        keys = ["ctrl"]
    else:
        keys = quantities or ["torque"]
    number = f"{float(f'{1.0 / scale:.3g}'):g}"
    known = any(key in log.meta.units for key in keys)
    lines = " and ".join(key if known else f"{key} = {number}" for key in keys)
    return f"{'the commands' if keys == ['ctrl'] else 'the torques'}' unit under [units] ({lines})"


def _angle_unit(
    machine: Machine, motion: BlockMeans, declared: Design, left: float
) -> tuple[str, str] | None:
    """In words, and for `[units]`, the unit of all angles of hinges that brings the torques to
    their size, explaining no less.
    """
    hinges = np.array([kind == "hinge" for kind in machine.tree.kinds])
    if not hinges.any():
        return None
    for factor, words, unit in ANGLES:
        size = np.where(hinges, factor, 1.0)
        other = linear_fit(
            replace(motion, q=motion.q * size, v=motion.v * size, a=motion.a * size),
            declared,
            first=machine.tree.n,
        )
        if (
            other.unexplained_share <= CONVENTION.same_share * left + CONVENTION.same_added
            and 1.0 / CONTRADICTION.max_torque_ratio < other.scale < CONTRADICTION.max_torque_ratio
        ):
            return words, unit
    return None


def mechanism_trials(machine: Machine) -> TrialDifferences | None:
    """See `trials_differ.trials_differ`; of a machine whose input is a torque by now
    (`diagnose.scaled`).
    """
    found = of_machine(machine)
    if found is None:
        return None
    return trials_differ([t.name for t in machine.tracks], *found)


def check_signals(machine: Machine) -> Audit:
    """What the audit of signals warns of in the trials that are diagnosed."""
    tree, log = machine.tree, machine.log
    slides = [name for j, name in enumerate(tree.joint_names) if tree.kinds[j] == "slide"]
    efforts = None
    if log.input_kind == "command":
        names = [(k, actuator_of(machine.mechanism, n)) for k, n in enumerate(log.input_names)]
        efforts = {tree.joint_names[a.joint]: k for k, a in names if a and not (a.kp or a.kv)}
    return audit(log.pick([t.name for t in machine.tracks]), slides, efforts)


def _tracks(machine: Machine, order: Sequence[int]) -> list[Track]:
    """Trials with joints from these columns, and torques at them by the declared law of the
    actuators.
    """
    own, out = list(order), []
    for t in machine.tracks:
        q, v = t.q[:, own], None if t.v is None else t.v[:, own]
        speed = np.gradient(q, t.time, axis=0) if v is None else v
        force = drive_force(machine.actuator, machine.gear, machine.ties, q, speed, t.u[:, own])
        held_up = compensation(machine.tree, q.T)
        out.append(Track(t.time, q, v, force if held_up is None else force + np.asarray(held_up).T))
    return out


@cache
def _program(n: int):
    """Compiled once for all hypotheses of `n` joints: rows are filled up to one count."""

    def by_body(tree, q, v, a, g):
        return regressor(tree, q, v, a, g)

    return jax.jit(by_body)


def _design(tree: Tree, program) -> Design:
    """A body's declared inertia as one column, and an armature at each joint."""

    def columns(m: BlockMeans, gravity: bool) -> np.ndarray:
        k, n = m.q.shape

        def fill(x):
            return np.concatenate([x, np.zeros((BLOCK.max_blocks - k, n))]).T

        pull = np.asarray(tree.gravity) * (1.0 if gravity else 0.0)
        table = np.asarray(program(tree, fill(m.q), fill(m.v), fill(m.a), pull))[:, :, :k].reshape(
            n, n, 10, k
        )
        bodies = np.einsum("ibpk,bp->kib", table, np.asarray(tree.inertial))
        return np.concatenate([bodies, m.a[:, :, None] * np.eye(n)], 2)

    return columns


def _resized(tree: Tree, factor: float) -> Tree:
    size = np.array([1.0, *[factor] * 3, *[factor**2] * 6])
    return replace(
        tree, place=factor * np.asarray(tree.place), inertial=np.asarray(tree.inertial) * size
    )


def _chain(tree: Tree) -> list[int]:
    """The parent of each hinge whose axis is parallel to its own, else -1."""
    turned = [float(np.asarray(tree.rotation)[j][2, 2]) for j in range(tree.n)]

    def both(j):
        return tree.parent[j] >= 0 and tree.kinds[j] == tree.kinds[tree.parent[j]] == "hinge"

    return [
        tree.parent[j] if both(j) and turned[j] > CONVENTION.parallel else -1 for j in range(tree.n)
    ]


def words_of(machine: Machine) -> Words:
    """How the columns of a machine's log are called."""
    tree, kind = machine.tree, machine.log.input_kind
    names, stem = tree.joint_names, "tau" if kind == "torque" else kind
    return Words(
        reverse=lambda j: f'write reversed = ["{names[j]}"] under [angles] in meta.toml',
        absolute=lambda j, parent: (
            f'write convention = {{{names[j]} = "absolute"}} under [angles] in meta.toml'
        ),
        joints=names,
        q=tuple(f"q_{n}" for n in names),
        v=tuple(f"v_{n}" for n in names),
        tau=tuple(f"{stem}_{n}" for n in names),
        hinges=tuple(k == "hinge" for k in tree.kinds),
        swap="exchange their columns, or their names in the header or under [columns]",
    )
