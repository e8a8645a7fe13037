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
    found = [finding("sampling", trial, "time", rate)]
    jitter = float(np.std(dt[dt <= SIGNAL.gap * step]) / step)
    if jitter > SIGNAL.jitter:
        found.append(finding("jitter", trial, "time", jitter))
    gaps = np.flatnonzero(dt > SIGNAL.gap * step)
    if gaps.size:
        at = time[gaps[0]]
        longest, rows = float(dt.max()), SIGNAL.gap
        where = f"time {at:.3g} s"
        found.append(finding("gap", trial, where, longest, count=gaps.size, rows=rows, at=at))
    if rate < SIGNAL.min_rate:
        found.append(finding("slow_sampling", trial, "time", rate))
    return found


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
    keep = np.ones(len(s.q), bool)
    if np.ptp(s.q) == 0:
        spins = s.v is not None and np.ptp(s.v) > SIGNAL.moving
        if not spins and not (s.free and s.others > SIGNAL.moving):
            return [], keep, False
        return [finding("stuck", s.trial, s.q_name, s.q[0], unit=s.unit)], keep, True
    bad = _frozen_runs(s.time, s.q, step)
    if not bad:
        return [], keep, False
    for start, length in bad:
        keep[start : start + length] = False
    lost = sum(length for _, length in bad)
    facts = {"count": len(bad), "at": s.time[bad[0][0]]}
    return [finding("frozen", s.trial, s.q_name, lost, **facts)], keep, False


def _frozen_runs(time: np.ndarray, q: np.ndarray, step: float) -> list[tuple[int, int]]:
    """(start, length) of frozen runs.

    The angle should have moved by many resolution steps in them, and jumps at their end.
    """
    starts, lengths = runs(q)
    noise = max(step, float(difference_noise([q], 2)))
    bad, side = [], SIGNAL.frozen_sides
    for start, length in zip(starts, lengths, strict=True):
        end = start + length
        if length < SIGNAL.frozen_rows or start < side or end + side > len(q):
            continue
        span = time[end - 1] - time[start]
        before = (q[start] - q[start - side]) / (time[start] - time[start - side])
        last = end + side - 1
        after = (q[last] - q[end]) / (time[last] - time[end])
        expected = 0.0
        if before * after > 0:
            expected = span * min(abs(before), abs(after))
        if min(expected, 2 * abs(q[end] - q[end - 1])) > SIGNAL.frozen_steps * noise:
            bad.append((int(start), int(length)))
    return bad


def check_spikes(s: Signal, step: float) -> tuple[Findings, np.ndarray]:
    """Single samples far from both neighbours (a lost bit, a bad packet); rows to use `[K]`."""
    keep = np.ones(len(s.q), bool)
    bad = _lone_outliers(s.time, s.q, step)
    if not bad.size:
        return [], keep
    keep[bad] = False
    return [finding("spike", s.trial, s.q_name, bad.size, at=s.time[bad[0]])], keep


