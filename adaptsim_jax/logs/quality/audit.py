"""What a log is fit for, before anything is fitted: gaps, stuck sensors, velocities, commands.

A finding of severity `fault` means that no diagnosis should be made of a double pendulum (verdict
`data_fault`); of a machine with a model file all findings warn.
"""

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.criteria import SIGNAL
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.quality import signals
from adaptsim_jax.logs.quality.consistency import lattice_step
from adaptsim_jax.logs.quality.findings import Audit, AuditFinding, finding
from adaptsim_jax.logs.quality.signals import Signal

INPUTS = {"torque": "tau", "command": "ctrl", "voltage": "u", "current": "i", "none": ""}
"""Kind of a log's input -> stem of its columns."""
UNITS = {"torque": "N m", "voltage": "V", "current": "A"}


def audit(
    log: Log, slides: Collection[str] = (), efforts: Mapping[str, int] | None = None
) -> Audit:
    """Check every joint of every trial, then the log as a whole.

    Args:
        log: what was read. It is not changed.
        slides: joints that slide, logged in m.
        efforts: joint -> the column of `u` that drives it; None: those of the same name. Targets of
            servos are none.

    Returns:
        Findings, with rows and trials that should not be used.
    """
    if efforts is None:
        efforts = {name: k for k, name in enumerate(log.input_names) if name in log.driven}
    by_trial = {t.name: list(_signals(log, t, slides, efforts)) for t in log.trials}
    steps = _quantisation([s for own in by_trial.values() for s in own], log.input_kind)
    findings = [_quantised(*row) for row in steps.values() if row[1] > 0]
    sizes = {name: step for name, step, _ in steps.values()}
    valid, broken, still = {}, {}, []
    for trial in log.trials:
        found, valid[trial.name], wrong = _audit_trial(trial, by_trial[trial.name], sizes)
        findings += found
        if wrong:
            broken[trial.name] = wrong
        still += [f.trial for f in found if f.kind == "no_motion"]
    findings += _faults(len(log.trials), broken)
    if len(still) == len(log.trials):
        count = float(len(still))
        findings.append(finding("recording_still", "", "recording", count, still=SIGNAL.still))
    exclude = tuple(t.name for t in log.trials if t.name in broken or t.name in still)
    if log.meta.rig is None:
        findings = [replace(f, severity="warn") if f.severity == "fault" else f for f in findings]
        exclude = ()
    return Audit(tuple(findings), sizes, valid, exclude)


def _signals(
    log: Log, trial: LogTrial, slides: Collection[str], efforts: Mapping[str, int]
) -> Iterator[Signal]:
    """The joints of a trial that have angles enough, where they were read."""
    spans = [np.ptp(q[np.isfinite(q)]) if np.isfinite(q).any() else 0.0 for q in trial.q.T]
    reported = trial.extra.get("tau_commanded")
    for j, joint in enumerate(log.joint_names):
        rows = np.isfinite(trial.q[:, j])
        if trial.v is not None:
            rows &= np.isfinite(trial.v[:, j])
        if rows.sum() < SIGNAL.min_rows:
            continue
        k = efforts.get(joint)
        speed = None if trial.v is None else trial.v[rows, j]
        effort = None if k is None else trial.u[rows, k]
        commanded = None
        if reported is not None and np.isfinite(reported[:, j]).all():
            commanded = reported[rows, j]
        others = [span for i, span in enumerate(spans) if i != j]
        yield Signal(
            trial.name,
            joint,
            log.column("q", joint),
            log.column("v", joint),
            log.column(INPUTS[log.input_kind], joint),
            "m" if joint in slides else "rad",
            trial.time[rows],
            trial.q[rows, j],
            speed,
            effort,
            commanded,
            trial.dt,
            log.meta.rig is not None or joint not in log.driven,
            max(others, default=0.0),
        )


