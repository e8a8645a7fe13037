"""What a report on a mechanism says in sentences: its message, its notes, what must not be taken
for granted.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.criteria import SERVO, TEXT
from adaptsim_jax.attribution.fitted import Selection
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import INERTIA, TILT
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.report import Headline, Label, named_words
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.effects.joints.friction import COULOMB, VISCOUS

READ = "Read so; no effect is named for it. model.toml keeps it, for which model.xml has no place."


def label(problem: TreeProblem, c: JointCandidate) -> Label:
    """How a report calls a candidate."""
    return Label(c.effect, place(problem, c))


def place(problem: TreeProblem, c: JointCandidate) -> str:
    """Where a candidate acts, in words."""
    if c.effect == TILT:
        return "base"
    if len(c.joints) == problem.joints and problem.joints > 1:
        return "all joints"
    return ", ".join(problem.joint_names[j] for j in c.joints)


@dataclass(frozen=True)
class Remains:
    """What models leave of left-out stretches.

    Args:
        before, after: `[W, n]` rad or m, of the declared and of the final model.
        noise: `[n]` rad or m, the noise floor of each joint.
        times: `[n]` times the noise floor that the final model leaves, zero where nothing moves.
        left: Whether that is more than noise at a joint that moves.
        outliers: Trials of which much is left: name, joint, times the noise floor.
        outlying: Number of stretches that are far off.
    """

    before: np.ndarray
    after: np.ndarray
    noise: np.ndarray
    times: np.ndarray
    left: bool
    outliers: list[tuple[str, str, float]]
    outlying: int


def headline(
    problem: TreeProblem, found: Selection, remains: Remains, criteria: Criteria
) -> Headline:
    """Sentences of the message where simulated stretches judge."""
    kinds = set(problem.kinds)
    if kinds == {"hinge"}:
        unit = "mrad"
    elif kinds == {"slide"}:
        unit = "mm"
    else:
        unit = "10^-3 rad or m"
    sizes = [f"{1e3 * np.median(e):.3g}" for e in (remains.before, remains.after)]
    worst = int(np.argmax(remains.times))
    over = f"{remains.times[worst]:.1f} times the noise floor"
    if remains.left and problem.joints > 1:
        over += f" at {problem.joint_names[worst]}"
    declared = (
        f"{_model(problem, found)} simulates left-out stretches to {sizes[1]} {unit}, {over}."
    )
    named = named_words(found.named, lambda c: label(problem, c).words)
    mended = f"{named} Left-out error {sizes[0]} to {sizes[1]} {unit}; what remains is {over}."
    more = _outliers(problem, remains, criteria)
    if remains.left and not found.named:
        more = f"{_closest(problem, found)}{more}"
    return Headline(declared, mended, more, none=Headline.none if remains.left else "")


def _outliers(problem: TreeProblem, remains: Remains, criteria: Criteria) -> str:
    """A sentence on trials of which much is left."""
    if not remains.outliers:
        return ""
    (worst, joint, times), count = remains.outliers[0], len(remains.outliers)
    few = ""
    if remains.outlying >= criteria.few:
        few = f"in {remains.outlying} of {len(problem.fold)} stretches "
    left = f"up to {times:.0f} times the noise floor is left, at {joint}"
    if count > 0.5 * len(problem.folds):
        return f" But {few}{left}, most in {worst}." if few else ""
    names = ", ".join(name for name, _, _ in remains.outliers[:4])
    if count > 4:
        names += f" and {count - 4} more"
    them = "it" if count == 1 else "them"
    return f" But {few}of {names} {left}: see what is particular to {them}, or run again --without."


def _model(problem: TreeProblem, found: Selection) -> str:
    if any(e.owner in (INERTIA, VISCOUS.name) for e in found.final.fit.vector.entries):
        return "The declared model, fitted,"
    read = read_so(problem, found)
    if read:
        return "The model file as it is, rows read as the notes say,"
    return "The model file as it is"


def _closest(problem: TreeProblem, found: Selection) -> str:
    """The candidates that a score test favours, where none holds out."""
    near = [
        s
        for s in found.scores
        if s.p * len(found.scores) < 0.01 and s.held_out > 0.05 * found.stages[0].fit.total
    ][:3]
    names = ", ".join(label(problem, s.candidate).words for s in near)
    if near:
        return f" Closest by a linear test, though no fit bears them out: {names}."
    return ""


def unused(machine: Machine) -> list[str]:
    """What meta.toml says and no fit of a mechanism goes by."""
    if not machine.log.meta.known:
        return []
    return [
        "[known] in meta.toml is not used of a mechanism: put the value into its model file, and "
        "take the body out of [fit] inertias"
    ]


def standing(machine: Machine) -> list[str]:
    """Joints that hardly move while their position servos are told to: a brake, no power, another
    joint's column.
    """
    kp = -machine.actuator[2] * machine.gear**2

    def of(rows):
        return np.sqrt(np.mean([np.ma.masked_invalid(z).var(0).filled(0.0) for z in rows], 0))

    observed = np.all([np.isfinite(t.q).any(0) for t in machine.tracks], 0)  # in every trial
    moves = of([t.q for t in machine.tracks])
    asked = (
        of([t.u for t in machine.tracks])
        * machine.actuator[0]
        * machine.gear
        / np.where(kp > 0, kp, np.inf)
    )
    names = machine.tree.joint_names
    lines = [
        f"{names[j]} ({moves[j] / asked[j]:.0%})"
        for j in np.flatnonzero(observed & (moves < SERVO.stuck * asked))
    ]
    if not lines:
        return []
    return [
        "These joints hardly move though they are told to, as a share of what is asked: "
        f"{', '.join(lines)}. Nothing is said of their gains. A brake, a servo without power, or "
        "the column of another joint looks like that."
    ]


def soft_friction(
    problem: TreeProblem, named: tuple[Named, ...], left: bool, over: float
) -> list[str]:
    """That a simulated log may be the reason why a little more is left, where friction is not
    simulated as soft as the file has it.
    """
    if any(np.any(g.model.tree.friction_softness) for g in problem.groups):
        return []
    if (
        not left
        or over > TEXT.soft_friction
        or all(n.candidate.effect != COULOMB.name for n in named)
    ):
        return []
    return [
        "Where MuJoCo made these logs, its own Coulomb friction, which is a little soft "
        "(solreffriction), leaves such a rest."
    ]


def read_so(problem: TreeProblem, found: Selection) -> list[str]:
    """What was fitted as a way in which rows are read, or steps made."""
    read = any(
        s.action == "read" and s.candidate is not None and s.candidate.effect == ARMATURE.name
        for s in found.trace
    )
    rotors = (
        "All rotors differ from the file's by what damps them in a small part of a row: as a "
        "simulator's or a controller's steps make it. Read so; no effect is named for it."
    )
    return [*_early_commands(problem, found), *([rotors] if read else [])]


def _early_commands(problem: TreeProblem, found: Selection) -> list[str]:
    """What a delay below zero means, or one within a row."""
    reads = {e.name for e in problem.effects if e.pairs_rows}.__contains__
    vector = found.final.fit.vector
    delays = [z for e, z in vector.pairs() if reads(e.owner)]
    named = any(reads(n.candidate.effect) for n in found.named)
    if not delays or (named and min(delays) >= 0.0):
        return []
    if not named:
        at, spacing = (
            1e3 * min(delays),
            f"their row (rows are {1e3 * problem.reach.dt:.3g} ms apart)",
        )
        early = (
            f"{-at:.2g} ms before {spacing}: they changed between rows, by a faster controller, or "
            "were logged that late"
        )
        late = (
            f"{at:.2g} ms after {spacing}, or angles were logged that late: less than the log "
            "resolves"
        )
        return [
            f"Commands act {early}. {READ}"
            if at < 0.0
            else f"Commands act {late}. Read so; no effect is named for it."
        ]
    return [
        "a delay below zero is the log's, not the machine's: commands were logged late, or "
        "changed between two rows (of a controller that runs faster than its log, half of the "
        "difference of both intervals)"
    ]


def doubts(problem: TreeProblem, found: Selection) -> list[str]:
    out = []
    for s in found.trace:
        if s.action == "dropped" and s.candidate is not None and s.test is not None:
            name = label(problem, s.candidate).words
            out.append(f"{name} was tried and dropped: {s.why} ({s.shown}).")
    return out


def shorter(found: Selection, criteria: Criteria, horizon: float) -> list[str]:
    """That names come of the beginnings of the stretches."""
    if not found.shorter:
        return []
    return [
        f"Over {horizon:g} s no fit of an effect held out; what is named was found, and tested, "
        f"over the first {criteria.beginning * horizon:.2g} s of each stretch"
    ]
