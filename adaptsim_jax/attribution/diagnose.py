"""Diagnose a recording of any mechanism: which effects its model file lacks, what is left, and a
better model file.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.choice import STRETCH
from adaptsim_jax.attribution.conventions import (
    channels,
    check_conventions,
    check_signals,
    mechanism_trials,
)
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.commands import drive_gains
from adaptsim_jax.attribution.equation.search import FACTOR
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.examine import Examined, examine, report_of, with_null
from adaptsim_jax.attribution.inertias_told import named_by, otherwise
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.mend import (
    changes,
    declared_changes,
    gain_notes,
    gains,
    holdable,
    lost,
    servos,
)
from adaptsim_jax.attribution.parameters import DAMPING_STEP, INERTIA, Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem, held, nuisances, own_inertia, prepare
from adaptsim_jax.attribution.replay import follows, recommended
from adaptsim_jax.attribution.report import reported
from adaptsim_jax.attribution.select import Hint
from adaptsim_jax.attribution.select import declared as fitted_null
from adaptsim_jax.attribution.servo import (
    calibrated,
    damped_by_file,
    friction_first,
    servo_entries,
    servo_notes,
    servo_rows,
    span_of,
    still_off,
    with_gains,
)
from adaptsim_jax.attribution.yardsticks import NAMES, TORQUE, WHOLE
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS
from adaptsim_jax.diagnosis.run import Page, Run, command_of, plain
from adaptsim_jax.diagnosis.schema import check, with_effects
from adaptsim_jax.diagnosis.written import cleared, write_all, write_partial
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import POSITION_GAIN, TORQUE_GAIN
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.friction import VISCOUS
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.mend.mjcf import mended_mjcf
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE

Progress = Callable[[float, float, str], None]
HORIZON = STRETCH
LOOK_BACK = 0.012  # s, from a stretch's start: what a late sensor tells there is not compared
MODEL = "model.xml"
ESTIMATED_GAIN = (
    0.1  # prior's standard deviation of a drive's gain about the one that weight and inertia gave
)
LEFT = 0.5  # of what a joint weighs, at least, that damping by another speed leaves it


def diagnose(
    data: str | Path,
    *,
    model: str | Path | None = None,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    horizon: float = HORIZON,
    exclude: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
    progress: Progress | None = None,
    page: Page | None = None,
    as_declared: bool = False,
    effects: Sequence[Effect] | None = None,
    yardstick: str | None = None,
) -> dict[str, Any]:
    """Diagnose a recording (a folder with `task = "mechanism"`, or a log file with `model`).
    Returns the report and, with `out`, writes it with `model.xml`. exclude: effects that are not
    considered; without: trials left out; as_declared: conventions that the motion contradicts are
    taken all the same; effects: the catalogue, ours where None; yardstick: stretches, whole or
    torque, where not the one that tells most is to judge.

    Raises BadInput where the data or the model cannot be read, or the data contradict what is
    declared of their columns.
    """
    began, asked = time.monotonic(), horizon
    if yardstick is not None and yardstick not in NAMES:
        raise BadInput(f"--yardstick {yardstick}: is no yardstick; use {', '.join(NAMES)}")
    notify = progress or (lambda done, total, note: None)
    notify(0.02, 1.0, "reading")
    machine = load(data, model).without(without)
    notify(0.03, 1.0, "conventions")
    warned = () if as_declared else check_conventions(machine)
    if yardstick == WHOLE:
        horizon = 0.98 * min(float(t.time[-1] - t.time[0]) for t in machine.tracks)
    machine = scaled(machine, horizon)
    declared = machine
    machine, off = calibrated(declared, horizon)
    folder = None if out is None else cleared(output_folder(out))
    if folder is None:
        keep = None
    else:

        def keep(partial):
            return write_partial(folder, partial)

    while True:
        if off and yardstick is None:
            span = span_of(machine, off, horizon)
        else:
            span = horizon
        report, evidence, whole = examined(
            machine,
            criteria or Criteria(),
            span,
            exclude,
            notify,
            effects=effects,
            keep=keep,
            yardstick=yardstick,
            narrow=lambda vector, off=off: vector.with_entries(servo_entries(off)),
            first=(lambda problem, null, off=off: friction_first(problem, null, off))
            if off
            else None,
            by_file=declared if off else None,
        )
        stays = still_off(machine, off, whole.found.final.fit.vector)
        if len(stays) == len(off):
            break
        notify(0.05, 1.0, "again with the gains of the file, to which the fit came back")
        machine, off = with_gains(declared, stays), stays
    problem, found = whole.problem, whole.found
    damped_by_file(report["declared"]["after"], declared, off)
    unlike = otherwise(report["declared"]["after"])
    report["notes"] += [*unlike, *gain_notes(machine), *lost(machine, problem, found)]
    report["notes"] += servo_notes(machine, declared, off)
    with_rows(
        report, servo_rows(machine, declared, off, found.final.fit.vector, found.final.spread)
    )
    if unlike and report["verdict"] == "within_noise":
        report["unlike_file"] = unlike[0]
        report["message"] = f"{report['message']} {unlike[0]} {named_by(unlike[0])}"
    checked = check_signals(machine)
    report["warnings"] = [*(f.message for f in warned), *checked.warnings]
    report["notes"] += checked.limits
    add_trials(report, evidence, mechanism_trials(machine), channels(machine))
    checked = replace(checked, findings=(*warned, *checked.findings))
    evidence["audit"] = checked.rows + evidence["audit"]
    command = command_of(
        data,
        out=out,
        model=model,
        exclude=exclude,
        without=without,
        as_declared=as_declared,
        yardstick=yardstick,
        horizon=None if asked == HORIZON else asked,
        simulator="tree"
        if machine.log.meta.simulator == "mujoco" or machine.log.meta.channels
        else None,
    )
    report["run"] = evidence["run"] = Run(command, began).as_dict()
    if folder is not None:
        summary = (
            {k: report[k] for k in ("verdict", "message")} | {"data": str(data)} | report["run"]
        )

        def text():
            return model_toml.text_of(
                problem, found.final, summary, gains(machine), servos(machine)
            )

        write_all(
            folder,
            report,
            evidence,
            page or plain,
            {MODEL_FILE: text, **mjcf_files(machine, whole, criteria or Criteria())},
            verifier(data, model, folder, declared, without),
        )
    return check(report)


def verifier(
    data: str | Path,
    model: str | Path | None,
    folder: Path,
    declared: Machine,
    without: Sequence[str],
) -> Callable[[Path], dict[str, Any]]:
    """What runs the files of `folder` beside the declared one: over whole trials, too, of a machine
    that follows commands.
    """
    spans = {f"stretches of {STRETCH:g} s": STRETCH}
    if follows(declared):
        spans[WHOLE_TRIALS] = 0.0
    if declared.gain_unknown:  # the file's motors say nothing of a voltage or a current
        model = folder / model_toml.DECLARED
    return recommended(data, model, "tree", spans, without)


def with_rows(report: dict[str, Any], rows: Sequence[dict[str, Any]]) -> None:
    """Put what had to be found before the search among the effects of a report, in place."""
    if rows:
        with_effects(report, [*rows, *report["effects"]])
        sizes = [(row["where"], row["parameters"]["kp"]) for row in rows]
        where = ", ".join(f"{joint} {kp['value']:.3g} {kp['unit']}" for joint, kp in sizes)
        rest = report["message"].replace("Nothing need be added", "Nothing more need be added")
        report["message"] = f"kp is not the file's: {where}. {rest}"


def mjcf_files(
    machine: Machine, whole: Examined, criteria: Criteria
) -> dict[str, Callable[[], str]]:
    """What makes the text of `declared.xml` and of `model.xml`."""
    problem, found = whole.problem, whole.found
    by_torque = whole.by_torque if whole.judge == TORQUE else None

    def made():
        return changes(
            machine, problem, holdable(machine, problem, found, criteria, by_torque), found.final
        )

    return {
        model_toml.DECLARED: lambda: mended_mjcf(machine.mechanism, declared_changes(machine)),
        MODEL: lambda: mended_mjcf(machine.mechanism, made()),
    }


def examined(
    machine: Machine,
    criteria: Criteria,
    horizon: float,
    exclude: Sequence[str] = (),
    notify: Progress = lambda done, total, note: None,
    narrow: Callable[[Vector], Vector] = lambda vector: vector,
    effects: Sequence[Effect] | None = None,
    keep: Callable[[dict[str, Any]], None] | None = None,
    yardstick: str | None = None,
    torques: bool = True,
    first: Callable[[TreeProblem, Vector], Hint] | None = None,
    by_file: Machine | None = None,
) -> tuple[dict[str, Any], dict[str, Any], Examined]:
    """Report, evidence for its page, and what was found of a machine. narrow: of the vector that is
    fitted, what is kept; effects: the catalogue, ours where None (of another, what is always fitted
    is ours); keep: told of the report so far, as the search goes; yardstick: by which to judge, the
    one that tells most where None; torques: whether their balance is looked at; first: makes what
    the search goes on from; by_file: the machine by the gains of its file, where `machine` has
    others: what the declared model leaves is told of it.
    """
    # whatever is named
    fitted = {VISCOUS.name}
    if machine.gain_unknown:
        fitted.add(TORQUE_GAIN.name)
    if machine.servo_times:
        fitted.add(POSITION_GAIN.name)
    if effects is None:
        known = MACHINE
    else:
        known = (*(e for e in MACHINE if e.name in fitted), *effects)
    everywhere, at_joints = excluded_of(exclude, known, machine.tree.joint_names)
    chosen = tuple(e for e in known if e.name not in everywhere or e.name in fitted)
    problem = replace(posed(machine, chosen, horizon), excluded=at_joints)

    def step(note):
        return notify(0.0, np.inf, note)  # how many follow, nobody knows

    notify(0.05, 1.0, "declared model")
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # of stretches that run away, which the search expects
        null = narrow(declared_vector(machine, problem))

        def partial(found):
            if keep:
                return keep(reported(machine, problem, found, criteria, horizon))
            return None

        factor = factor_of(machine.log.meta) if torques else None
        hint = first(problem, null) if first else None
        found = examine(
            machine, problem, null, criteria, horizon, step, partial, yardstick, factor, hint
        )
        if by_file is not None:
            before = posed(by_file, chosen, horizon)
            found = with_null(
                found, fitted_null(before, declared_vector(by_file, before), criteria), horizon
            )
        elif (
            not found.found.named
        ):  # how rows are read is no mend: the declared model is what it is with it
            found = with_null(found, found.found.final, horizon)
        report, evidence = report_of(machine, found, criteria, horizon)
    return report, evidence, found


def excluded_of(
    exclude: Sequence[str], known: Sequence[Effect], joints: Sequence[str]
) -> tuple[set[str], frozenset[tuple[str, int]]]:
    """What `--exclude` names: effects (`coulomb`), and effects at a joint (`coulomb at elbow`).

    Raises BadInput where there is no such effect, or no such joint.
    """
    names, everywhere, at_joints = {e.name for e in known}, set(), set()
    for text in exclude:
        name, _, joint = text.partition(" at ")
        if name not in names:
            listed = ", ".join(sorted(names))
            raise BadInput(f"--exclude: {name!r} is no effect of a mechanism; it has {listed}")
        if joint and joint not in joints:
            raise BadInput(f"--exclude: no joint is named {joint!r}; it has {', '.join(joints)}")
        if joint:
            at_joints.add((name, list(joints).index(joint)))
        else:
            everywhere.add(name)
    return everywhere, frozenset(at_joints)


def posed(machine: Machine, effects: Sequence[Effect], horizon: float) -> TreeProblem:
    """The problem of a machine in stretches of `horizon` s."""
    problem = prepare(
        machine.tree,
        machine.tracks,
        effects,
        machine.actuator,
        machine.gear,
        horizon,
        declared=machine.declared,
        look_back=LOOK_BACK,
        ties=machine.ties,
    )
    names = machine.tree.joint_names
    return replace(problem, unlike=tuple(names.index(j) for j in machine.log.unlike if j in names))


def factor_of(meta: Any) -> float:
    """Within which masses and moments are taken to be those of the model file, along the measured
    motion. Raises BadInput.
    """
    factor = meta.fit.get("factor", FACTOR)
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
    problem = prepare(
        machine.tree,
        machine.tracks,
        MACHINE,
        machine.actuator,
        machine.gear,
        horizon,
        declared=machine.declared,
    )
    vector = fit(problem, declared_vector(machine, problem), rounds=15).vector
    law = machine.actuator.copy()
    for e, value in zip(vector.entries, vector.values, strict=True):
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
    problem = prepare(
        machine.tree,
        machine.tracks,
        MACHINE,
        machine.actuator,
        machine.gear,
        declared=machine.declared,
    )
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
    if problem.offers(DAMPING_STEP) and np.any(held(machine.actuator)) and not machine.servo_times:
        widest = Criteria.least_shift * problem.reach.dt
        # s, in which damping stops each joint
        stops = own_inertia(problem, vector)[0] / np.maximum(
            problem.declared[DAMPING_STEP, "damping"], 1e-12
        )
        for g in problem.groups:
            early = min(
                widest, LEFT * np.min(stops[list(g.joints)])
            )  # by more, and a joint would weigh less than nothing
            step = Entry(DAMPING_STEP, "step", g.joints, 0.0, 0.0, -early, widest, "s", widest)
            vector = vector.with_entries([step])
    if machine.gain_unknown:
        # free, gain and inertias shrink together
        if machine.gain_estimated:
            prior = ESTIMATED_GAIN
        else:
            prior = np.inf
        gain = [
            Entry(TORQUE_GAIN.name, "gain", (j,), 0.0, 0.0, -0.95, 20.0, "1", prior)
            for j in range(problem.joints)
        ]
        vector = vector.with_entries(gain)
    return vector