def _lone_outliers(time: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Rows that the cubic through their four neighbours misses by far, and that stick out from both
    sides.
    """
    dt = np.diff(time)
    longest = np.stack([dt[:-3], dt[1:-2], dt[2:-1], dt[3:]]).max(axis=0)
    even = longest < SIGNAL.spike_gap * np.median(dt)
    middle = q[2:-2]
    cubic = (4 * (q[1:-3] + q[3:-1]) - q[:-4] - q[4:]) / 6
    miss = middle - cubic
    usual = max(1.4826 * float(np.median(np.abs(miss))), step, 1e-9)
    left = middle - q[1:-3]
    right = middle - q[3:-1]
    out = (np.abs(miss) > SIGNAL.spike * usual) & (left * right > 0)
    out &= np.minimum(np.abs(left), np.abs(right)) > SIGNAL.spike_sides * np.abs(miss)
    return np.flatnonzero(out & even) + 2


def check_saturation(s: Signal, steps: dict[str, float]) -> Findings:
    """A torque, or the angle of a free joint, that rests at its largest or smallest value."""
    found = []
    columns = [(s.u_name, s.u, "cut_force")]
    if s.free:
        columns.append((s.q_name, s.q, "cut_angle"))
    for name, x, code in columns:
        if (
            x is None
            or np.ptp(x) == 0
            or np.mean(np.isin(x, (x.max(), x.min()))) > SIGNAL.two_valued
        ):
            continue
        starts, lengths = _cut_runs(s.time, x, steps.get(name, 0.0))
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            at = (x[starts] == extreme) & (lengths >= SIGNAL.cut_rows)
            share = float(lengths[at].sum()) / len(x)
            if share > SIGNAL.cut_share and np.sum(at) >= SIGNAL.cut_runs:
                facts = {"end": word, "extreme": extreme}
                found.append(finding(code, s.trial, name, share, **facts))
    return found


def _cut_runs(time: np.ndarray, x: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Runs of equal values that are entered at a speed which would have carried on for many
    steps.
    """
    starts, lengths = runs(x)
    ends = np.minimum(starts + lengths, len(x) - 1)
    before = np.maximum(starts - 3, 0)
    speed = np.abs(x[starts] - x[before]) / np.maximum(time[starts] - time[before], 1e-12)
    cut = speed * (time[ends] - time[starts]) > SIGNAL.cut_steps * step
    return starts[cut], lengths[cut]


def check_velocity(s: Signal) -> tuple[Findings, bool]:
    """Velocity against d(angle)/dt: scale, sign, lag; and whether it contradicts the angle."""
    if s.v is None:
        return [], False
    slope, name = f"d({s.q_name})/dt", s.v_name
    a = velocity_agreement(s.time, s.q, s.v)
    if not a.enough:
        if not (a.loud and np.ptp(s.q) > SIGNAL.moving):
            return [], False
        return [finding("velocity_unrelated", s.trial, name, a.r2, slope=slope)], True
    found, wrong = [], not SIGNAL.min_gain < a.gain < SIGNAL.max_gain
    if wrong:
        found.append(finding("velocity_wrong", s.trial, name, a.gain, slope=slope))
    elif abs(a.gain - 1) > max(SIGNAL.gain_error, SIGNAL.gain_errors * a.spread):
        found.append(finding("velocity_scale", s.trial, name, a.gain, slope=slope))
    if abs(a.lag) > max(SIGNAL.lag_rows * s.row, SIGNAL.lag):
        ms = 1e3 * a.lag
        found.append(finding("velocity_lag", s.trial, name, a.lag, slope=slope, ms=ms))
    return found, wrong


def check_derived(s: Signal) -> Findings:
    """A velocity that is only a difference of the logged angles: it measures nothing of its own."""
    if s.v is None or np.ptp(s.v) == 0:
        return []
    slope = np.diff(s.q) / np.diff(s.time)
    for side, v in (("backward", s.v[1:]), ("forward", s.v[:-1])):
        near = np.median(np.abs(v - slope)) < SIGNAL.derived_miss * np.std(v)
        if near and np.corrcoef(v, slope)[0, 1] > SIGNAL.derived_corr:
            facts = {"side": side, "angle": s.q_name}
            return [finding("velocity_derived", s.trial, s.v_name, 1.0, **facts)]
    return []


def check_command(s: Signal) -> Findings:
    """Measured against commanded torque: gain and lag, where both were recorded."""
    if s.command is None or s.u is None:
        return []
    a = command_agreement(s.time, s.command, s.u)
    if not a.enough or a.lag <= SIGNAL.command_early * s.row:
        return []
    expected = SIGNAL.command_min_gain < a.gain < SIGNAL.command_max_gain
    code = "command" if expected and a.lag <= SIGNAL.command_lag else "command_off"
    facts = {"gain": a.gain, "ms": 1e3 * a.lag, "r2": a.r2}
    return [finding(code, s.trial, s.u_name, a.lag, **facts)]


def check_stale(s: Signal, step: float) -> Findings:
    """Rows that repeat the angle of the row before although the joint turns."""
    q = s.q
    turning = np.abs(q[2:] - q[:-2]) > SIGNAL.stale_steps * max(step, 1e-12)
    if turning.sum() < SIGNAL.stale_rows:
        return []
    repeats = (q[1:-1] == q[:-2]) | (q[1:-1] == q[2:])
    share = float(np.mean(repeats[turning]))
    if share <= SIGNAL.stale_share:
        return []
    return [finding("stale", s.trial, s.q_name, share)]


def check_excitation(s: Signal) -> Findings:
    """Range of angle, speed and torque, and how often the joint turns round."""
    w = np.gradient(s.q, s.time) if s.v is None else s.v
    speed = np.abs(w)
    fastest = np.max(speed)
    signs = np.sign(w[speed > SIGNAL.slow * float(fastest or 1.0)])
    turns = int(np.sum(signs[1:] != signs[:-1]))
    facts = {
        "range": np.ptp(s.q),
        "unit": s.unit,
        "speed": fastest,
        "torque": "" if s.u is None else f"torque range {np.ptp(s.u):.3g}, ",
    }
    return [finding("excitation", s.trial, s.joint, turns, **facts)]
