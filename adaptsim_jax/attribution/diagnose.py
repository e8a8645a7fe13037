"""Diagnose a recording of any mechanism: which effects its model file lacks, what is left, and a
better model file.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.conventions import (
    channels,
    check_conventions,
    check_signals,
    mechanism_trials,
)
from adaptsim_jax.attribution.criteria import CHOICE, PRIOR_WIDTH, STRETCH
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.commands import drive_gains
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.examine import (
    Examined,
    Inquiry,
    examine,
    reported,
    so_far,
    with_null,
)
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import NAMES, TORQUE, WHOLE
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
from adaptsim_jax.attribution.physical_inertias import named_by, otherwise
from adaptsim_jax.attribution.problem import TreeProblem, held, nuisances, own_inertia, prepare
from adaptsim_jax.attribution.replay import follows, recommended
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
from adaptsim_jax.attribution.tree_objective import Hint
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.schema import with_effects
from adaptsim_jax.diagnosis.written import Output, cleared, finished, write_partial
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import POSITION_GAIN, TORQUE_GAIN
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.friction import VISCOUS
from adaptsim_jax.logs.quality.findings import AuditFinding
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.mend.mjcf import mended_mjcf
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE

Progress = Callable[[float, float, str], None]
Keep = Callable[[dict[str, Any]], None]
HORIZON = CHOICE.horizon
MODEL = "model.xml"


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
    Returns the report and, with `out`, writes it with `model.xml`.

    Raises BadInput where the data or the model cannot be read, or the data contradict what is
    declared of their columns.

    Args:
        exclude: Effects that are not considered.
        without: Trials left out.
        as_declared: Conventions that the motion contradicts are taken all the same.
        effects: The catalogue, ours where None.
        yardstick: Stretches, whole or torque, where not the one that tells most is to judge.
    """
    began = time.monotonic()
    setting = DiagnosisSetting(criteria or Criteria(), horizon, tuple(exclude), effects, yardstick)
    notify = progress or (lambda done, total, note: None)
    notify(0.02, 1.0, "reading")
    declared = load(data, model).without(without)
    notify(0.03, 1.0, "conventions")
    warned = () if as_declared else check_conventions(declared)
    if yardstick == WHOLE:
        span = 0.98 * min(float(t.time[-1] - t.time[0]) for t in declared.tracks)
        setting = replace(setting, horizon=span)
    declared = scaled(declared, setting.horizon)
    folder = None if out is None else cleared(output_folder(out))
    keep = None if folder is None else partial(write_partial, folder)
    machine, off, found = _with_own_gains(declared, setting, notify, keep)
    report, evidence = reported(found)
    _of_the_file(report, machine, declared, off, found)
    _of_the_signals(report, evidence, machine, warned)
    command = command_of(
        data,
        out=out,
        model=model,
        exclude=exclude,
        without=without,
        as_declared=as_declared,
        yardstick=yardstick,
        horizon=None if horizon == HORIZON else horizon,
        simulator=_simulator_asked(machine),
    )
    run = Run(command, began)
    files = _files(report, machine, found, {"data": str(data), **run.as_dict()})
    verify = None if folder is None else verifier(data, model, folder, declared, without)
    return finished(report, evidence, run, Output(folder, page, files, verify))


def _with_own_gains(
    declared: Machine, setting: "DiagnosisSetting", notify: Progress, keep: Keep | None
) -> tuple[Machine, dict[int, float], Examined]:
    """The machine with the kp that its motion shows, factors on the file's by joint, and what was
    found of it. A joint whose fit comes back to the file's kp keeps that.
    """
    machine, off = calibrated(declared, setting.horizon)
    while True:
        found = _examined_with(machine, off, declared, setting, notify, keep)
        stays = still_off(machine, off, found.found.final.fit.vector)
        if len(stays) == len(off):
            return machine, off, found
        notify(0.05, 1.0, "again with the gains of the file, to which the fit came back")
        machine, off = with_gains(declared, stays), stays


def _examined_with(
    machine: Machine,
    off: dict[int, float],
    declared: Machine,
    setting: "DiagnosisSetting",
    notify: Progress,
    keep: Keep | None,
) -> Examined:
    if not off:
        return examined(machine, setting, Beginning(), notify, keep)
    if setting.objective is None:
        setting = replace(setting, horizon=span_of(machine, off, setting.horizon))
    beginning = Beginning(
        lambda vector: vector.with_entries(servo_entries(off)),
        lambda problem, null: friction_first(problem, null, off),
        declared,
    )
    return examined(machine, setting, beginning, notify, keep)


def _of_the_file(
    report: dict[str, Any],
    machine: Machine,
    declared: Machine,
    off: dict[int, float],
    e: Examined,
) -> None:
    """Put into a report how the machine differs from its model file, in place."""
    damped_by_file(report["declared"]["after"], declared, off)
    unlike = otherwise(report["declared"]["after"])
    report["notes"] += [*unlike, *gain_notes(machine), *lost(machine, e.problem, e.found)]
    report["notes"] += servo_notes(machine, declared, off)
    final = e.found.final
    with_rows(report, servo_rows(machine, declared, off, final.fit.vector, final.spread))
    if unlike and report["verdict"] == "within_noise":
        report["unlike_file"] = unlike[0]
        report["message"] = f"{report['message']} {unlike[0]} {named_by(unlike[0])}"


