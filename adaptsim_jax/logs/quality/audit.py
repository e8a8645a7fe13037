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
    steps = _quantisation(
        [s for trial_signals in by_trial.values() for s in trial_signals], log.input_kind
    )
    findings = [_quantised(*row) for row in steps.values() if row[1] > 0]
    sizes = {name: step for name, step, _ in steps.values()}
    valid, broken, still_trials = {}, {}, []
    for trial in log.trials:
        trial_findings, valid[trial.name], broken_channels = _audit_trial(
            trial, by_trial[trial.name], sizes
        )
        findings += trial_findings
        if broken_channels:
            broken[trial.name] = broken_channels
        still_trials += [f.trial for f in trial_findings if f.kind == "no_motion"]
    findings += _faults(len(log.trials), broken)
    if len(still_trials) == len(log.trials):
        count = float(len(still_trials))
        findings.append(
            finding("recording_still", "", "recording", count, still=SIGNAL.max_still_range)
        )
    exclude = tuple(t.name for t in log.trials if t.name in broken or t.name in still_trials)
    if log.meta.rig is None:
        findings = [replace(f, severity="warn") if f.severity == "fault" else f for f in findings]
        exclude = ()
    return Audit(tuple(findings), sizes, valid, exclude)


def _signals(
    log: Log, trial: LogTrial, slides: Collection[str], efforts: Mapping[str, int]
) -> Iterator[Signal]:
    """The joints of a trial that have angles enough, where they were read."""
    spans = [np.ptp(q[np.isfinite(q)]) if np.isfinite(q).any() else 0.0 for q in trial.q.T]
    commanded_torque = trial.extra.get("tau_commanded")
    for j, joint in enumerate(log.joint_names):
        rows = np.isfinite(trial.q[:, j])
        if trial.v is not None:
            rows &= np.isfinite(trial.v[:, j])
        if rows.sum() < SIGNAL.min_rows:
            continue
        k = efforts.get(joint)
        speed = None if trial.v is None else trial.v[rows, j]
        effort = None if k is None else trial.u[rows, k]
        command = None
        if commanded_torque is not None and np.isfinite(commanded_torque[:, j]).all():
            command = commanded_torque[rows, j]
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
            command,
            trial.dt,
            log.meta.rig is not None or joint not in log.driven,
            max(others, default=0.0),
        )


def _audit_trial(
    trial: LogTrial, trial_signals: Sequence[Signal], steps: dict[str, float]
) -> tuple[list[AuditFinding], np.ndarray, list[str]]:
    """Findings, rows to use `[T]`, and channels that cannot be used."""
    findings = signals.check_sampling(trial.name, trial.time)
    is_valid, broken = np.ones(len(trial.time), bool), []
    for s in trial_signals:
        step = steps.get(s.q_name, 0.0)
        frozen, is_moving, stuck = signals.check_frozen(s, step)
        spikes, is_smooth = signals.check_spikes(s, step)
        velocity, contradicts = signals.check_velocity(s)
        findings += frozen + spikes + velocity + signals.check_saturation(s, steps)
        findings += signals.check_derived(s) + signals.check_stale(s, step)
        findings += signals.check_command(s) + signals.check_excitation(s)
        is_valid[np.searchsorted(trial.time, s.time[~(is_moving & is_smooth)])] = False
        broken += [s.q_name] * stuck + [s.v_name] * contradicts
    if trial_signals and all(np.ptp(s.q) < SIGNAL.max_still_range for s in trial_signals):
        largest = max(float(np.ptp(s.q)) for s in trial_signals)
        findings.append(
            finding("no_motion", trial.name, "joints", largest, still=SIGNAL.max_still_range)
        )
    return findings, is_valid, broken


def _faults(n_trials: int, broken: dict[str, list[str]]) -> list[AuditFinding]:
    """A channel that is unusable in most trials is a fault of the recording."""
    findings = []
    for channel in sorted({c for channels in broken.values() for c in channels}):
        count = sum(channel in channels for channels in broken.values())
        if 2 * count <= n_trials:
            continue
        what = "contradicts the angle's slope"
        if channel.startswith("q"):
            what = "stands still"
        findings.append(finding("channel", "", channel, count, what=what, trials=n_trials))
    return findings


def _quantisation(all_signals: Sequence[Signal], kind: str) -> dict[str, tuple[str, float, str]]:
    """Return by column its name, step of quantisation and unit.

    The step is the median over the trials in which a lattice shows, if that is most of them.
    """
    steps: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    for s in all_signals:
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


def usable(log: Log, checked: Audit) -> Log:
    """What a fit should see: each trial once, without those that the audit excludes.

    Angles are NaN in rows that are not valid. Velocities go where they are mere differences of the
    angles in every trial: beside the angles they would count the same noise twice.
    """
    trials = tuple(t for t in without_copies(log).trials if t.name not in checked.exclude)
    derived = {(f.trial, f.where) for f in checked.of("velocity_derived")}
    names = [log.column("v", joint) for joint in log.joint_names]
    if trials and all((t.name, name) in derived for t in trials for name in names):
        trials = tuple(replace(t, v=None) for t in trials)
    is_valid = {t.name: checked.valid.get(t.name, np.ones(len(t.time), bool)) for t in trials}
    trials = tuple(replace(t, q=np.where(is_valid[t.name][:, None], t.q, np.nan)) for t in trials)
    return replace(log, trials=trials)
