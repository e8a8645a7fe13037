"""The single checks of the audit: each takes one trial and returns findings; some mark rows to
leave out.
"""

import numpy as np

from adaptsim_jax.logs.noise.differences import difference_noise
from adaptsim_jax.logs.quality.consistency import command_agreement, velocity_agreement
from adaptsim_jax.logs.quality.findings import Finding, Findings
from adaptsim_jax.logs.quality.turns import TURN, without_turns
from adaptsim_jax.logs.types import Trial


def check_sampling(trial: Trial) -> Findings:
    """Sampling rate, jitter, gaps longer than five intervals."""
    dt = np.diff(trial.time)
    step = float(np.median(dt))
    found = [
        Finding(
            "sampling",
            "info",
            trial.name,
            "time",
            f"sampled at {1 / step:.4g} Hz (median)",
            1 / step,
        )
    ]
    jitter = float(np.std(dt[dt <= 5 * step]) / step)
    if jitter > 0.05:
        found.append(
            Finding(
                "jitter",
                "info",
                trial.name,
                "time",
                f"sampling interval varies by {jitter:.0%} (std)",
                jitter,
            )
        )
    gaps = np.flatnonzero(dt > 5 * step)
    if gaps.size:
        first = trial.time[gaps[0]]
        text = f"{gaps.size} gap(s) over 5 intervals, the longest {dt.max():.3g} s, first at {first:.3g} s"
        found.append(
            Finding("gap", "warn", trial.name, f"time {first:.3g} s", text, float(dt.max()))
        )
    if 1 / step < 45:
        text = f"sampled at {1 / step:.3g} Hz: below 50 Hz fast effects cannot be told apart"
        found.append(Finding("slow_sampling", "warn", trial.name, "time", text, 1 / step))
    return found


def runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of equal rows in `x: [T]` or `[T, k]`."""
    rows = x.reshape(len(x), -1)
    change = np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1)) + 1
    starts = np.concatenate([[0], change])
    return starts, np.diff(np.concatenate([starts, [len(x)]]))


def check_frozen(trial: Trial, steps: dict[str, float]) -> tuple[Findings, np.ndarray, list[str]]:
    """Runs in which an angle stands still though the arm moves; rows to keep; stuck channels."""
    keep = np.ones(len(trial.time), bool)
    found, stuck = [], []
    for j in range(2):
        channel = f"q{j + 1}"
        q = trial.q[:, j]
        if np.ptp(q) == 0:
            if _others_move(trial, j):
                stuck.append(channel)
                text = f"{channel} is constant ({q[0]:.4g} rad) over the trial while the arm moves: stuck"
                found.append(Finding("stuck", "warn", trial.name, channel, text, float(q[0])))
            continue
        bad = _frozen_runs(trial, j, steps.get(channel, 0.0))
        for start, length in bad:
            keep[start : start + length] = False
        if bad:
            lost = sum(length for _, length in bad)
            at = trial.time[bad[0][0]]
            text = f"{channel} froze {len(bad)} time(s) while moving ({lost} samples, the first at {at:.3g} s)"
            found.append(Finding("frozen", "warn", trial.name, channel, text, float(lost)))
    return found, keep, stuck


def _others_move(trial: Trial, joint: int) -> bool:
    own = trial.v is not None and np.ptp(trial.v[:, joint]) > 0.2
    return bool(own or np.ptp(trial.q[:, 1 - joint]) > 0.2)


def _frozen_runs(trial: Trial, joint: int, step: float) -> list[tuple[int, int]]:
    """(start, length) of frozen runs: the angle should have moved by many resolution steps, and
    jumps.
    """
    q, time = trial.q[:, joint], trial.time
    starts, lengths = runs(q)
    noise = max(step, float(difference_noise([q], 2)))
    bad = []
    for start, length in zip(starts, lengths, strict=True):
        end = start + length
        if length < 5 or start < 4 or end + 4 > len(q):
            continue
        held = time[end - 1] - time[start]
        before = (q[start] - q[start - 4]) / (time[start] - time[start - 4])
        after = (q[end + 3] - q[end]) / (time[end + 3] - time[end])
        jump = abs(q[end] - q[end - 1])
        if before * after > 0:
            expected = held * min(abs(before), abs(after))
        else:
            expected = 0.0
        if min(expected, 2 * jump) > 10 * noise:
            bad.append((int(start), int(length)))
    return bad


def check_spikes(trial: Trial, steps: dict[str, float]) -> tuple[Findings, np.ndarray]:
    """Single samples far from both neighbours (a lost bit, a bad packet); rows to keep."""
    keep = np.ones(len(trial.time), bool)
    found = []
    for j in range(2):
        bad = _lone_outliers(trial.time, trial.q[:, j], steps.get(f"q{j + 1}", 0.0))
        if bad.size:
            keep[bad] = False
            at = trial.time[bad[0]]
            text = f"q{j + 1} has {bad.size} lone outlier(s), the first at {at:.3g} s; those rows are not used"
            found.append(Finding("spike", "warn", trial.name, f"q{j + 1}", text, float(bad.size)))
    return found, keep


def _lone_outliers(time: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Rows that the cubic through their four neighbours misses by far, and that stick out from both
    sides.
    """
    dt = np.diff(time)
    even = np.stack([dt[:-3], dt[1:-2], dt[2:-1], dt[3:]]).max(axis=0) < 2 * np.median(dt)
    miss = q[2:-2] - (4 * (q[1:-3] + q[3:-1]) - q[:-4] - q[4:]) / 6
    usual = max(1.4826 * float(np.median(np.abs(miss))), step, 1e-9)
    left, right = q[2:-2] - q[1:-3], q[2:-2] - q[3:-1]
    out = (np.abs(miss) > 30 * usual) & (left * right > 0)
    out &= np.minimum(np.abs(left), np.abs(right)) > 0.5 * np.abs(miss)
    return np.flatnonzero(out & even) + 2


