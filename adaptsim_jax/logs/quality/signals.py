"""The single checks of the audit, each of one joint of one trial."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.logs.criteria import SIGNAL
from adaptsim_jax.logs.noise import difference_noise
from adaptsim_jax.logs.quality.consistency import command_agreement, velocity_agreement
from adaptsim_jax.logs.quality.findings import Findings, finding


@dataclass(frozen=True)
class Signal:
    """One joint of one trial, in the rows in which its angle was read.

    `trial`, `joint` and the columns `q_name`, `v_name`, `u_name` by their names. `time [K]` s. `q
    [K]` in `unit`. `v [K]` or None. `u [K]` or None: force or torque. `command [K]` or None: what
    it was commanded.

    - `row`: The trial's sampling interval in s.
    - `free`: Whether nothing but a motor with no brake or gear holds the joint.
    - `others`: Range of the trial's other joints.
    """

    trial: str
    joint: str
    q_name: str
    v_name: str
    u_name: str
    unit: str
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    u: np.ndarray | None
    command: np.ndarray | None
    row: float
    free: bool
    others: float


def check_sampling(trial: str, time: np.ndarray) -> Findings:
    """Sampling rate, jitter, gaps longer than five intervals, of one trial."""
    dt = np.diff(time)
    step = float(np.median(dt))
    rate = 1.0 / step
    findings = [finding("sampling", trial, "time", rate)]
    jitter = float(np.std(dt[dt <= SIGNAL.min_gap_intervals * step]) / step)
    if jitter > SIGNAL.max_jitter:
        findings.append(finding("jitter", trial, "time", jitter))
    gaps = np.flatnonzero(dt > SIGNAL.min_gap_intervals * step)
    if gaps.size:
        at = time[gaps[0]]
        longest, rows = float(dt.max()), SIGNAL.min_gap_intervals
        where = f"time {at:.3g} s"
        findings.append(finding("gap", trial, where, longest, count=gaps.size, rows=rows, at=at))
    if rate < SIGNAL.min_rate:
        findings.append(finding("slow_sampling", trial, "time", rate))
    return findings


def runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of equal values in `x: [K]`."""
    starts = np.concatenate([[0], np.flatnonzero(x[1:] != x[:-1]) + 1])
    return starts, np.diff(np.concatenate([starts, [len(x)]]))


def check_frozen(s: Signal, step: float) -> tuple[Findings, np.ndarray, bool]:
    """Runs in which an angle stands still though the joint moves.

    Args:
        s: the joint.
        step: resolution of its angle.

    Returns:
        Findings, rows to use `[K]`, and whether the sensor is stuck over the whole trial.
    """
    is_used = np.ones(len(s.q), bool)
    if np.ptp(s.q) == 0:
        is_spinning = s.v is not None and np.ptp(s.v) > SIGNAL.min_motion
        if not is_spinning and not (s.free and s.others > SIGNAL.min_motion):
            return [], is_used, False
        return [finding("stuck", s.trial, s.q_name, s.q[0], unit=s.unit)], is_used, True
    frozen_runs = _frozen_runs(s.time, s.q, step)
    if not frozen_runs:
        return [], is_used, False
    for start, length in frozen_runs:
        is_used[start : start + length] = False
    n_frozen = sum(length for _, length in frozen_runs)
    facts = {"count": len(frozen_runs), "at": s.time[frozen_runs[0][0]]}
    return [finding("frozen", s.trial, s.q_name, n_frozen, **facts)], is_used, False


def _frozen_runs(time: np.ndarray, q: np.ndarray, step: float) -> list[tuple[int, int]]:
    """(start, length) of frozen runs.

    The angle should have moved by many resolution steps in them, and jumps at their end.
    """
    starts, lengths = runs(q)
    noise = max(step, float(difference_noise([q], 2)))
    frozen, n_sides = [], SIGNAL.frozen_sides
    for start, length in zip(starts, lengths, strict=True):
        end = start + length
        if length < SIGNAL.frozen_rows or start < n_sides or end + n_sides > len(q):
            continue
        span = time[end - 1] - time[start]
        before = (q[start] - q[start - n_sides]) / (time[start] - time[start - n_sides])
        last = end + n_sides - 1
        after = (q[last] - q[end]) / (time[last] - time[end])
        expected = 0.0
        if before * after > 0:
            expected = span * min(abs(before), abs(after))
        if min(expected, 2 * abs(q[end] - q[end - 1])) > SIGNAL.frozen_steps * noise:
            frozen.append((int(start), int(length)))
    return frozen


def check_spikes(s: Signal, step: float) -> tuple[Findings, np.ndarray]:
    """Single samples far from both neighbours (a lost bit, a bad packet); rows to use `[K]`."""
    is_used = np.ones(len(s.q), bool)
    spikes = _lone_outliers(s.time, s.q, step)
    if not spikes.size:
        return [], is_used
    is_used[spikes] = False
    return [finding("spike", s.trial, s.q_name, spikes.size, at=s.time[spikes[0]])], is_used


