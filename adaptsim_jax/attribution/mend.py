"""What a fitted model changes in the user's model file, and what the file cannot hold."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.acting import rubs_dry
from adaptsim_jax.attribution.candidates import JointCandidate, candidates
from adaptsim_jax.attribution.equation.models import TorqueSearch, without
from adaptsim_jax.attribution.fitted import FittedTree, Selection
from adaptsim_jax.attribution.held_out import attempted, modelled, refit
from adaptsim_jax.attribution.in_mjcf import changes_of
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import TORQUE
from adaptsim_jax.attribution.nested_models import without as without_simulated
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.friction import COULOMB
from adaptsim_jax.mend.mjcf import Changes, mended_mjcf
from adaptsim_jax.mend.model_toml import Form

COMMANDED = ("command", "voltage", "current")


def by_actuator(effect: Effect) -> dict[str, str]:
    """What changes at an actuator, by parameter of an effect that a file holds there."""
    return {p.name: p.mjcf for p in effect.parameters if p.mjcf and effect.on_actuator}


def levelled(effect: Effect) -> bool:
    """Whether it is dry friction that MJCF does not know: a constant level is the nearest there."""
    return effect.traits.resists and not effect.held_by_file and rubs_dry(effect)[0]


def holdable(
    machine: Machine,
    problem: TreeProblem,
    found: Selection,
    criteria: Criteria,
    by_torque: TorqueSearch | None = None,
) -> FittedTree:
    """The final model, refitted without what the model file cannot hold; in its place stands a
    look-alike from its class, and Coulomb friction for other dry friction. by_torque: refitted to
    the balance of torques where that has judged.
    """
    if by_torque is not None:
        return _held_by_torque(machine, problem, found, by_torque)
    model = found.final
    alike = {n.candidate.key: {a.key for a in n.alternatives} for n in found.named}
    for c in model.added:
        if not _holds(machine, problem, model, c):
            model = without_simulated(
                problem, model, c, replace(criteria, worse_share=1.0)
            )  # fitted to the end in any case

            def level(k, c=c):
                return (
                    levelled(problem.effect(c.effect))
                    and k.effect == COULOMB.name
                    and set(k.joints) <= set(c.joints)
                    and k.sharing != "common"
                )

            rows = [
                k
                for k in candidates(problem, model.fit.vector, found.reach)
                if problem.effect(k.effect).held_by_file
                and (k.key in alike.get(c.key, ()) or level(k))
            ]
            for row in table(problem, model.lin, rows)[:1]:
                vector, starts, _ = attempted(problem, model, found.reach, row)
                fitted = refit(
                    problem, vector, starts, c.joints, criteria.rounds, model.fit.weights
                )
                model = modelled(problem, (*model.added, row.candidate), fitted, model.fit.weights)
    return model


def _held_by_torque(
    machine: Machine, problem: TreeProblem, found: Selection, searched: TorqueSearch
) -> FittedTree:
    model = found.final
    gone = [c for c in model.added if not _holds(machine, problem, model, c)]
    if not gone:
        return model
    there = {(c.effect, j) for c in model.added for j in c.joints}
    rubbing = [c for c in gone if levelled(problem.effect(c.effect))]
    dry = {j for c in rubbing for j in c.joints if (COULOMB.name, j) not in there}
    level = [
        c
        for c in candidates(problem, searched.null, found.reach)
        if c.effect == COULOMB.name and c.sharing == "joint"
    ]
    rest = without(problem, searched, gone, [c for c in level if c.joints[0] in dry])
    fit = replace(model.fit, vector=rest.final)
    return replace(model, added=rest.added, fit=fit)


def _holds(machine: Machine, problem: TreeProblem, model: FittedTree, c: JointCandidate) -> bool:
    effect = problem.effect(c.effect)
    if effect.held_by_file:
        return True
    if machine.log.input_kind in COMMANDED:
        driven = {a.joint for a in machine.mechanism.actuators}
    else:
        driven = set()
    if machine.gain_unknown:  # which gets a motor where it has none
        driven |= {machine.tree.joint_names.index(name) for name in gains(machine)}
    fitted = model.fit.vector.pairs()
    values = [v for e, v in fitted if e.owner == c.effect and set(e.joints) <= set(c.joints)]
    late, changed = effect.shifts_commands, by_actuator(effect)
    # gain times torque beside a clipped torque bends where the limit is reached; a limit of MJCF
    # clips both
    bent = "limit" in changed.values() and any(
        problem.effect(k.effect).traits.scales_drive and set(k.joints) & set(c.joints)
        for k in model.added
    )
    return (
        bool(changed) and set(c.joints) <= driven and not bent and not (late and min(values) < 0.0)
    )


def lost(machine: Machine, problem: TreeProblem, found: Selection) -> list[str]:
    """A note on the effects that `model.xml` cannot hold; a shift of commands that is no name is
    how a log was read.
    """
    model, keys = found.final, {n.candidate.key for n in found.named}
    gone = [
        c
        for c in model.added
        if not _holds(machine, problem, model, c)
        and (c.key in keys or not problem.effect(c.effect).shifts_commands)
    ]
    lines = [
        f"{c.effect.replace('_', ' ')} at {', '.join(problem.joint_names[j] for j in c.joints)}"
        for c in gone
    ]
    if gone:
        return [
            f"model.xml cannot hold {'; '.join(lines)}: only model.toml has the whole of the "
            "mended model."
        ]
    return []


def gains(machine: Machine) -> dict[str, float]:
    """Torque over volts or amperes by driven joint, where the search had to find it; else none."""
    names = machine.tree.joint_names if machine.gain_unknown else ()
    driven = [j for j in range(len(names)) if any(np.any(t.u[:, j]) for t in machine.tracks)]
    return {names[j]: float(machine.actuator[0, j]) for j in driven}


def gain_notes(machine: Machine) -> list[str]:
    """A note on torque over input, where that had to be found."""
    if not (found := gains(machine)):
        return []
    unit = "V" if machine.log.input_kind == "voltage" else "A"
    each = ", ".join(f"{name} {value:.4g} N m/{unit}" for name, value in found.items())
    return [
        f"Torque over input, fitted: {each}. By these data only its ratios to inertias and "
        "friction are fixed."
    ]


def changes(
    machine: Machine, problem: TreeProblem, model: FittedTree, named: FittedTree
) -> Changes:
    """The changes that `model.xml` gets of a `holdable` model, with comments on what is `named`
    besides.
    """
    comments = [
        f"written by adaptsim from {machine.mechanism.path.rsplit('/', 1)[-1]}",
        *_lost(problem, model, named),
    ]
    form = model_toml.form_of(problem, model, gains(machine))
    lost = _gone(problem, model, named)
    return replace(changes_of(machine, form, problem.effects), comments=comments, lost=lost)


def declared_changes(machine: Machine) -> Changes:
    """Those of the declared model: none, but for a gain that had to be found."""
    form = Form("mechanism", model_toml.DECLARED, own={"gain": gains(machine)})
    return changes_of(machine, form)


def _lost(problem: TreeProblem, model: FittedTree, named: FittedTree) -> list[str]:
    """A line for each number that the file cannot hold."""
    gone = _gone(problem, model, named)
    lines = []
    for e, value in named.fit.vector.pairs():
        for where in (f"{e.owner} at {problem.joint_names[j]}" for j in e.joints):
            if where in gone:
                number = f"{e.name} = {value:.6g} {e.unit}"
                lines.append(f"not held by this file, see model.toml: {where}, {number}")
    return lines


def _gone(problem: TreeProblem, model: FittedTree, named: FittedTree) -> list[str]:
    """`EFFECT at JOINT` of all that the file cannot hold."""
    retained = {c.key for c in model.added}
    gone = [c for c in named.added if c.key not in retained]
    return [f"{c.effect} at {problem.joint_names[j]}" for c in gone for j in c.joints]


MODEL = "model.xml"


def mjcf_files(e: Examined) -> dict[str, Callable[[], str]]:
    """What makes the text of `declared.xml` and of `model.xml`."""
    machine, problem, found = e.inquiry.machine, e.problem, e.found
    by_torque = e.by_torque if e.judge == TORQUE else None

    def mended():
        held = holdable(machine, problem, found, e.inquiry.criteria, by_torque)
        return mended_mjcf(machine.mechanism, changes(machine, problem, held, found.final))

    return {
        model_toml.DECLARED: lambda: mended_mjcf(machine.mechanism, declared_changes(machine)),
        MODEL: mended,
    }
