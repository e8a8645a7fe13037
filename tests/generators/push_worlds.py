"""Pushes whose truth is known, by NumPy from the physics as written down in docs/pushing.md; shares no code with the package.

    python -m tests.generators.push_worlds single 3 FOLDER

`write_world` leaves `recording/` (meta.toml, actions.csv, tracks.csv) and `truth.json`. Kinds: null; single, one effect of the
catalogue; outside, one that is in none. Seeds 0-999 are for tuning, from 10000 on for scoring.
"""

import json
import sys
from pathlib import Path

import numpy as np

G, H = 9.81, 1e-4  # m/s^2, s
START = np.array([0.56, 0.0])
KINDS = ("null", "single", "outside")
SINGLE = (
    "speed_scale", "speed_offset", "heading_offset", "late_start", "start_pose", "hit_speed", "tilt", "viscous_friction",
    "quadratic_friction", "grain", "patch_place", "patch_size", "second_patch", "camera_shift", "camera_scale",
    "camera_rotation", "camera_latency", "clock_scale",
)  # fmt: skip
OUTSIDE = ("gust", "curling", "lens", "pulsing_friction", "wet_strip")
CLASSES = (
    {"heading_offset", "camera_rotation"}, {"late_start", "camera_latency"}, {"speed_scale", "speed_offset"},
    {"start_pose", "camera_shift"}, {"viscous_friction", "quadratic_friction"},
)  # fmt: skip
"""Effects that do the same to all that is measured, or nearly."""


def sizes(rng: np.random.Generator, name: str) -> dict[str, float]:
    """How large an effect is drawn."""
    either = lambda low, high: float(rng.choice([-1, 1]) * rng.uniform(low, high))
    return {
        "speed_scale": lambda: {"share": either(0.05, 0.12)}, "speed_offset": lambda: {"add": either(0.03, 0.07)},
        "heading_offset": lambda: {"angle": either(0.03, 0.1)}, "late_start": lambda: {"time": float(rng.uniform(0.02, 0.08))},
        "start_pose": lambda: {"x": either(0.004, 0.015), "y": either(0.004, 0.012)}, "hit_speed": lambda: {"power": either(0.4, 0.9)},
        "tilt": lambda: {"x": either(0.008, 0.02), "y": either(0.008, 0.02)},
        "viscous_friction": lambda: {"rate": float(rng.uniform(0.3, 1.0))},
        "quadratic_friction": lambda: {"per_m": float(rng.uniform(0.5, 1.5))},
        "grain": lambda: {"ratio": float(rng.uniform(1.4, 2.2)), "angle": float(rng.uniform(-1.4, 1.4))},
        "patch_place": lambda: {"x": either(0.03, 0.06)}, "patch_size": lambda: {"side": either(0.03, 0.05)},
        "second_patch": lambda: {"mu": float(rng.uniform(0.3, 0.6)), "x": float(rng.uniform(0.88, 1.0)), "y": either(0.0, 0.08)},
        "camera_shift": lambda: {"x": either(0.004, 0.015), "y": either(0.004, 0.015)},
        "camera_scale": lambda: {"share": either(0.02, 0.07)},
        "camera_rotation": lambda: {"angle": either(0.03, 0.1)}, "camera_latency": lambda: {"time": float(rng.uniform(0.02, 0.08))},
        "clock_scale": lambda: {"share": either(0.03, 0.1)},
        "gust": lambda: {"push": either(0.25, 0.5), "from": 0.45, "to": 0.9}, "curling": lambda: {"rate": either(0.25, 0.5)},
        "lens": lambda: {"bend": either(0.5, 1.2)}, "pulsing_friction": lambda: {"share": float(rng.uniform(0.4, 0.7)), "hertz": 6.0},
        "wet_strip": lambda: {"x": float(rng.uniform(0.8, 0.9)), "share": 0.2},
    }[name]()  # fmt: skip


def profile(t: np.ndarray) -> np.ndarray:
    """Forward speed of the arm by its command: still 10 ms, up in 0.2 s, 0.1 s held, down in 0.5 s."""
    return np.interp(t, [0.0, 0.01, 0.21, 0.31, 0.81, 1e3], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])


