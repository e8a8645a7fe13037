"""A machine as a problem: its settings, candidate effects, declared vector and the scale of its
inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import CHOICE, PRIOR_WIDTH, STRETCH
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.commands import drive_gains
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import NAMES
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem, nuisances
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import TORQUE_GAIN
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.friction import VISCOUS


@dataclass(frozen=True)
class DiagnosisSetting:
    """What a diagnosis is asked for.

    Args:
        criteria: What counts as an effect.
        horizon: s, of simulated stretches.
        exclude: Effects that are not considered.
        effects: The catalogue, ours where None; of another, what is always fitted is ours.
        objective: The one that is to judge, the one that tells most where None.
        torques: Whether the balance of torques is looked at.
    """

    criteria: Criteria = field(default_factory=Criteria)
    horizon: float = CHOICE.horizon
    exclude: tuple[str, ...] = ()
    effects: Sequence[Effect] | None = None
    objective: str | None = None
    torques: bool = True

    def __post_init__(self) -> None:
        if self.objective is not None and self.objective not in NAMES:
            named = f"--yardstick {self.objective}"
            raise BadInput(f"{named}: is no yardstick; use {', '.join(NAMES)}")


def catalogue_of(
    machine: Machine, setting: DiagnosisSetting
) -> tuple[tuple[Effect, ...], frozenset[tuple[str, int]]]:
    """Effects that are considered or always fitted, and those that are left out at a joint."""
    fitted = {VISCOUS.name}
    if machine.gain_unknown:
        fitted.add(TORQUE_GAIN.name)
    known = MACHINE
    if setting.effects is not None:
        known = (*(e for e in MACHINE if e.name in fitted), *setting.effects)
    names = {e.name for e in known}
    everywhere, at_joints = excluded_of(setting.exclude, names, machine.tree.joint_names)
    chosen = tuple(e for e in known if e.name not in everywhere or e.name in fitted)
    return chosen, at_joints


def excluded_of(
    exclude: Sequence[str], names: set[str], joints: Sequence[str]
) -> tuple[set[str], frozenset[tuple[str, int]]]:
    """What `--exclude` names: effects (`coulomb`), and effects at a joint (`coulomb at elbow`).
    names: of the effects that there are.

    Raises BadInput where there is no such effect, or no such joint.
    """
    everywhere, at_joints = set(), set()
    for text in exclude:
        name, _, joint = text.partition(" at ")
        if name not in names:
            listed = ", ".join(sorted(names))
            raise BadInput(f"--exclude: {name!r} is no effect of a mechanism; it has {listed}")
        if joint and name == TILT:
            raise BadInput(f"--exclude: {TILT} is of the base, at no joint: --exclude {TILT}")
        if joint and joint not in joints:
            raise BadInput(f"--exclude: no joint is named {joint!r}; it has {', '.join(joints)}")
        if joint:
            at_joints.add((name, list(joints).index(joint)))
        else:
            everywhere.add(name)
    return everywhere, frozenset(at_joints)


def posed(machine: Machine, effects: Sequence[Effect], horizon: float) -> TreeProblem:
    """The problem of a machine in stretches of `horizon` s."""
    problem = machine.problem(effects, horizon, look_back=STRETCH.look_back)
    names = machine.tree.joint_names
    return replace(problem, unlike=tuple(names.index(j) for j in machine.log.unlike if j in names))


def factor_of(meta: Any) -> float:
    """Within which masses and moments are taken to be those of the model file, along the measured
    motion. Raises BadInput.
    """
    factor = meta.fit.get("factor", PRIOR_WIDTH.body_factor)
    if isinstance(factor, bool) or not isinstance(factor, (int, float)) or not 1.0 < factor <= 1e3:
        raise BadInput(f"{meta.path}: [fit] factor = {factor!r} must be a number above 1, as 3")
    return float(factor)


def scaled(machine: Machine, horizon: float) -> Machine:
    """With the gain of a voltage or current as the declared model's fit has it, so that effects see
    a torque in N m.
    """
    if not machine.gain_unknown:
        return machine
    if (law := by_torque(machine)) is not None:
        return replace(machine, actuator=law, gain_estimated=True)
    problem = replace(machine, ties=None).problem(MACHINE, horizon)
    vector = fit(problem, declared_vector(machine, problem), rounds=15).vector
    law = machine.actuator.copy()
    for e, value in vector.pairs():
        if e.owner == TORQUE_GAIN.name:
            law[0, list(e.joints)] *= 1.0 + value
    return replace(machine, actuator=law)


def by_torque(machine: Machine) -> np.ndarray | None:
    """The law of the actuators [6, n] with the gains that weight and inertia of the file's bodies
    give them along the motion; None where these do
    not tell the gain of every driven joint.
    """
    if machine.tree.linear:
        return None
    problem = replace(machine, ties=None).problem(MACHINE)
    law = machine.actuator.copy()
    for b in balances(problem, machine.tracks):
        for joint, gain in drive_gains(problem, b).items():
            if gain is None:
                return None
            law[0, joint] = gain
    return law


def declared_vector(machine: Machine, problem: TreeProblem) -> Vector:
    """What is fitted whatever is named: inertias and damping unless `[fit]` in meta.toml says
    otherwise, and the gain of volts.
    """
    meta = machine.log.meta
    for table, key in (("fit", k) for k in meta.fit):
        if key not in ("inertias", "damping", "factor"):
            raise BadInput(
                f"{meta.path}: [{table}] {key} is unknown; use inertias or damping (true, false, "
                "or a list of names), or factor"
            )
    factor_of(meta)
    inertia, damping = meta.fit.get("inertias", True), meta.fit.get("damping", True)
    vector = nuisances(problem, inertia=bool(inertia), damping=bool(damping))
    tree = machine.tree
    for wanted, owner, of in (
        (inertia, INERTIA, tree.body_names),
        (damping, VISCOUS.name, tree.joint_names),
    ):
        if isinstance(wanted, (list, tuple)):
            if unknown := [n for n in wanted if n not in of]:
                raise BadInput(
                    f"{meta.path}: [fit] names {unknown[0]!r}, which {machine.mechanism.path} has "
                    f"not; it has {', '.join(of)}"
                )
            vector = vector.without(
                [
                    e.key
                    for e in vector.entries
                    if e.owner == owner and of[e.joints[0]] not in wanted
                ]
            )
    if machine.gain_unknown:
        # free, gain and inertias shrink together
        if machine.gain_estimated:
            prior = PRIOR_WIDTH.estimated_gain
        else:
            prior = np.inf
        gain = [
            Entry(TORQUE_GAIN.name, "gain", (j,), 0.0, 0.0, -0.95, 20.0, "1", prior)
            for j in range(problem.joints)
        ]
        vector = vector.with_entries(gain)
    return vector
