"""Tosses by MuJoCo in C over all cores: what motion capture would say of them, and the start of
each as it is recorded.

A start is `[13]`: place m, quaternion (w first), velocity m/s, turning rate rad/s in the body's
axes. All are as recorded. An effect of the measurement so moves what is simulated, and leaves the
start near the recording.
"""

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco import rollout

from adaptsim_jax.core.parallel import cores
from adaptsim_jax.mechanisms.quaternions import from_rotvec, inverse, rotated, times
from adaptsim_jax.tasks.toss.body import MIN_FRICTION, TossedBody, with_values
from adaptsim_jax.tasks.toss.catalogue import CHUNKED

AT_ONCE = 256  # simulations in memory
CHUNK = 0.004  # s between looks at the motion, where friction or damping depend on it
USUAL, SLOW = (
    0.5,
    0.05,
)  # m/s: the speed at which damping is as declared; below the second it changes no more


def poses(
    body: TossedBody, names: Sequence[str], values: np.ndarray, start: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places `[N, R, 3]` m and quaternions `[N, R, 4]` as recorded at `time [N, R]` s since each
    start; `values [N, P]` of `names`.

    Where MuJoCo's state is not finite any more, places are far away, not NaN.
    """
    place, turn = np.empty((*time.shape, 3)), np.empty((*time.shape, 4))
    order = np.argsort(
        time.max(1), kind="stable"
    )  # what is simulated together is so for as long as its longest
    for at in range(0, len(values), AT_ONCE):
        part = order[at : at + AT_ONCE]
        v = {n: values[part, i] for i, n in enumerate(names)}
        begun = _begun(v, start[part])
        clock = (1.0 + v["clock"])[:, None] * time[part]
        rows = _rolled(body, names, values[part], begun, clock)
        place[part], turn[part] = _recorded(v, *rows)
    return place, turn


def _frames(v: Mapping[str, np.ndarray]):
    """Turn of the recording's frame against the plane's, of the recorded axes against the body's,
    and the recorded point.
    """
    zero = np.zeros_like(v["plane_x"])
    frame = from_rotvec(np.stack([v["plane_x"], v["plane_y"], zero], -1))
    axes = from_rotvec(np.stack([v[f"turned_{c}"] for c in "xyz"], -1))
    return frame, axes, np.stack([v[f"off_{c}"] for c in "xyz"], -1)


def _begun(v: Mapping[str, np.ndarray], start: np.ndarray) -> np.ndarray:
    """States `[N, 13]` of MuJoCo (place, quaternion, velocity, rate) of starts `[N, 13]` as
    recorded.
    """
    frame, axes, off = _frames(v)
    back, grown, fast = inverse(frame), 1.0 + v["scale"], 1.0 + v["clock"]
    turn = times(times(back, start[:, 3:7]), inverse(axes))
    rate = rotated(axes, start[:, 10:]) / fast[:, None]
    arm = rotated(turn, off)
    lifted = start[:, :3] - np.stack([0 * v["height"], 0 * v["height"], v["height"]], -1)
    place = rotated(back, lifted) / grown[:, None] - arm
    of_arm = np.cross(rotated(turn, rate), arm)
    speed = rotated(back, start[:, 7:10]) / (grown * fast)[:, None] - of_arm
    return np.concatenate([place, turn, speed, rate], 1)


def _recorded(
    v: Mapping[str, np.ndarray], place: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Simulated poses `[N, R, 3]`, `[N, R, 4]` as recorded."""
    frame, axes, off = (z[:, None] for z in _frames(v))
    observed = (1.0 + v["scale"])[:, None, None] * rotated(frame, place + rotated(turn, off))
    observed[..., 2] += v["height"][:, None]
    return observed, times(times(frame, turn), axes)


def _rolled(body: TossedBody, names, values, state, time) -> tuple[np.ndarray, np.ndarray]:
    """Poses `[N, R, 3]`, `[N, R, 4]` of the simulation at `time [N, R]` s, between whose steps is
    interpolated.
    """
    step = body.step
    count = max(2, math.ceil(float(time.max()) / step) + 1)
    full = np.concatenate([np.zeros((len(state), 1)), state], 1)
    chunked = [i for i, n in enumerate(names) if n in CHUNKED]
    own = np.any(values[:, chunked] != 0.0, axis=1)
    rows = np.empty((len(state), count + 1, 7))
    rows[:, 0] = state[:, :7]
    pool = [mujoco.MjData(body.model) for _ in range(cores())]
    for at in (np.flatnonzero(~own), np.flatnonzero(own)):
        if len(at) == 0:
            continue
        if own[at[0]]:
            rows[at, 1:] = _in_chunks(body, names, values[at], full[at], count, pool)
        else:
            different, which = np.unique(values[at], axis=0, return_inverse=True)
            models = [with_values(body, dict(zip(names, z, strict=True))) for z in different]
            of_rows = [models[i] for i in which.ravel()]
            rows[at, 1:] = _run(of_rows, pool, full[at], count)[:, :, 1:8]
    rows = np.where(np.isfinite(rows), rows, 1e3)
    place = np.clip(time / step, 0.0, count - 1e-9)
    k = np.floor(place).astype(int)
    u = (place - k)[..., None]
    i = np.arange(len(rows))[:, None]
    between = (1.0 - u) * rows[i, k] + u * rows[i, k + 1]
    turn = between[..., 3:]
    return between[..., :3], turn / np.linalg.norm(turn, axis=-1, keepdims=True)


def _run(
    models: Sequence[mujoco.MjModel], pool: Sequence[mujoco.MjData], full: np.ndarray, count: int
) -> np.ndarray:
    return rollout.rollout(models, pool, full, nstep=count, skip_checks=False)[0]


def _in_chunks(body: TossedBody, names, values, full, count: int, pool) -> np.ndarray:
    """As `_run`, with friction and damping of what the body does at each chunk's start. That is
    the slip of the point below its middle at the plane's height, and the speed towards or away
    from the plane.
    """
    v = {n: values[:, i] for i, n in enumerate(names)}
    models = [with_values(body, dict(zip(names, z, strict=True))) for z in values]
    each, out = max(1, round(CHUNK / body.step)), []
    for done in range(0, count, each):
        slip = full[:, 8:10] + _below(full)
        speed = np.linalg.norm(slip, axis=1)
        twice = 2.0 * np.arctan2(slip[:, 1], slip[:, 0])
        grain = v["grain_a"] * np.cos(twice) + v["grain_b"] * np.sin(twice)
        friction = v["friction"] * np.maximum(
            (1.0 + v["speed_friction"] * speed) * (1.0 + grain), MIN_FRICTION
        )
        hard = np.maximum(np.abs(full[:, 10]), SLOW) / USUAL
        damping = np.clip(v["damping"] * hard ** v["rebound"], 0.01, 5.0)
        for m, mu, ratio in zip(models, friction, damping, strict=True):
            m.geom_friction[body.geoms, 0] = mu
            m.geom_solref[body.geoms, 1] = ratio
        rows = _run(models, pool, full, min(each, count - done))
        out.append(rows[:, :, 1:8])
        full = rows[:, -1]
    return np.concatenate(out, 1)


def _below(full: np.ndarray) -> np.ndarray:
    """Velocity `[N, 2]` m/s, beside the middle's, of the point below it in the plane."""
    rate = rotated(full[:, 4:8], full[:, 11:14])
    return np.stack([-rate[:, 1] * full[:, 3], rate[:, 0] * full[:, 3]], 1)
