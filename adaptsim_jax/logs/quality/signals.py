"""The single checks of the audit, each of one joint of one trial."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.logs.noise import difference_noise
from adaptsim_jax.logs.quality.consistency import command_agreement, velocity_agreement
from adaptsim_jax.logs.quality.criteria import SIGNAL
from adaptsim_jax.logs.quality.findings import Finding, Findings


@dataclass(frozen=True)
class Signal:
    """One joint of one trial, in the rows in which its angle was read.

    `trial`, `joint` and the columns `q_name`, `v_name`, `u_name` by their names; `time [K]` s;
    `q [K]` in `unit`; `v [K]` or None; `u [K]` or None: force or torque; `command [K]` or None: what
    it was commanded; `row`: the trial's sampling interval in s; `free`: whether nothing but a
    motor with no brake or gear holds the joint; `others`: range of the trial's other joints.
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

    def finding(self, kind: str, severity: str, where: str, text: str, value: float) -> Finding:
        """A finding of this trial."""
        return Finding(kind, severity, self.trial, where, text, float(value))


def check_sampling(trial: str, time: np.ndarray) -> Findings:
    """Sampling rate, jitter, gaps longer than five intervals, of one trial."""
    dt = np.diff(time)
    step = float(np.median(dt))
    rate = 1.0 / step
    text = f"sampled at {rate:.4g} Hz (median)"
    found = [Finding("sampling", "info", trial, "time", text, rate)]
    jitter = float(np.std(dt[dt <= SIGNAL.gap * step]) / step)
    if jitter > SIGNAL.jitter:
        text = f"sampling interval varies by {jitter:.0%} (std)"
        found.append(Finding("jitter", "info", trial, "time", text, jitter))
    gaps = np.flatnonzero(dt > SIGNAL.gap * step)
    if gaps.size:
        at = time[gaps[0]]
        text = (
            f"{gaps.size} gap(s) over {SIGNAL.gap:g} intervals, the longest {dt.max():.3g} s, first at {at:.3g} "
            "s"
        )
        found.append(Finding("gap", "warn", trial, f"time {at:.3g} s", text, float(dt.max())))
    if rate < SIGNAL.min_rate:
        text = f"sampled at {rate:.3g} Hz: below 50 Hz fast effects cannot be told apart"
        found.append(Finding("slow_sampling", "warn", trial, "time", text, rate))
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
        text = (
            f"{s.q_name} is constant ({s.q[0]:.4g} {s.unit}) over the trial while it moves: stuck"
        )
        return [s.finding("stuck", "warn", s.q_name, text, s.q[0])], keep, True
    bad = _frozen_runs(s.time, s.q, step)
    if not bad:
        return [], keep, False
    for start, length in bad:
        keep[start : start + length] = False
    lost = sum(length for _, length in bad)
    text = (
        f"{s.q_name} froze {len(bad)} time(s) while moving ({lost} samples, the first at "
        f"{s.time[bad[0][0]]:.3g} s)"
    )
    return [s.finding("frozen", "warn", s.q_name, text, lost)], keep, False


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
        after = (q[end + side - 1] - q[end]) / (time[end + side - 1] - time[end])
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
    text = f"{s.q_name} has {bad.size} lone outlier(s), the first at {s.time[bad[0]]:.3g} s"
    return [s.finding("spike", "warn", s.q_name, text, bad.size)], keep


