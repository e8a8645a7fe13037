"""Diagnose a recording of any mechanism: which effects its model file lacks, what is left, and a better model file."""

import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import adaptsim_jax
from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.catalogue import MACHINE
from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.estimate import fit, run
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.mend import changes, declared_changes, holdable
from adaptsim_jax.attribution.parameters import INERTIA, Entry, Vector
from adaptsim_jax.attribution.problem import TILT, Problem, nuisances, prepare
from adaptsim_jax.attribution.score import Candidate
from adaptsim_jax.attribution.select import Model, Named, Selection, select
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder, write_bytes, write_json
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.mechanisms.mjcf_write import mended_mjcf
from adaptsim_jax.sysid.report.schema import check, new_report

Page = Callable[[Path, dict[str, Any], dict[str, Any]], None]
Progress = Callable[[float, float, str], None]
HORIZON = 0.5  # s
MODEL = "model.xml"
OTHERS = ("leading.toml", "next_experiment.csv")  # of an earlier run of another kind into the same folder


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
) -> dict[str, Any]:
    """Diagnose a recording (a folder with `task = "mechanism"`, or a log file with `model`); returns the report and, with `out`,
    writes it with `model.xml`. exclude: effects that are not considered; without: trials left out;
    as_declared: conventions that the motion contradicts are taken all the same.

    Raises BadInput where the data or the model cannot be read, or the data contradict what is declared of their columns.
    """
    began = time.monotonic()
    say = progress or (lambda done, total, note: None)
    say(0.02, 1.0, "reading")
    machine = load(data, model).without(without)
    say(0.03, 1.0, "conventions")
    warned = () if as_declared else check_conventions(machine)
    machine = scaled(machine, horizon)
    folder = None if out is None else output_folder(out)
    report, evidence, problem, found = examined(machine, criteria or Criteria(), horizon, exclude, say)
    report["warnings"] = [f.message for f in warned]
    evidence["audit"] = [{"severity": f.severity, "where": f.where, "message": f.message} for f in warned] + evidence[
        "audit"
    ]
    report["run"] = evidence["run"] = {
        "version": adaptsim_jax.__version__, "seed": 0, "command": command_of(data, model, exclude, without),
        "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip
    report = check(report)
    if folder is not None:
        told = {k: report[k] for k in ("verdict", "message")} | {"data": str(data)} | report["run"]
        write_mjcf(folder, machine, problem, found, criteria or Criteria())
        write_bytes(folder / model_toml.FILE, model_toml.text_of(problem, found.final, told).encode())
        (page or plain)(folder, report, evidence)
    return report


def command_of(data: str | Path, model: str | Path | None, exclude: Sequence[str], without: Sequence[str]) -> str:
    """The command that gives the same answer."""
    words = ["adaptsim", "diagnose", str(data), "--out", "again"]
    words += ["--model", str(model)] if model is not None else []
    for flag, names in (("--exclude", exclude), ("--without", without)):
        words += [flag, *names] if names else []
    return shlex.join(words)


def write_mjcf(folder: Path, machine: Machine, problem: Problem, found: Selection, criteria: Criteria) -> None:
    """`declared.xml` and `model.xml` into the folder; what an earlier run of another kind left there goes."""
    for name in (*OTHERS, MODEL):
        (folder / name).unlink(missing_ok=True)
    made = changes(machine, problem, holdable(machine, problem, found, criteria), found.final)
    write_bytes(folder / model_toml.DECLARED, mended_mjcf(machine.mechanism, declared_changes(machine)).encode())
    write_bytes(folder / MODEL, mended_mjcf(machine.mechanism, made).encode())


def plain(folder: Path, report: dict[str, Any], evidence: dict[str, Any]) -> None:
    """`report.json` alone."""
    write_json(folder / "report.json", report)


def examined(
    machine: Machine,
    criteria: Criteria,
    horizon: float,
    exclude: Sequence[str] = (),
    say: Progress = lambda done, total, note: None,
    narrow: Callable[[Vector], Vector] = lambda vector: vector,
) -> tuple[dict[str, Any], dict[str, Any], Problem, Selection]:
    """Report, evidence for its page, problem and search of a machine. narrow: of the vector that is fitted, what is kept."""
    names = {e.name for e in MACHINE}
    if strange := sorted(set(exclude) - names):
        raise BadInput(f"--exclude: {strange[0]!r} is no effect of a mechanism; it has {', '.join(sorted(names))}")
    effects = tuple(e for e in MACHINE if e.name not in exclude or e.name == "viscous")
    problem = prepare(
        machine.tree, machine.tracks, effects, machine.actuator, machine.gear, horizon, declared=machine.declared
    )
    share = [0.05]

    def step(note: str) -> None:
        share[0] += 0.05 * (1.0 - share[0])
        say(share[0], 1.0, note)

    say(0.05, 1.0, "declared model")
    found = select(problem, narrow(declared_vector(machine, problem)), criteria, step)
    return *reported(machine, problem, found, criteria, horizon), problem, found


def scaled(machine: Machine, horizon: float) -> Machine:
    """With the gain of a voltage or current as the declared model's fit has it, so that effects see a torque in N m."""
    if not machine.gain_unknown:
        return machine
    problem = prepare(
        machine.tree, machine.tracks, MACHINE, machine.actuator, machine.gear, horizon, declared=machine.declared
    )
    vector = fit(problem, declared_vector(machine, problem), rounds=15).vector
    law = machine.actuator.copy()
    for e, value in zip(vector.entries, vector.values, strict=True):
        if e.owner == "torque_gain":
            law[0, list(e.joints)] *= 1.0 + value
    return replace(machine, actuator=law)


def declared_vector(machine: Machine, problem: Problem) -> Vector:
    """What is fitted whatever is named: inertias and damping unless `[fit]` in meta.toml says otherwise, and the gain of volts."""
    meta = machine.log.meta
    for table, key in (("fit", k) for k in meta.fit):
        if key not in ("inertias", "damping"):
            raise BadInput(
                f"{meta.path}: [{table}] {key} is unknown; use inertias or damping (true, false, or a list of names)"
            )
    inertia, damping = meta.fit.get("inertias", True), meta.fit.get("damping", True)
    vector = nuisances(problem, inertia=bool(inertia), damping=bool(damping))
    tree = machine.tree
    for wanted, owner, of in ((inertia, INERTIA, tree.body_names), (damping, "viscous", tree.joint_names)):
        if isinstance(wanted, (list, tuple)):
            if unknown := [n for n in wanted if n not in of]:
                raise BadInput(
                    f"{meta.path}: [fit] names {unknown[0]!r}, which {machine.mechanism.path} has not; it has {', '.join(of)}"
                )
            vector = vector.without(
                [e.key for e in vector.entries if e.owner == owner and of[e.joints[0]] not in wanted]
            )
    if machine.gain_unknown:
        gain = [Entry("torque_gain", "gain", (j,), 0.0, 0.0, -0.95, 20.0, "1") for j in range(problem.joints)]
        vector = vector.with_entries(gain)
    return vector


def place(problem: Problem, c: Candidate) -> str:
    """Where a candidate acts, in words."""
    if c.effect == TILT:
        return "base"
    if len(c.joints) == problem.joints and problem.joints > 1:
        return "all joints"
    return ", ".join(problem.joint_names[j] for j in c.joints)


def held_error(problem: Problem, model: Model) -> np.ndarray:
    """Held-out error of each stretch and joint [W, n], rad or m."""
    return np.sqrt(model.held.squared[: len(problem.fold), : problem.joints])


def _numbers(error: np.ndarray) -> float:
    return float(np.median(error))


def reported(
    machine: Machine, problem: Problem, found: Selection, criteria: Criteria, horizon: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page."""
    before, after = held_error(problem, found.null), held_error(problem, found.final)
    noise = problem.floor[: problem.joints]
    floor = float(np.median(noise))
    over = float(np.median(after / np.maximum(noise, 1e-12)))
    named = found.named
    kind = _kind(named, over, criteria)
    effects = [_effect(problem, found, n) for n in named]
    log = machine.log
    data = {"trials": len(machine.tracks), "samples": log.samples, "held_out_trials": len(np.unique(problem.fold))}
    remaining = {
        "error": _numbers(after), "times_floor": over,
        "joints": {name: {"error": float(np.median(after[:, j])), "times_floor": float(np.median(after[:, j]) / max(noise[j], 1e-12))}
                   for j, name in enumerate(problem.joint_names)},
    }  # fmt: skip
    report = new_report(
        "mechanism", Path(machine.mechanism.path).name, kind, message(problem, found, before, after, over), data,
        effects=effects, error=_error(problem, found, before, after, noise, floor, horizon),
        candidates=_candidates(problem, found),
        declared={"before": _declared(problem, found.null), "after": _declared(problem, found.final)},
        not_established=_doubts(problem, found), remaining=remaining, notes=[*log.notes, *machine.mechanism.notes],
        stages=[{"added": [f"{c.effect} at {place(problem, c)}" for c in m.added], "error": _numbers(held_error(problem, m))}
                for m in (*found.stages, found.final)],
    )  # fmt: skip
    evidence = {"held_out": _held_out(problem, found), "audit": [
        {"severity": "info", "where": "", "message": note} for note in report["notes"]
    ]}  # fmt: skip
    return report, evidence


def _kind(named: tuple[Named, ...], over: float, criteria: Criteria) -> str:
    if not named:
        return "within_noise" if over <= criteria.explained else "structured_unattributed"
    if over > criteria.explained:
        return "partly_explained"
    return "explained_class" if any(n.alternatives for n in named) else "explained"


def message(problem: Problem, found: Selection, before: np.ndarray, after: np.ndarray, over: float) -> str:
    """What was found, in a few sentences."""
    unit = "mrad" if all(k == "hinge" for k in problem.kinds) else "10^-3 rad or m"
    size = lambda e: f"{1e3 * np.median(e):.3g}"
    if not found.named:
        told = f"The declared model, fitted, simulates left-out stretches to {size(before)} {unit}, {over:.1f} times the noise floor."
        return f"{told} No effect of the catalogue holds out." if over > 1.5 else f"{told} Nothing need be added."
    lines = []
    for n in found.named:
        c, t = n.candidate, n.test
        lines.append(
            f"{c.effect.replace('_', ' ')} at {place(problem, c)} holds out in {t.better} of {t.folds} "
            f"(takes {100 * t.gain:.0f} % off the squared error beside all others, p {t.p:.2g})"
        )
    told = "; ".join(lines)
    told = told[:1].upper() + told[1:]
    rest = f"Left-out error {size(before)} to {size(after)} {unit}; what remains is {over:.1f} times the noise floor"
    worst = int(np.argmax(np.median(after, 0) / np.maximum(problem.floor[: problem.joints], 1e-12)))
    where = f", most of it at {problem.joint_names[worst]}" if over > 1.5 and problem.joints > 1 else ""
    return f"{told}. {rest}{where}."


def _effect(problem: Problem, found: Selection, n: Named) -> dict[str, Any]:
    c, model = n.candidate, found.final
    spread = model.spread
    numbers = {}
    for i, e in enumerate(model.fit.vector.entries):
        if e.owner == c.effect and set(e.joints) <= set(c.joints):
            value, width = float(model.fit.vector.values[i]), NINETY * float(spread[i])
            own = len(e.joints) == 1 and len(c.joints) > 1
            key = f"{e.name}[{problem.joint_names[e.joints[0]]}]" if own else e.name
            low, high = max(value - width, min(e.low, value)), min(value + width, max(e.high, value))
            numbers[key] = {"value": value, "low": low, "high": high, "unit": e.unit}
    tilt = c.effect == TILT
    effect = None if tilt else problem.effect(c.effect)
    return {
        "name": c.effect, "where": place(problem, c), "joints": [problem.joint_names[j] for j in c.joints], "parameters": numbers,
        "physics": "gravity pulls along another direction: the base is not level" if effect is None else effect.physics,
        "alternatives": [f"{a.effect}@{place(problem, a)}" for a in n.alternatives],
        "held_out_gain": n.test.gain, "p_value": n.test.p, "better": n.test.better, "folds": n.test.folds,
        "size_over_scatter": min(n.steady, 1e3),
    }  # fmt: skip


def _error(problem: Problem, found: Selection, before, after, noise, floor: float, horizon: float) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    some = bool(found.named)
    pair = lambda pick: {"before": float(np.median(pick(before))), "after": float(np.median(pick(after)))}
    channels = {}
    for j, name in enumerate(problem.joint_names):
        unit = "rad" if problem.kinds[j] == "hinge" else "m"
        channels[name] = {"unit": unit, **pair(lambda e, j=j: e[:, j]), "noise_floor": float(noise[j])}
    per_trial = []
    for k, name in enumerate(problem.folds):
        mine = problem.fold == k
        if mine.any():
            own = {n: pair(lambda e, j=j, mine=mine: e[mine][:, j]) for j, n in enumerate(problem.joint_names)}
            per_trial.append({"trial": name, **pair(lambda e, mine=mine: e[mine]), "per_channel": own})
    draws = rng.integers(0, len(before), (400, len(before)))
    interval = lambda e: [float(z) for z in np.quantile([np.median(e[d]) for d in draws], [0.025, 0.975])]
    hinge = all(k == "hinge" for k in problem.kinds)
    return {
        "metric": f"median over left-out stretches of {horizon:g} s and joints of the RMS error of simulated angles, starts fitted",
        "unit": "rad" if hinge else "1", "stretch_s": horizon, **pair(lambda e: e), "noise_floor": floor, "ceiling": None,
        "per_channel": channels, "per_trial": per_trial, "noise_floor_source": "third differences of the angles",
        "intervals": {"before": interval(before), "after": interval(after) if some else interval(before)},
    }  # fmt: skip


def _candidates(problem: Problem, found: Selection) -> list[dict[str, Any]]:
    names = {(n.candidate.effect, n.candidate.joints) for n in found.named}
    alike = {(a.effect, a.joints) for n in found.named for a in n.alternatives}
    why = {}
    for s in found.trace:
        if s.candidate is not None and s.test is not None and s.action in ("refused", "dropped"):
            why[s.candidate.effect, s.candidate.joints] = (
                f"{s.action}: {s.why}, held-out gain {100 * s.test.gain:.1f} %, p {s.test.p:.2g}"
            )
    total = max(float(found.null.held.loss.sum()), 1e-12)
    rows = []
    for s in found.first:
        key = s.candidate.effect, s.candidate.joints
        if s.held_out <= 0.0 and key not in names | alike:
            continue
        status = "accepted" if key in names else "look-alike" if key in alike else "rejected"
        rows.append({
            "name": key[0], "where": place(problem, s.candidate), "held_out_gain": float(np.clip(s.held_out / total, -1.0, 1.0)),
            "p_value": float(min(1.0, s.p * len(found.first))), "accepted": key in names, "status": status,
            "why": why.get(key, "named" if key in names else "does as well" if key in alike else "gains less than what was taken"),
        })  # fmt: skip
    return rows[:40]


def _declared(problem: Problem, model: Model) -> dict[str, Any]:
    """Fitted inertial parameters by body (mass and what gravity and motion see of it) and dampings."""
    spread = model.spread
    out: dict[str, Any] = {}
    for i, e in enumerate(model.fit.vector.entries):
        if e.owner in (INERTIA, "viscous"):
            value, width = float(model.fit.vector.values[i]), NINETY * float(spread[i])
            name = f"{e.name} of {problem.joint_names[e.joints[0]]}"
            known = e.owner == "viscous" or float(spread[i]) < 0.5 * e.prior
            out[name] = {
                "value": value,
                "low": value - width,
                "high": value + width,
                "unit": e.unit,
                "identifiable": bool(known),
            }
    return out


def _doubts(problem: Problem, found: Selection) -> list[str]:
    out = []
    for s in found.trace:
        if s.action == "dropped" and s.candidate is not None:
            name = f"{s.candidate.effect.replace('_', ' ')} at {place(problem, s.candidate)}"
            out.append(f"{name} helped at first, but does not hold out beside the others ({s.why}).")
    return out


def _held_out(problem: Problem, found: Selection) -> list[Mapping[str, Any]]:
    """Measured and simulated angles, trial by trial, stretches one after the other."""
    pair = [run(problem, m.fit.vector, m.fit.starts) for m in (found.null, found.final)]
    s = problem.groups[0].stretches
    out = []
    for k, name in enumerate(s.names):
        lanes = [w for w in range(len(problem.fold)) if s.trial[w] == k][:12]
        if not lanes:
            continue
        entry: dict[str, Any] = {
            "trial": name,
            "time": np.concatenate([np.append(s.time[:, w], s.time[-1, w]) for w in lanes]),
        }
        flat = lambda z, lanes=lanes: np.concatenate([np.append(z[:, w], np.nan) for w in lanes])
        for key in ("measured", "before", "after"):
            entry[key] = {}
        for g, a, b in zip(problem.groups, *pair, strict=True):
            for at, j in enumerate(g.joints):
                name_j = problem.joint_names[j]
                entry["measured"][name_j] = flat(np.where(g.stretches.seen[:, at] > 0, g.stretches.q[:, at], np.nan))
                entry["before"][name_j], entry["after"][name_j] = flat(a.sensed[:, at]), flat(b.sensed[:, at])
        if not found.named:
            entry["after"] = None
        out.append(entry)
    return out
