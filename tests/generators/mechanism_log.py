"""What the encoders and the logger make of the true motion: offsets, scales, lateness, play, logs
that run late.
"""

import numpy as np

from tests.generators.mechanism_engine import STEP, Drive, Run
from tests.generators.mechanism_forces import Effect


def readings(
    run: Run, effects: tuple[Effect, ...], accelerations: bool = False
) -> list[np.ndarray]:
    """q, v (and accelerations) `[S, K, n]` as the encoders have them at each step, without
    noise.
    """
    out = [run.q.copy(), run.v.copy()] + ([run.a.copy()] if accelerations else [])
    for e in effects:
        for j, p in e.each():
            one = [z[:, :, j] for z in out]
            if e.name in ("drive_elasticity", "drive_play") and p["link_side"]:
                one = [one[0] + run.twist[0][:, :, j], one[1] + run.twist[1][:, :, j], *one[2:]]
            elif e.name == "encoder_scale":
                one = [(1 + p["scale"]) * z for z in one]
            elif e.name == "encoder_offset":
                one[0] = one[0] + p["offset"]
            elif e.name == "sensor_delay":
                back = np.maximum(np.arange(len(run.q)) - round(p["delay"] / STEP), 0)
                one = [z[back] for z in one]
            elif e.name == "sensor_lag":
                one = [lagged(z, p["lag"]) for z in one]
            elif e.name == "backlash":
                one[0], engaged = play(one[0], p["gap"])
                one[1] = one[1] * engaged
            for z, x in zip(out, one, strict=True):
                z[:, :, j] = x
    return out


def lagged(z: np.ndarray, lag: float) -> np.ndarray:
    """First-order filter along the first axis, begun at rest on the first value."""
    out, keep = z.copy(), np.exp(-STEP / lag)
    for s in range(1, len(z)):
        out[s] = z[s] + (out[s - 1] - z[s]) * keep
    return out


def play(z: np.ndarray, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """What follows z at a distance of at most gap / 2, and whether it moves with it."""
    out, engaged = z.copy(), np.ones(z.shape)
    for s in range(1, len(z)):
        out[s] = np.clip(out[s - 1], z[s] - gap / 2, z[s] + gap / 2)
        engaged[s] = out[s] != out[s - 1]
    return out, engaged


def logged_command(run: Run, drive: Drive, effects: tuple[Effect, ...]) -> np.ndarray:
    """Commands `[K, R, n]` as logged; a log that is late has what was applied before."""
    out = run.command.copy()
    lane = np.arange(len(drive.rows))[:, None]
    for e in effects:
        if e.name == "delay":
            for j, p in e.each():
                if p["delay"] < 0:
                    back = np.maximum(drive.rows + round(p["delay"] / STEP), 0)
                    out[:, :, j] = run.sent[back, lane, j]
    return out
