"""What a recording is fit for, before anything is fitted: gaps, stuck sensors, velocities,
commands.

A finding of severity `fault` means that no diagnosis should be made (verdict `data_fault`); trials
that cannot be used while the others can are listed in `exclude`, single rows in `valid`.
"""

import hashlib
from dataclasses import replace

import numpy as np

from adaptsim_jax.logs.quality import signals, timing
from adaptsim_jax.logs.quality.consistency import lattice_step
from adaptsim_jax.logs.quality.conventions import check_angle_zero
from adaptsim_jax.logs.quality.findings import Audit, Finding
from adaptsim_jax.logs.quality.turns import without_turns
from adaptsim_jax.logs.types import Recording, Trial


def audit(recording: Recording) -> Audit:
    """Check every trial, then the recording as a whole. Pure; the recording is not changed."""
    steps = _quantisation(recording)
    findings: list[Finding] = [_quantised(c, s) for c, s in steps.items() if s > 0]
    valid, broken = {}, {}
    for trial in recording.trials:
        found, keep, wrong = _audit_trial(trial, steps)
        findings += found
        valid[trial.name] = keep
        if wrong:
            broken[trial.name] = wrong
    findings += _duplicates(recording)
    findings += check_angle_zero(recording)
    findings += _faults(recording, broken)
    still = [f.trial for f in findings if f.kind == "no_motion"]
    exclude = tuple(t.name for t in recording.trials if t.name in broken or t.name in still)
    if len(still) == len(recording.trials):
        text = "no trial moves the arm by more than 0.02 rad: nothing can be learned from this recording"
        findings.append(Finding("no_motion", "fault", "", "recording", text, float(len(still))))
    return Audit(tuple(findings), steps, valid, exclude)


def _audit_trial(
    trial: Trial, steps: dict[str, float]
) -> tuple[list[Finding], np.ndarray, list[str]]:
    """Findings, rows to keep, and channels that cannot be used."""
    wrapped = signals.check_wrap(trial)
    trial = unwrap_trial(trial)
    frozen, moving, stuck = signals.check_frozen(trial, steps)
    spikes, smooth = signals.check_spikes(trial, steps)
    velocity, wrong = signals.check_velocity(trial)
    found = (
        signals.check_sampling(trial)
        + wrapped
        + frozen
        + spikes
        + signals.check_saturation(trial, steps)
    )
    found += (
        timing.check_timestamps(trial)
        + timing.check_derived(trial)
        + timing.check_stale(trial, steps)
    )
    found += velocity + signals.check_command(trial) + signals.check_excitation(trial)
    return found, moving & smooth, stuck + wrong


def _faults(recording: Recording, broken: dict[str, list[str]]) -> list[Finding]:
    """A channel that is unusable in most trials is a fault of the recording."""
    found = []
    for channel in sorted({c for wrong in broken.values() for c in wrong}):
        count = sum(channel in wrong for wrong in broken.values())
        if 2 * count > len(recording.trials):
            if channel.startswith("q"):
                what = "stands still"
            else:
                what = "contradicts the angle's slope"
            share = f"{count} of {len(recording.trials)} trials"
            text = f"{channel} {what} in {share}: check its sensor, sign and unit"
            found.append(Finding("channel", "fault", "", channel, text, float(count)))
    return found


def _quantisation(recording: Recording) -> dict[str, float]:
    """Step by channel: the median over trials in which a lattice shows, if that is most of them."""
    steps: dict[str, list[float]] = {}
    for trial in recording.trials:
        columns = {"q": trial.q, "tau": trial.torque} | ({} if trial.v is None else {"v": trial.v})
        for stem, x in columns.items():
            for j in range(2):
                steps.setdefault(f"{stem}{j + 1}", []).append(
                    lattice_step(x[:, j]) if np.ptp(x[:, j]) else np.nan
                )
    out = {}
    for channel, seen in sorted(steps.items()):
        known = [s for s in seen if np.isfinite(s)]
        positive = [s for s in known if s > 0]
        if 2 * len(positive) > len(known):
            out[channel] = float(np.median(positive))
        else:
            out[channel] = 0.0
    return out


def _quantised(channel: str, step: float) -> Finding:
    unit = {"q": "rad", "v": "rad/s", "t": "N m"}[channel[0]]
    return Finding(
        "quantisation",
        "info",
        "",
        channel,
        f"{channel} is quantised in steps of {step:.4g} {unit}",
        step,
    )


def _fingerprint(trial: Trial) -> str:
    digest = hashlib.sha256()
    for x in (trial.time - trial.time[0], trial.q, trial.torque):
        digest.update(np.ascontiguousarray(x).tobytes())
    return digest.hexdigest()


def _groups(recording: Recording) -> dict[str, list[Trial]]:
    groups: dict[str, list[Trial]] = {}
    for trial in recording.trials:
        groups.setdefault(_fingerprint(trial), []).append(trial)
    return groups


def _duplicates(recording: Recording) -> list[Finding]:
    found = []
    for group in _groups(recording).values():
        for copy in group[1:]:
            text = f"is a copy of {group[0].name}: it is counted once"
            found.append(Finding("duplicate", "warn", copy.name, "trial", text, 1.0))
    return found


def without_duplicates(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """The recording with each distinct trial once (the first of its copies), and the names
    dropped.
    """
    kept = [group[0].name for group in _groups(recording).values()]
    trials = tuple(t for t in recording.trials if t.name in kept)
    dropped = tuple(t.name for t in recording.trials if t.name not in kept)
    return replace(recording, trials=trials), dropped


def unwrap_trial(trial: Trial) -> Trial:
    """The trial with jumps of whole turns taken out of its angles."""
    return replace(
        trial, q=np.stack([without_turns(trial.time, trial.q[:, j]).q for j in range(2)], axis=1)
    )


def unwrapped(recording: Recording) -> Recording:
    """The recording with all angles continuous."""
    return replace(recording, trials=tuple(unwrap_trial(t) for t in recording.trials))


def usable(recording: Recording, found: Audit) -> Recording:
    """What the fit should see: unwrapped, each trial once, without those that the audit excludes.

    Velocities go too where they are mere differences of the angles in every trial: used beside the
    angles they would count the same noise twice.
    """
    single, _ = without_duplicates(unwrapped(recording))
    trials = tuple(t for t in single.trials if t.name not in found.exclude)
    derived = {(f.trial, f.where) for f in found.of("velocity_derived")}
    if trials and all((t.name, c) in derived for t in trials for c in ("v1", "v2")):
        trials = tuple(replace(t, v=None) for t in trials)
    return replace(single, trials=trials)