def simulate(
    rng, physics: dict, actions: np.ndarray, seconds: float, effect: str | None, size: dict
) -> tuple[np.ndarray, np.ndarray]:
    """Places [S, N, 2] m of all pushes at steps of `H`, and their times [S] s."""
    n, steps = len(actions), round(seconds / H)
    is_ = lambda name: effect == name
    speed, angle = actions[:, 0].copy(), actions[:, 1].copy()
    speed = speed * (1 + size["share"]) if is_("speed_scale") else speed + size["add"] if is_("speed_offset") else speed
    angle = angle + (size["angle"] if is_("heading_offset") else 0.0)
    along = np.stack([np.cos(angle), np.sin(angle)], 1)
    aside = np.stack([-along[:, 1], along[:, 0]], 1)
    start = START + ([size["x"], size["y"]] if is_("start_pose") else [0.0, 0.0])
    x, v = np.repeat(start[None], n, 0).astype(float), np.zeros((n, 2))
    # the plate's contact: a damped spring whose constants follow e and the speed of the hit
    u, hard = np.log10(physics["e"]) - 5.0, np.log((speed + 0.8 * 0.1175) / 0.7)
    w = np.exp(
        np.clip(
            3.685 + 0.224 * u + 0.268 * u * u + (-0.449 + (size["power"] if is_("hit_speed") else 0.0)) * hard,
            np.log(10),
            np.log(200),
        )
    )
    zeta = np.exp(np.clip(-1.460 + 0.301 * u + 0.055 * u * u + 0.824 * hard, np.log(0.005), np.log(3)))
    k, b = w * w, np.minimum(2 * zeta * w, 250.0)
    ring = np.pi / 3 * np.arange(6)
    feet = 0.03 * 1.002 * np.concatenate([
        np.sqrt(0.25) * np.stack([np.cos(ring + np.pi / 6), np.sin(ring + np.pi / 6)], 1),
        np.sqrt(0.75) * np.stack([np.cos(ring), np.sin(ring)], 1)])  # fmt: skip
    time = np.arange(steps + 1) * H
    late = size["time"] if is_("late_start") else 0.0
    rate = profile(time - late)
    travel = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * H])
    pitch = 0.8 * travel
    swing = 0.1175 * np.sin(pitch)
    swing_v = np.gradient(swing, H)
    slope, swing_a = np.gradient(rate, H), np.gradient(np.gradient(swing, H), H)
    behind = (START - start) @ along.T - (0.15 - 0.0025 - 0.03)
    pull = G * np.sin([size["x"], size["y"]]) if is_("tilt") else np.zeros(2)
    inside = lambda d, side: np.clip((side / 2 - np.abs(d)) / 0.002 + 0.5, 0, 1)
    side = 0.10 + (size["side"] if is_("patch_size") else 0.0)
    px = 0.75 + (size["x"] if is_("patch_place") else 0.0)
    out = np.zeros((steps + 1, n, 2))
    out[0] = x
    for i in range(steps):
        foot = x[:, None] + feet
        cover = (inside(foot[..., 0] - px, side) * inside(foot[..., 1] - physics["y_p"], side)).mean(1)
        mu = physics["mu"] + cover * (physics["mu_p"] - physics["mu"])
        if is_("second_patch"):
            spot = (inside(foot[..., 0] - size["x"], 0.06) * inside(foot[..., 1] - size["y"], 0.06)).mean(1)
            mu = mu + spot * (size["mu"] - physics["mu"])
        if is_("pulsing_friction"):
            mu = mu * (1 + size["share"] * np.sin(2 * np.pi * size["hertz"] * time[i]))
        if is_("wet_strip"):
            mu = np.where(np.abs(x[:, 0] - size["x"]) < 0.04, size["share"] * mu, mu)
        s, vs, vt = ((x - start) * along).sum(1), (v * along).sum(1), (v * aside).sum(1)
        depth = speed * travel[i] + swing[i] + behind - s
        plate_v, plate_a = speed * rate[i] + swing_v[i], speed * slope[i] + swing_a[i]
        free = plate_a + np.where(vs > 0, mu * G, 0.0)
        force = np.where(depth > 0, np.maximum(b * (plate_v - vs) + k * depth + 0.9 * free, 0.0), 0.0)
        rub = np.clip(-vt / H, -0.3 * force, 0.3 * force)
        a = force[:, None] * along + rub[:, None] * aside + pull
        if is_("gust") and size["from"] < time[i] < size["to"]:
            a = a + np.array([0.0, size["push"]])
        if is_("curling"):
            a = a + size["rate"] * np.stack([-v[:, 1], v[:, 0]], 1)
        v = v + H * a
        fast = np.sqrt((v * v).sum(1)) + 1e-12
        brake = mu * np.maximum(G - 0.292 * force, 0.0)
        brake = (
            brake
            + (size["rate"] * fast if is_("viscous_friction") else 0.0)
            + (size["per_m"] * fast**2 if is_("quadratic_friction") else 0.0)
        )
        way = v / fast[:, None]
        if is_("grain"):
            g = np.array([np.cos(size["angle"]), np.sin(size["angle"])])
            way = way + (size["ratio"] - 1) * (way - (way @ g)[:, None] * g)
        left = 1.0 - H * brake * (way * v).sum(1) / fast**2
        v = np.where((left > 0)[:, None], v - H * brake[:, None] * way, 0.0)
        x = x + H * v
        out[i + 1] = x
    return out, time