def check_saturation(trial: Trial, steps: dict[str, float]) -> Findings:
    """A torque or an angle that rests at its largest or smallest value for many rows: cut flat
    there.
    """
    found = []
    columns = {
        "tau1": trial.torque[:, 0],
        "tau2": trial.torque[:, 1],
        "q1": trial.q[:, 0],
        "q2": trial.q[:, 1],
    }
    for channel, x in columns.items():
        span = np.ptp(x)
        if span == 0:
            continue
        starts, lengths = _cut_runs(trial.time, x, steps.get(channel, 0.0))
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            at = (x[starts] == extreme) & (lengths >= 5)
            share = float(lengths[at].sum()) / len(x)
            two_level = np.mean(np.isin(x, (x.max(), x.min()))) > 0.9
            if share > 0.01 and np.sum(at) >= 2 and not two_level:
                text = f"{channel} rests at its {word} value {extreme:.4g} in {share:.0%} of the rows: clipped?"
                severity = "info" if channel.startswith("tau") else "warn"
                found.append(Finding("saturation", severity, trial.name, channel, text, share))
    return found


def _cut_runs(time: np.ndarray, x: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Runs of equal values that are entered at a speed which would have carried on for many
    steps.
    """
    starts, lengths = runs(x)
    ends = np.minimum(starts + lengths, len(x) - 1)
    before = np.maximum(starts - 3, 0)
    speed = np.abs(x[starts] - x[before]) / np.maximum(time[starts] - time[before], 1e-12)
    cut = speed * (time[ends] - time[starts]) > 20 * step
    return starts[cut], lengths[cut]


def check_velocity(trial: Trial) -> tuple[Findings, list[str]]:
    """Velocity against d(angle)/dt: scale, sign, lag. Also the channels that contradict the
    angles.
    """
    found, wrong = [], []
    if trial.v is None:
        return found, wrong
    for j in range(2):
        channel, name = f"v{j + 1}", trial.name
        a = velocity_agreement(trial.time, trial.q[:, j], trial.v[:, j])
        if not a.enough:
            if a.loud and np.ptp(trial.q[:, j]) > 0.2:
                wrong.append(channel)
                text = f"{channel} is unrelated to d(q{j + 1})/dt (explains {a.r2:.0%} of it)"
                found.append(Finding("velocity", "warn", name, channel, text, a.r2))
            continue
        if a.gain < 0 or not 0.5 < a.gain < 2.0:
            wrong.append(channel)
            text = f"{channel} is {a.gain:.3g} times d(q{j + 1})/dt: wrong sign, unit or gear ratio"
            found.append(Finding("velocity", "warn", name, channel, text, a.gain))
        elif abs(a.gain - 1) > max(0.03, 5 * a.spread):
            text = f"{channel} is {a.gain:.3f} times d(q{j + 1})/dt"
            found.append(Finding("velocity_scale", "warn", name, channel, text, a.gain))
        if abs(a.lag) > 0.5 * trial.dt and abs(a.lag) > 1e-3:
            text = f"{channel} lags d(q{j + 1})/dt by {a.lag * 1e3:.3g} ms (a filter, or a backward difference)"
            found.append(Finding("velocity_lag", "info", name, channel, text, a.lag))
    return found, wrong


def check_command(trial: Trial) -> Findings:
    """Measured against commanded torque: gain and lag, where both were recorded."""
    found = []
    if trial.commanded is None:
        return found
    for j in range(2):
        a = command_agreement(trial.time, trial.commanded[:, j], trial.torque[:, j])
        if a.enough and a.lag > -4 * trial.dt:
            how = f"gain {a.gain:.3f} and lag {a.lag * 1e3:.3g} ms (r2 {a.r2:.3f})"
            text = f"tau{j + 1} follows its command with {how}"
            if not 0.7 < a.gain < 1.4 or a.lag > 0.02:
                severity = "warn"
            else:
                severity = "info"
            found.append(Finding("command", severity, trial.name, f"tau{j + 1}", text, a.lag))
    return found


def check_wrap(trial: Trial) -> Findings:
    """Jumps of whole turns (or of an encoder's own period), which are taken out, and gaps in which
    there may be more.
    """
    found = []
    for j in range(2):
        turns = without_turns(trial.time, trial.q[:, j])
        channel = f"q{j + 1}"
        if turns.count:
            if abs(turns.period - TURN) < 1e-9:
                what = "a full turn"
            else:
                what = f"{turns.period:.4g} rad"
            text = f"{channel} jumps by {what} {turns.count} time(s): taken out"
            found.append(Finding("wrap", "info", trial.name, channel, text, float(turns.count)))
        if turns.unsure:
            at = trial.time[turns.unsure[0]]
            text = f"{channel} wraps, and may have turned further in {len(turns.unsure)} gap(s), first at {at:.3g} s: cut there"
            found.append(
                Finding("wrap_in_gap", "warn", trial.name, channel, text, float(len(turns.unsure)))
            )
    return found


def check_excitation(trial: Trial) -> Findings:
    """Range of angle, speed and torque, and how often each joint turns round (friction shows
    there).
    """
    found = []
    if trial.v is not None:
        v = trial.v
    else:
        v = np.gradient(trial.q, trial.time, axis=0)
    for j in range(2):
        q, w, u = trial.q[:, j], v[:, j], trial.torque[:, j]
        loud = 0.02 * float(np.max(np.abs(w)) or 1.0)
        signs = np.sign(w[np.abs(w) > loud])
        turns = int(np.sum(signs[1:] != signs[:-1]))
        text = (
            f"joint {j + 1}: angle range {np.ptp(q):.3g} rad, top speed {np.max(np.abs(w)):.3g} "
            f"rad/s, "
            f"torque range {np.ptp(u):.3g} N m, {turns} reversals"
        )
        found.append(Finding("excitation", "info", trial.name, f"joint{j + 1}", text, float(turns)))
    if np.all(np.ptp(trial.q, axis=0) < 0.02):
        text = "the arm hardly moves (under 0.02 rad): nothing can be learned from this trial"
        found.append(
            Finding("no_motion", "warn", trial.name, "joints", text, float(np.ptp(trial.q)))
        )
    return found