def _audit_trial(
    trial: LogTrial, own: Sequence[Signal], steps: dict[str, float]
) -> tuple[list[AuditFinding], np.ndarray, list[str]]:
    """Findings, rows to use `[T]`, and channels that cannot be used."""
    found = signals.check_sampling(trial.name, trial.time)
    valid, wrong = np.ones(len(trial.time), bool), []
    for s in own:
        step = steps.get(s.q_name, 0.0)
        frozen, moving, stuck = signals.check_frozen(s, step)
        spikes, smooth = signals.check_spikes(s, step)
        velocity, contradicts = signals.check_velocity(s)
        found += frozen + spikes + velocity + signals.check_saturation(s, steps)
        found += signals.check_derived(s) + signals.check_stale(s, step)
        found += signals.check_command(s) + signals.check_excitation(s)
        valid[np.searchsorted(trial.time, s.time[~(moving & smooth)])] = False
        wrong += [s.q_name] * stuck + [s.v_name] * contradicts
    if own and all(np.ptp(s.q) < SIGNAL.still for s in own):
        most = max(float(np.ptp(s.q)) for s in own)
        found.append(finding("no_motion", trial.name, "joints", most, still=SIGNAL.still))
    return found, valid, wrong


def _faults(trials: int, broken: dict[str, list[str]]) -> list[AuditFinding]:
    """A channel that is unusable in most trials is a fault of the recording."""
    found = []
    for channel in sorted({c for wrong in broken.values() for c in wrong}):
        count = sum(channel in wrong for wrong in broken.values())
        if 2 * count <= trials:
            continue
        what = "contradicts the angle's slope"
        if channel.startswith("q"):
            what = "stands still"
        found.append(finding("channel", "", channel, count, what=what, trials=trials))
    return found


def _quantisation(every: Sequence[Signal], kind: str) -> dict[str, tuple[str, float, str]]:
    """By column its name, step and unit.

    The step is the median over the trials in which a lattice shows, if that is most of them.
    """
    steps: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    for s in every:
        force = "N" if kind == "torque" and s.unit == "m" else UNITS.get(kind, "")
        for name, x, unit in (
            (s.q_name, s.q, s.unit),
            (s.u_name, s.u, force),
            (s.v_name, s.v, f"{s.unit}/s"),
        ):
            units[name] = unit
            if x is not None and np.ptp(x):
                steps.setdefault(name, []).append(lattice_step(x))
    out = {}
    for name, sizes in sorted(steps.items()):
        positive = [size for size in sizes if size > 0]
        if 2 * len(positive) > len(sizes):
            step = float(np.median(positive))
        else:
            step = 0.0
        out[name] = (name, step, units[name])
    return out


def _quantised(name: str, step: float, unit: str) -> AuditFinding:
    return finding("quantisation", "", name, step, unit=f" {unit}" if unit else "")


def without_copies(log: Log) -> Log:
    """The log with each distinct trial once, the first of its copies."""
    first: dict[str, LogTrial] = {}
    for trial in log.trials:
        digest = hashlib.sha256()
        for x in (trial.time - trial.time[0], trial.q, trial.u):
            digest.update(np.ascontiguousarray(x).tobytes())
        first.setdefault(digest.hexdigest(), trial)
    return replace(log, trials=tuple(first.values()))


def usable(log: Log, found: Audit) -> Log:
    """What a fit should see: each trial once, without those that the audit excludes.

    Angles are NaN in rows that are not valid. Velocities go where they are mere differences of the
    angles in every trial: beside the angles they would count the same noise twice.
    """
    trials = tuple(t for t in without_copies(log).trials if t.name not in found.exclude)
    derived = {(f.trial, f.where) for f in found.of("velocity_derived")}
    names = [log.column("v", joint) for joint in log.joint_names]
    if trials and all((t.name, name) in derived for t in trials for name in names):
        trials = tuple(replace(t, v=None) for t in trials)
    hidden = {t.name: found.valid.get(t.name, np.ones(len(t.time), bool)) for t in trials}
    trials = tuple(replace(t, q=np.where(hidden[t.name][:, None], t.q, np.nan)) for t in trials)
    return replace(log, trials=trials)