def seen(place: np.ndarray, effect: str | None, size: dict) -> np.ndarray:
    """What the camera makes of places [..., 2]."""
    away = place - START
    if effect == "camera_scale":
        away = away * (1 + size["share"])
    if effect == "camera_rotation":
        c, s = np.cos(size["angle"]), np.sin(size["angle"])
        away = away @ np.array([[c, s], [-s, c]])
    if effect == "lens":
        away = away * (1 + size["bend"] * (away**2).sum(-1, keepdims=True))
    return START + away + ([size["x"], size["y"]] if effect == "camera_shift" else [0.0, 0.0])


def write_world(folder: str | Path, kind: str, seed: int, effect: str | None = None) -> Path:
    """Write `recording/` and `truth.json` into `folder`; returns it."""
    rng = np.random.default_rng([KINDS.index(kind), seed, 40])
    if kind != "null":
        effect = effect or str(rng.choice(SINGLE if kind == "single" else OUTSIDE))
    size = sizes(rng, effect) if effect else {}
    physics = {
        "mu": rng.uniform(0.07, 0.18),
        "e": 10 ** rng.uniform(4.2, 5.8),
        "mu_p": rng.uniform(0.25, 0.7),
        "y_p": rng.uniform(-0.08, 0.08),
    }
    count, fps = int(rng.integers(12, 25)), float(rng.choice([30.0, 60.0, 60.0]))
    actions = np.stack([rng.uniform(0.4, 0.8, count), rng.uniform(-0.3, 0.3, count)], 1)
    seconds, noise = 1.4, 5e-4
    place, time = simulate(rng, physics, actions, seconds + 0.2, effect, size)
    rows = []
    for n in range(count):
        stamp = np.arange(rng.uniform(0, 1 / fps), seconds - rng.uniform(0, 0.1), 1 / fps)
        stamp = stamp[rng.random(len(stamp)) > 0.03]
        at = (
            stamp * (1 + size["share"])
            if effect == "clock_scale"
            else stamp - (size["time"] if effect == "camera_latency" else 0.0)
        )
        path = np.stack([np.interp(at, time, place[:, n, k]) for k in range(2)], 1)
        path = seen(path, effect, size) + noise * rng.normal(size=path.shape)
        rows += [f"{n + 1},{t:.5f},{p[0]:.6f},{p[1]:.6f}" for t, p in zip(stamp, path, strict=True)]
    out = Path(folder)
    (out / "recording").mkdir(parents=True, exist_ok=True)
    (out / "recording" / "meta.toml").write_text('task = "pushing"\n')
    told = [f"{n + 1},{a[0]:.6f},{a[1]:.6f}" for n, a in enumerate(actions)]
    (out / "recording" / "actions.csv").write_text("trial,speed,angle\n" + "\n".join(told) + "\n")
    (out / "recording" / "tracks.csv").write_text("trial,time,x,y\n" + "\n".join(rows) + "\n")
    alike = sorted(set().union(*[c for c in CLASSES if effect in c])) or ([effect] if effect else [])
    truth = {
        "kind": kind,
        "seed": seed,
        "effect": effect,
        "size": size,
        "accept": alike,
        "physics": physics,
        "fps": fps,
        "pushes": count,
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=1))
    return out


if __name__ == "__main__":
    print(write_world(sys.argv[3], sys.argv[1], int(sys.argv[2])))
