"""What a report on a mechanism says in sentences: its message, its notes, what must not be taken
for granted.
"""

import numpy as np

from adaptsim_jax.attribution.equation.commands import STUCK
from adaptsim_jax.attribution.held_out import most_over_floor
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import DAMPING_STEP, INERTIA, TILT
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import JointCandidate
from adaptsim_jax.attribution.select import Selection
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.effects.joints.friction import COULOMB, VISCOUS

SURE = 3.0  # times its standard error, from which on the step is told by which damping acts late
READ = "Read so; no effect is named for it. model.toml keeps it, for which model.xml has no place."
# times the noise floor: what the Coulomb friction of a simulator that lets a held joint creep may
# leave
SOFT = 5.0


def place(problem: TreeProblem, c: JointCandidate) -> str:
    """Where a candidate acts, in words."""
    if c.effect == TILT:
        return "base"
    if len(c.joints) == problem.joints and problem.joints > 1:
        return "all joints"
    return ", ".join(problem.joint_names[j] for j in c.joints)


def message(
    problem: TreeProblem,
    found: Selection,
    before: np.ndarray,
    after: np.ndarray,
    over: float,
    outliers: list[tuple[str, str, float]],
    outlying: int,
    criteria: Criteria,
) -> str:
    """What was found, in a few sentences. odd: trials of which much is left; far: stretches that
    are far off.
    """
    text = _found(problem, found, before, after, over, bool(outliers), criteria.explained)
    if not outliers:
        return text
    worst, joint, times = outliers[0]
    if outlying >= criteria.few:
        few = f"in {outlying} of {len(problem.fold)} stretches "
    else:
        few = ""
    if len(outliers) > 0.5 * len(problem.folds):
        if few:
            return (
                f"{text} But {few}up to {times:.0f} times the noise floor is left, at {joint}, "
                f"most in {worst}."
            )
        return text
    names = ", ".join(name for name, _, _ in outliers[:4]) + (
        f" and {len(outliers) - 4} more" if len(outliers) > 4 else ""
    )
    more = f"But {few}of {names} up to {times:.0f} times the noise floor is left, at {joint}: see what is particular to "
    return f"{text} {more}{'it' if len(outliers) == 1 else 'them'}, or run again --without."


def _found(
    problem: TreeProblem,
    found: Selection,
    before: np.ndarray,
    after: np.ndarray,
    over: float,
    outliers: bool,
    explained: float,
) -> str:
    kinds = set(problem.kinds)
    if kinds == {"hinge"}:
        unit = "mrad"
    elif kinds == {"slide"}:
        unit = "mm"
    else:
        unit = "10^-3 rad or m"

    def size(e):
        return f"{1e3 * np.median(e):.3g}"

    median = np.median(after, 0) / np.maximum(problem.floor[: problem.joints], 1e-12)
    worst = int(np.argmax(median))
    remains = most_over_floor(problem, after) > explained
    if remains and problem.joints > 1:
        many = f", most of it at {problem.joint_names[worst]}"
    else:
        many = ""
    if not found.named:
        text = f"{_model(problem, found)} simulates left-out stretches to {size(after)} {unit}, {over:.1f} times the noise floor"
        if not remains:
            if outliers:
                return f"{text}."
            return f"{text}. Nothing need be added."
        at = f"{many} ({median[worst]:.0f} times)" if many else ""
        return f"{text}{at}. No effect of the catalogue holds out.{_closest(problem, found)}"
    lines = []
    for n in found.named:
        c, t = n.candidate, n.test
        lines.append(
            f"{c.effect.replace('_', ' ')} at {place(problem, c)} holds out in {t.better} of "
            f"{t.folds} (takes {100 * t.gain:.0f} % off the squared error beside all others, p "
            f"{t.p:.2g})"
        )
    text = "; ".join(lines)
    text = text[:1].upper() + text[1:]
    rest = f"Left-out error {size(before)} to {size(after)} {unit}; what remains is {over:.1f} times the noise floor"
    return f"{text}. {rest}{many}."


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
    names = ", ".join(
        f"{s.candidate.effect.replace('_', ' ')} at {place(problem, s.candidate)}" for s in near
    )
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
        for j in np.flatnonzero(observed & (moves < STUCK * asked))
    ]
    if not lines:
        return []
    return [
        "These joints hardly move though they are told to, as a share of what is asked: "
        f"{', '.join(lines)}. Nothing is said of their gains. A brake, a servo without power, or "
        "the column of another joint looks like that."
    ]


def soft_friction(
    problem: TreeProblem, named: tuple[Named, ...], kind: str, over: float
) -> list[str]:
    """That a simulated log may be the reason why a little more is left, where friction is not
    simulated as soft as the file has it.
    """
    if any(np.any(g.model.tree.rub) for g in problem.groups):
        return []
    if (
        kind != "partly_explained"
        or over > SOFT
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
    return [*_early_commands(problem, found), *_implicit(found), *([rotors] if read else [])]


def _implicit(found: Selection) -> list[str]:
    """That damping acts by the speed at another time in a step."""
    model = found.final
    rows = zip(model.fit.vector.entries, model.fit.vector.values, model.spread, strict=True)
    steps = [
        1e3 * z for e, z, spread in rows if e.owner == DAMPING_STEP and abs(z) > SURE * spread > 0.0
    ]
    steps = sorted(steps, key=abs)[-1:]  # groups of joints that share no body have one each
    return [
        f"What damps the joints, controllers' kv too, acts by the speed {abs(z):.2g} ms "
        f"{'later' if z > 0 else 'earlier'}: as the steps of a simulator or of a controller make "
        f"it. {READ}"
        for z in steps
    ]


def _early_commands(problem: TreeProblem, found: Selection) -> list[str]:
    """What a delay below zero means, or one within a row."""
    reads = {e.name for e in problem.effects if e.pairs_rows}.__contains__
    vector = found.final.fit.vector
    delays = [z for e, z in zip(vector.entries, vector.values, strict=True) if reads(e.owner)]
    named = any(reads(n.candidate.effect) for n in found.named)
    if not delays or (named and min(delays) >= 0.0):
        return []
    if not named:
        at, spacing = (
            1e3 * min(delays),
            f"their row (rows are {1e3 * problem.reach.dt:.3g} ms apart)",
        )
        early = f"{-at:.2g} ms before {spacing}: they changed between rows, by a faster controller, or were logged that late"
        late = f"{at:.2g} ms after {spacing}, or angles were logged that late: less than the log resolves"
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
            name = f"{s.candidate.effect.replace('_', ' ')} at {place(problem, s.candidate)}"
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