def _lone_outliers(time: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Rows that the cubic through their four neighbours misses by far, and that stick out from both
    sides.
    """
    dt = np.diff(time)
    even = np.stack([dt[:-3], dt[1:-2], dt[2:-1], dt[3:]]).max(
        axis=0
    ) < SIGNAL.spike_gap * np.median(dt)
    miss = q[2:-2] - (4 * (q[1:-3] + q[3:-1]) - q[:-4] - q[4:]) / 6
    usual = max(1.4826 * float(np.median(np.abs(miss))), step, 1e-9)
    left, right = q[2:-2] - q[1:-3], q[2:-2] - q[3:-1]
    out = (np.abs(miss) > SIGNAL.spike * usual) & (left * right > 0)
    out &= np.minimum(np.abs(left), np.abs(right)) > SIGNAL.spike_sides * np.abs(miss)
    return np.flatnonzero(out & even) + 2


def check_saturation(s: Signal, steps: dict[str, float]) -> Findings:
    """A torque, or the angle of a free joint, that rests at its largest or smallest value."""
    found = []
    columns = [(s.u_name, s.u, "info")]
    if s.free:
        columns.append((s.q_name, s.q, "warn"))
    for name, x, severity in columns:
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
                text = (
                    f"{name} rests at its {word} value {extreme:.4g} in {share:.0%} of the rows: "
                    "clipped?"
                )
                found.append(s.finding("saturation", severity, name, text, share))
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
        text = f"{name} is unrelated to {slope} (explains {a.r2:.0%} of it)"
        return [s.finding("velocity", "warn", name, text, a.r2)], True
    found, wrong = [], not SIGNAL.min_gain < a.gain < SIGNAL.max_gain
    if wrong:
        text = f"{name} is {a.gain:.3g} times {slope}: wrong sign, unit or gear ratio"
        found.append(s.finding("velocity", "warn", name, text, a.gain))
    elif abs(a.gain - 1) > max(SIGNAL.gain_error, SIGNAL.gain_errors * a.spread):
        text = f"{name} is {a.gain:.3f} times {slope}"
        found.append(s.finding("velocity_scale", "warn", name, text, a.gain))
    if abs(a.lag) > max(SIGNAL.lag_rows * s.row, SIGNAL.lag):
        how = "a filter, or a backward difference"
        text = f"{name} lags {slope} by {a.lag * 1e3:.3g} ms ({how})"
        found.append(s.finding("velocity_lag", "info", name, text, a.lag))
    return found, wrong


def check_derived(s: Signal) -> Findings:
    """A velocity that is only a difference of the logged angles: it measures nothing of its own."""
    if s.v is None or np.ptp(s.v) == 0:
        return []
    slope = np.diff(s.q) / np.diff(s.time)
    for side, v in (("backward", s.v[1:]), ("forward", s.v[:-1])):
        near = np.median(np.abs(v - slope)) < SIGNAL.derived_miss * np.std(v)
        if near and np.corrcoef(v, slope)[0, 1] > SIGNAL.derived_corr:
            text = (
                f"{s.v_name} is the {side} difference of {s.q_name}: it measures nothing of its own"
            )
            return [s.finding("velocity_derived", "info", s.v_name, text, 1.0)]
    return []


def check_command(s: Signal) -> Findings:
    """Measured against commanded torque: gain and lag, where both were recorded."""
    if s.command is None or s.u is None:
        return []
    a = command_agreement(s.time, s.command, s.u)
    if not a.enough or a.lag <= SIGNAL.command_early * s.row:
        return []
    how = f"gain {a.gain:.3f} and lag {a.lag * 1e3:.3g} ms (r2 {a.r2:.3f})"
    severity = "info"
    expected = SIGNAL.command_min_gain < a.gain < SIGNAL.command_max_gain
    if not expected or a.lag > SIGNAL.command_lag:
        severity = "warn"
    text = f"{s.u_name} follows its command with {how}"
    return [s.finding("command", severity, s.u_name, text, a.lag)]


def check_stale(s: Signal, step: float) -> Findings:
    """Rows that repeat the angle of the row before although the joint turns."""
    q = s.q
    turning = np.abs(q[2:] - q[:-2]) > SIGNAL.stale_steps * max(step, 1e-12)
    if turning.sum() < SIGNAL.stale_rows:
        return []
    share = float(np.mean((q[1:-1] == q[:-2])[turning] | (q[1:-1] == q[2:])[turning]))
    if share <= SIGNAL.stale_share:
        return []
    text = (
        f"{s.q_name} repeats its value in {share:.0%} of the rows while turning: rows outrun the "
        "sensor"
    )
    return [s.finding("stale", "warn", s.q_name, text, share)]


def check_timestamps(own: Sequence[Signal]) -> Findings:
    """Whether uneven times are when the angles were read: then angles grow with the time steps.

    `value` is the share of the unevenness that they do not follow (1: they were read evenly).
    """
    shares = [_not_followed(s.time, s.q) for s in own if np.ptp(s.q) > SIGNAL.still]
    share, spread = min(shares, key=lambda pair: pair[1], default=(0.0, 0.0))
    if share < max(SIGNAL.stamp_share, SIGNAL.stamp_errors * spread):
        return []
    text = (
        f"angles do not follow {share:.0%} of the unevenness of time: rows are stamped late, not "
        "when read"
    )
    return [own[0].finding("timestamps", "warn", "time", text, share)]


def _not_followed(time: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """Share of the unevenness of time that an angle does not follow, and its standard error."""
    dt = np.diff(time)
    if np.std(dt) < SIGNAL.stamp_jitter * float(np.median(dt)):
        return 0.0, 0.0
    turn = np.diff(q)
    width = np.ones(min(SIGNAL.stamp_rows, len(dt) // 2))
    speed = np.convolve(turn, width, "same") / np.convolve(dt, width, "same")
    expected = speed * (dt - np.convolve(dt, width / len(width), "same"))
    extra = turn - speed * dt
    power = max(float(np.sum(expected**2)), 1e-300)
    return -float(np.sum(extra * expected)) / power, float(np.std(extra)) / power**0.5


def check_excitation(s: Signal) -> Findings:
    """Range of angle, speed and torque, and how often the joint turns round."""
    w = np.gradient(s.q, s.time) if s.v is None else s.v
    loud = SIGNAL.slow * float(np.max(np.abs(w)) or 1.0)
    signs = np.sign(w[np.abs(w) > loud])
    turns = int(np.sum(signs[1:] != signs[:-1]))
    torque = "" if s.u is None else f"torque range {np.ptp(s.u):.3g}, "
    text = (
        f"{s.joint}: range {np.ptp(s.q):.3g} {s.unit}, top speed {np.max(np.abs(w)):.3g} "
        f"{s.unit}/s, {torque}{turns} reversals"
    )
    return [s.finding("excitation", "info", s.joint, text, turns)]
