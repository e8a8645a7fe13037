"""How the rows came to be: stale angles, late time stamps, velocities that are only differences of
the angles.
"""

import numpy as np

from adaptsim_jax.logs.quality.findings import Finding, Findings
from adaptsim_jax.logs.types import Trial


def check_stale(trial: Trial, steps: dict[str, float]) -> Findings:
    """Rows that repeat the angle of the row before although the joint turns: they outrun the
    sensor.
    """
    found = []
    for j in range(2):
        q, step = trial.q[:, j], max(steps.get(f"q{j + 1}", 0.0), 1e-12)
        move = np.abs(q[2:] - q[:-2])
        turning = move > 6 * step
        if turning.sum() < 50:
            continue
        share = float(np.mean((q[1:-1] == q[:-2])[turning] | (q[1:-1] == q[2:])[turning]))
        if share > 0.05:
            text = f"q{j + 1} repeats its value in {share:.0%} of the rows while turning: rows outrun the sensor"
            found.append(Finding("stale", "warn", trial.name, f"q{j + 1}", text, share))
    return found


def check_timestamps(trial: Trial) -> Findings:
    """Whether uneven times are when the angles were read: then angle steps grow with the time
    steps.

    `value` is the share of the unevenness that the angles do not follow (1: they were read evenly).
    """
    dt, step = np.diff(trial.time), trial.dt
    if np.std(dt) < 0.1 * step:
        return []
    shares = []
    for j in range(2):
        turn = np.diff(trial.q[:, j])
        width = np.ones(min(21, len(dt) // 2))
        speed = np.convolve(turn, width, "same") / np.convolve(dt, width, "same")
        expected = speed * (dt - np.convolve(dt, width / len(width), "same"))
        extra = turn - speed * dt
        power = float(np.sum(expected**2))
        spread = float(np.std(extra)) / max(power, 1e-300) ** 0.5
        shares.append((-float(np.sum(extra * expected)) / power if power else 0.0, spread))
    share, spread = min(shares, key=lambda s: s[1])
    if share < max(0.3, 6.0 * spread):
        return []
    text = f"angles do not follow {share:.0%} of the unevenness of time: rows are stamped late, not when read"
    return [Finding("timestamps", "warn", trial.name, "time", text, share)]


def check_derived(trial: Trial) -> Findings:
    """Velocities that are only differences of the logged angles: they add no measurement of their
    own.
    """
    found = []
    for j in range(2):
        if trial.v is None or np.ptp(trial.v[:, j]) == 0:
            continue
        slope = np.diff(trial.q[:, j]) / np.diff(trial.time)
        for side, v in (("backward", trial.v[1:, j]), ("forward", trial.v[:-1, j])):
            if (
                np.median(np.abs(v - slope)) < 0.005 * np.std(v)
                and np.corrcoef(v, slope)[0, 1] > 0.999
            ):
                text = (
                    f"v{j + 1} is the {side} difference of q{j + 1}: it measures nothing of its own"
                )
                found.append(
                    Finding("velocity_derived", "info", trial.name, f"v{j + 1}", text, 1.0)
                )
                break
    return found