def _lone_outliers(time: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Rows that the cubic through their four neighbours misses by far, and that stick out from both
    sides.
    """
    dt = np.diff(time)
    longest = np.stack([dt[:-3], dt[1:-2], dt[2:-1], dt[3:]]).max(axis=0)
    is_even = longest < SIGNAL.spike_gap * np.median(dt)
    middle = q[2:-2]
    cubic = (4 * (q[1:-3] + q[3:-1]) - q[:-4] - q[4:]) / 6
    miss = middle - cubic
    usual_miss = max(1.4826 * float(np.median(np.abs(miss))), step, 1e-9)
    left = middle - q[1:-3]
    right = middle - q[3:-1]
    is_outlying = (np.abs(miss) > SIGNAL.min_spike_ratio * usual_miss) & (left * right > 0)
    is_outlying &= np.minimum(np.abs(left), np.abs(right)) > SIGNAL.spike_sides * np.abs(miss)
    return np.flatnonzero(is_outlying & is_even) + 2


def check_saturation(s: Signal, steps: dict[str, float]) -> Findings:
    """A torque, or the angle of a free joint, that rests at its largest or smallest value."""
    findings = []
    columns = [(s.u_name, s.u, "cut_force")]
    if s.free:
        columns.append((s.q_name, s.q, "cut_angle"))
    for name, x, code in columns:
        if (
            x is None
            or np.ptp(x) == 0
            or np.mean(np.isin(x, (x.max(), x.min()))) > SIGNAL.max_end_share
        ):
            continue
        starts, lengths = _saturated_runs(s.time, x, steps.get(name, 0.0))
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            is_extreme = (x[starts] == extreme) & (lengths >= SIGNAL.cut_rows)
            share = float(lengths[is_extreme].sum()) / len(x)
            if share > SIGNAL.cut_share and np.sum(is_extreme) >= SIGNAL.cut_runs:
                facts = {"end": word, "extreme": extreme}
                findings.append(finding(code, s.trial, name, share, **facts))
    return findings


def _saturated_runs(time: np.ndarray, x: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Runs of equal values that are entered at a speed which would have carried on for many
    steps.
    """
    starts, lengths = runs(x)
    ends = np.minimum(starts + lengths, len(x) - 1)
    before = np.maximum(starts - 3, 0)
    speed = np.abs(x[starts] - x[before]) / np.maximum(time[starts] - time[before], 1e-12)
    is_saturated = speed * (time[ends] - time[starts]) > SIGNAL.cut_steps * step
    return starts[is_saturated], lengths[is_saturated]


def check_velocity(s: Signal) -> tuple[Findings, bool]:
    """Velocity against d(angle)/dt: scale, sign, lag; and whether it contradicts the angle."""
    if s.v is None:
        return [], False
    slope, name = f"d({s.q_name})/dt", s.v_name
    agreement = velocity_agreement(s.time, s.q, s.v)
    if not agreement.enough:
        if not (agreement.loud and np.ptp(s.q) > SIGNAL.min_motion):
            return [], False
        return [finding("velocity_unrelated", s.trial, name, agreement.r2, slope=slope)], True
    findings, contradicts = [], not SIGNAL.min_gain < agreement.gain < SIGNAL.max_gain
    if contradicts:
        findings.append(finding("velocity_wrong", s.trial, name, agreement.gain, slope=slope))
    elif abs(agreement.gain - 1) > max(SIGNAL.gain_error, SIGNAL.gain_errors * agreement.spread):
        findings.append(finding("velocity_scale", s.trial, name, agreement.gain, slope=slope))
    if abs(agreement.lag) > max(SIGNAL.lag_rows * s.row, SIGNAL.min_lag):
        ms = 1e3 * agreement.lag
        findings.append(finding("velocity_lag", s.trial, name, agreement.lag, slope=slope, ms=ms))
    return findings, contradicts


def check_derived(s: Signal) -> Findings:
    """A velocity that is only a difference of the logged angles: it measures nothing of its own."""
    if s.v is None or np.ptp(s.v) == 0:
        return []
    slope = np.diff(s.q) / np.diff(s.time)
    for side, v in (("backward", s.v[1:]), ("forward", s.v[:-1])):
        is_equal = np.median(np.abs(v - slope)) < SIGNAL.derived_miss * np.std(v)
        if is_equal and np.corrcoef(v, slope)[0, 1] > SIGNAL.derived_corr:
            facts = {"side": side, "angle": s.q_name}
            return [finding("velocity_derived", s.trial, s.v_name, 1.0, **facts)]
    return []


def check_command(s: Signal) -> Findings:
    """Measured against commanded torque: gain and lag, where both were recorded."""
    if s.command is None or s.u is None:
        return []
    agreement = command_agreement(s.time, s.command, s.u)
    if not agreement.enough or agreement.lag <= SIGNAL.min_command_lag_rows * s.row:
        return []
    is_expected = SIGNAL.command_min_gain < agreement.gain < SIGNAL.command_max_gain
    code = "command" if is_expected and agreement.lag <= SIGNAL.max_command_lag else "command_off"
    facts = {"gain": agreement.gain, "ms": 1e3 * agreement.lag, "r2": agreement.r2}
    return [finding(code, s.trial, s.u_name, agreement.lag, **facts)]


def check_stale(s: Signal, step: float) -> Findings:
    """Rows that repeat the angle of the row before although the joint turns."""
    q = s.q
    is_turning = np.abs(q[2:] - q[:-2]) > SIGNAL.stale_steps * max(step, 1e-12)
    if is_turning.sum() < SIGNAL.stale_rows:
        return []
    repeats = (q[1:-1] == q[:-2]) | (q[1:-1] == q[2:])
    share = float(np.mean(repeats[is_turning]))
    if share <= SIGNAL.stale_share:
        return []
    return [finding("stale", s.trial, s.q_name, share)]


def check_excitation(s: Signal) -> Findings:
    """Range of angle, speed and torque, and how often the joint turns round."""
    w = np.gradient(s.q, s.time) if s.v is None else s.v
    speed = np.abs(w)
    fastest = np.max(speed)
    signs = np.sign(w[speed > SIGNAL.slow_share * float(fastest or 1.0)])
    turns = int(np.sum(signs[1:] != signs[:-1]))
    facts = {
        "range": np.ptp(s.q),
        "unit": s.unit,
        "speed": fastest,
        "torque": "" if s.u is None else f"torque range {np.ptp(s.u):.3g}, ",
    }
    return [finding("excitation", s.trial, s.joint, turns, **facts)]