def _of_the_signals(
    report: dict[str, Any],
    evidence: dict[str, Any],
    machine: Machine,
    warned: tuple[AuditFinding, ...],
) -> None:
    """Put into a report, and what its page gets, what the signals say of themselves, in place."""
    checked = check_signals(machine)
    report["warnings"] = [*(f.message for f in warned), *checked.warnings]
    report["notes"] += checked.limits
    add_trials(report, evidence, mechanism_trials(machine), channels(machine))
    checked = replace(checked, findings=(*warned, *checked.findings))
    evidence["audit"] = checked.rows + evidence["audit"]


def _simulator_asked(machine: Machine) -> str | None:
    """The simulator that the command has to name, for meta.toml says another."""
    meta = machine.log.meta
    return "tree" if meta.simulator == "mujoco" or meta.channels else None


def _files(
    report: dict[str, Any], machine: Machine, e: Examined, run: dict[str, Any]
) -> dict[str, Callable[[], str]]:
    """What makes the text of each file that holds the model."""
    summary = {k: report[k] for k in ("verdict", "message")} | run

    def text():
        final = e.found.final
        return model_toml.text_of(e.problem, final, summary, gains(machine), servos(machine))

    return {MODEL_FILE: text, **mjcf_files(e)}


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
    spans = {f"stretches of {CHOICE.horizon:g} s": CHOICE.horizon}
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
    horizon: float = HORIZON
    exclude: tuple[str, ...] = ()
    effects: Sequence[Effect] | None = None
    objective: str | None = None
    torques: bool = True

    def __post_init__(self) -> None:
        if self.objective is not None and self.objective not in NAMES:
            named = f"--yardstick {self.objective}"
            raise BadInput(f"{named}: is no yardstick; use {', '.join(NAMES)}")


@dataclass(frozen=True)
class Beginning:
    """With what a search begins.

    Args:
        narrow: What stays of the vector that is fitted whatever is named.
        first: Makes values and effects that the search goes on from.
        by_file: The machine by the gains of its file, where others were found: what the declared
            model leaves is reported of it.
    """

    narrow: Callable[[Vector], Vector] = lambda vector: vector
    first: Callable[[TreeProblem, Vector], Hint] | None = None
    by_file: Machine | None = None


@np.errstate(over="ignore", invalid="ignore")  # of stretches that run away, as a search expects
def examined(
    machine: Machine,
    setting: DiagnosisSetting = DiagnosisSetting(),
    beginning: Beginning = Beginning(),
    notify: Progress = lambda done, total, note: None,
    keep: Keep | None = None,
) -> Examined:
    """What was found of a machine. keep: called with the report so far, as the search goes."""
    chosen, at_joints = _catalogue_of(machine, setting)
    problem = replace(posed(machine, chosen, setting.horizon), excluded=at_joints)
    notify(0.05, 1.0, "declared model")
    null = beginning.narrow(declared_vector(machine, problem))
    inquiry = Inquiry(
        machine,
        problem,
        null,
        setting.criteria,
        setting.horizon,
        lambda note: notify(0.0, np.inf, note),  # how many follow, nobody knows
        asked=setting.objective,
        factor=factor_of(machine.log.meta) if setting.torques else None,
        hint=beginning.first(problem, null) if beginning.first else None,
    )
    found = examine(inquiry if keep is None else _reporting(inquiry, keep))
    if beginning.by_file is not None:
        before = posed(beginning.by_file, chosen, setting.horizon)
        vector = declared_vector(beginning.by_file, before)
        return with_null(found, fitted_null(before, vector, setting.criteria))
    if not found.found.named:
        # how rows are read is no mend: the declared model is what it is with it
        return with_null(found, found.found.final)
    return found


def _reporting(inquiry: Inquiry, keep: Keep) -> Inquiry:
    """An inquiry that gives the report so far to `keep`."""
    return replace(inquiry, keep=lambda found: keep(so_far(inquiry, found)))


def _catalogue_of(
    machine: Machine, setting: DiagnosisSetting
) -> tuple[tuple[Effect, ...], frozenset[tuple[str, int]]]:
    """Effects that are considered or always fitted, and those that are left out at a joint."""
    fitted = {VISCOUS.name}
    if machine.gain_unknown:
        fitted.add(TORQUE_GAIN.name)
    if machine.servo_times:
        fitted.add(POSITION_GAIN.name)
    known = MACHINE
    if setting.effects is not None:
        known = (*(e for e in MACHINE if e.name in fitted), *setting.effects)
    everywhere, at_joints = excluded_of(setting.exclude, known, machine.tree.joint_names)
    chosen = tuple(e for e in known if e.name not in everywhere or e.name in fitted)
    return chosen, at_joints


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
        look_back=STRETCH.look_back,
        ties=machine.ties,
    )
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
        widest = Criteria.min_shift * problem.reach.dt
        # s, in which damping stops each joint
        stops = own_inertia(problem, vector)[0] / np.maximum(
            problem.declared[DAMPING_STEP, "damping"], 1e-12
        )
        for g in problem.groups:
            early = min(
                widest, PRIOR_WIDTH.min_inertia * np.min(stops[list(g.joints)])
            )  # by more, and a joint would weigh less than nothing
            step = Entry(DAMPING_STEP, "step", g.joints, 0.0, 0.0, -early, widest, "s", widest)
            vector = vector.with_entries([step])
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
