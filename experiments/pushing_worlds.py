"""Worlds of pushes: tracks that a camera would record, from the physics of the push written anew,
with or without an effect.

Shares no code with the package: NumPy, semi-implicit Euler at 0.2 ms. The sole is the declared one,
twelve points of equal area: along a patch's edge their number is physics of the model (24 points
stop one such push 31 mm elsewhere). All worlds of a suite are simulated side by side.

    # writes a folder for each world
    python experiments/pushing_worlds.py --suite singles --seed 1 --out worlds/
"""

import argparse
import json
from pathlib import Path

import numpy as np

G, RADIUS, TALL, START = 9.81, 0.03, 0.1, (0.56, 0.0)
STEP, LENGTH = 2e-4, 1.3
# s simulated beyond `LENGTH`: bottles may be on their way then, and a camera with a fast clock
# looks later
LATE = 0.25
PITCH, DROP = 0.8, 0.1175  # rad/s of the plate while it runs at full profile; m from link to edge
COEFFICIENTS = (
    (3.685, 0.224, 0.268),
    (-1.460, 0.301, 0.055),
    (-0.449, 0.824),
    0.292,
    1.002,
)  # twin of the MuJoCo scene


def foot():
    """Points `[12, 2]` of equal area of a disc of radius 1: six at half of it, six at the root of
    three quarters.
    """
    a = np.radians(60.0 * np.arange(6))

    def ring(r, a):
        return r * np.stack([np.cos(a), np.sin(a)], 1)

    return np.concatenate([ring(0.5, a + np.pi / 6), ring(np.sqrt(0.75), a)])


def profile(t):
    """Share of full speed at time `t` s: still 10 ms, up in 0.2 s, held 0.1 s, down in 0.5 s."""
    return np.interp(t, [0, 0.01, 0.21, 0.31, 0.81], [0, 0, 1, 1, 0])


ZERO = dict.fromkeys(
    "speed_scale speed_offset heading_offset start_x start_y hardening plate_turn tilt_x tilt_y "
    "speed_friction drag grain grain_angle patch_x patch_size other_x other_y other_mu shift_x "
    "shift_y scale scale_start turn turn_start latency clock ridge ridge_x bowl gradient "
    "lens heading_gain side_speed swerve warm scatter com_x com_y light heavier near foot_x "
    "foot_y".split(),
    0.0,
)


def simulate(lanes, rate=500):  # noqa: PLR0915
    """Places m and yaw rad `[B, N, 3]` every `1 / rate` s of all lanes: dict of arrays `[B]` (mu,
    e, mu_p, y_p, speed, angle, and of `ZERO`).
    """
    p = {k: np.asarray(v, float) for k, v in lanes.items()}
    count = len(p["mu"])
    angle = p["angle"] * (1 + p["heading_gain"]) + p["heading_offset"]
    speed = p["speed"] * (1 + p["speed_scale"] + p["side_speed"] * p["angle"]) + p["speed_offset"]
    hx, hy = np.cos(angle), np.sin(angle)
    nx, ny = np.cos(angle + p["plate_turn"]), np.sin(angle + p["plate_turn"])
    frequency, damping, more, lift, sole = COEFFICIENTS
    u, h = np.log10(p["e"]) - 5, np.log((speed + PITCH * DROP) / 0.7)
    w = np.exp(frequency[0] + frequency[1] * u + frequency[2] * u * u + more[0] * h)
    zeta = np.exp(damping[0] + damping[1] * u + damping[2] * u * u + more[1] * h)
    w, zeta = np.clip(w, 10, 200), np.clip(zeta, 0.005, 3)
    by_mass = np.exp(p["hardening"] * h) / (
        1 + p["heavier"]
    )  # the same spring and damper, on another mass
    k, b = w * w * by_mass, np.minimum(2 * zeta * w, 250) * by_mass
    x, y = START[0] + p["start_x"], START[1] + p["start_y"]
    # face of the plate, a point of it and its place along the normal; the link starts 15 cm behind
    # the declared start
    back = 0.15 - 0.0025 - RADIUS
    vx, vy = np.zeros(count), np.zeros(count)
    yaw, spin = np.zeros(count), np.zeros(count)
    turns = np.any(p["light"])
    points = RADIUS * sole * foot()
    travel, keep, out = 0.0, round(1 / rate / STEP), []
    c, s = np.cos(2 * p["grain_angle"]), np.sin(2 * p["grain_angle"])
    warm = 1 + p["warm"]

    def cover(px, py, half):
        def inside(d):
            return np.clip((half[:, None] - np.abs(d)) / 0.002 + 0.5, 0, 1)

        qx, qy = x[:, None] + points[:, 0] - px[:, None], y[:, None] + points[:, 1] - py[:, None]
        return inside(qx) * inside(qy)

    half = np.full(count, 0.05)
    any_other = np.any(p["other_mu"])
    for n in range(round((LENGTH + LATE) / STEP)):
        if n % keep == 0:
            out.append(np.stack([x, y, yaw], 1))
        t = n * STEP
        f, f1 = profile(t), profile(t + STEP)
        slope = (f1 - f) / STEP
        pitch = PITCH * travel
        reach = speed * travel + DROP * np.sin(pitch)
        rate_e = speed * f + DROP * np.cos(pitch) * PITCH * f
        gain = speed * slope + DROP * (
            np.cos(pitch) * PITCH * slope - np.sin(pitch) * (PITCH * f) ** 2
        )
        ahead = hx * nx + hy * ny
        side = -hx * ny + hy * nx
        gap = (START[0] - x) * nx + (START[1] - y) * ny + (reach - back) * ahead
        each = p["mu"] + cover(0.75 + p["patch_x"], p["y_p"], half + p["patch_size"]).T * (
            p["mu_p"] - p["mu"]
        )
        if any_other:
            each = each + p["other_mu"] * cover(p["other_x"], p["other_y"], half).T
        v = np.hypot(vx, vy)
        each = np.maximum(
            each * warm * (1 + p["speed_friction"] * v + p["gradient"] * (x - START[0])), 0
        )
        each = each + p["ridge"] * (np.abs(x - p["ridge_x"]) < 0.004)
        mu = each.mean(0)
        vn = vx * nx + vy * ny
        free = gain * ahead + np.where(vn > 0, mu * G, 0)
        force = np.where(
            gap > 0, np.maximum(b * (rate_e * ahead - vn) + k * gap + 0.9 * free, 0), 0
        )
        vt = -vx * ny + vy * nx
        slip = np.clip(rate_e * side - vt, -0.3 * force * STEP, 0.3 * force * STEP)
        if turns:
            x, y, vx, vy, yaw, spin = _turned(
                p,
                (x, y, vx, vy, yaw, spin),
                (force, rate_e * side - vt, nx, ny),
                each,
                np.maximum(G - lift * force, 0),
                points,
            )
            travel += STEP * (f + f1) / 2
            continue
        ax = force * nx + G * np.sin(p["tilt_x"]) - p["drag"] * vx - p["swerve"] * vy
        ay = (
            force * ny + G * np.sin(p["tilt_y"]) - p["drag"] * vy + p["swerve"] * vx - p["bowl"] * y
        )
        vx, vy = vx + STEP * ax - slip * ny, vy + STEP * ay + slip * nx
        # friction against B v / sqrt(v B v), greatest dissipation in an elliptic cone; grain_angle
        # is the smooth direction
        bx = vx - p["grain"] * (c * vx + s * vy)
        by = vy - p["grain"] * (s * vx - c * vy)
        share = STEP * mu * np.maximum(G - lift * force, 0) / np.sqrt(vx * bx + vy * by + 1e-18)
        vx, vy = np.where(share < 1, vx - share * bx, 0), np.where(share < 1, vy - share * by, 0)
        x, y = x + STEP * vx, y + STEP * vy
        travel += STEP * (f + f1) / 2
    out.append(np.stack([x, y, yaw], 1))
    return np.stack(out, 1)


def _turned(p, state, hit, each, pressed, points):
    """A step of a bottle that turns: force of the plate along its normal, friction there and at
    each point of the sole. Momentum and moment about the axis, which is not where the mass is: M a
    + bias = f, solved for the axis's acceleration and the spin's.
    """
    x, y, vx, vy, yaw, spin = state
    force, aside, nx, ny = hit
    c, s = np.cos(yaw), np.sin(yaw)
    cx, cy = c * p["com_x"] - s * p["com_y"], s * p["com_x"] + c * p["com_y"]
    about = 1 / p["light"] + cx * cx + cy * cy  # moment of inertia about the axis, by mass
    zero, one = np.zeros_like(x), np.ones_like(x)
    mass = np.stack(
        [np.stack(r, -1) for r in ((one, zero, -cy), (zero, one, cx), (-cy, cx, about))], -2
    )
    # what the plate's friction would need to hold the rim still, and no more than it can
    jt = np.stack([-ny, nx, -RADIUS * one], -1)
    per = np.einsum("bi,bij,bj->b", jt, np.linalg.inv(mass), jt)
    grip = np.clip((aside + RADIUS * spin) / per, -0.3 * force * STEP, 0.3 * force * STEP)
    push = STEP * np.stack([force * nx, force * ny, zero], -1) + grip[:, None] * jt
    push += (
        STEP * np.square(spin)[:, None] * np.stack([cx, cy, zero], -1)
    )  # the mass goes round the axis
    v = np.stack([vx, vy, spin], -1) + np.linalg.solve(mass, push[..., None])[..., 0]
    # Coulomb at each point, with a floor of the slip below which it is viscous
    lx, ly = points[:, 0][:, None], points[:, 1][:, None]
    ux, uy = v[:, 0] - v[:, 2] * ly, v[:, 1] + v[:, 2] * lx
    share = (1 + (p["com_x"] * lx + p["com_y"] * ly) / np.mean(points[:, 0] ** 2)) / len(points)
    load = each * share * pressed
    slow = 2 * STEP * load.sum(0) * (1 + p["light"] * RADIUS**2)
    f = -load / np.maximum(np.hypot(ux, uy), slow)
    total = STEP * np.stack(
        [(f * ux).sum(0), (f * uy).sum(0), (lx * f * uy - ly * f * ux).sum(0)], -1
    )
    v = v + np.linalg.solve(mass, total[..., None])[..., 0]
    return x + STEP * v[:, 0], y + STEP * v[:, 1], v[:, 0], v[:, 1], yaw + STEP * v[:, 2], v[:, 2]


def camera(p, tracks, rate, rng, fps=60.0, noise=5e-4, turned=0.0):
    """What a camera says of one push, lane `p` (scalars): rows (time, x, y), and where `turned` rad
    of noise is given yaw, of a marker that is glued on at any angle and seen in 95 % of the rows.
    """
    t = np.arange(rng.uniform(0, 0.2) / fps, LENGTH + rng.uniform(0, 0.1), 1 / fps)
    when = (1 + p["clock"]) * t - p["latency"]
    grid = np.arange(len(tracks)) / rate
    if when[-1] > grid[-1]:
        raise ValueError(
            f"the camera looks at {when[-1]:.3f} s, and the bottle was moved until {grid[-1]:.3f} s"
        )
    xy = np.stack([np.interp(when, grid, tracks[:, i]) for i in range(2)], 1)

    def turn(z, a):
        return z @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])

    # the ray from a camera 1 / near above (foot_x, foot_y) through the bottle's top meets the table
    # beyond the bottle
    foot = np.array([p["foot_x"], p["foot_y"]])
    xy = foot + (xy - foot) / (1 - TALL * p["near"])
    xy = np.array(START) + (1 + p["scale_start"]) * turn(xy - START, p["turn_start"])
    xy = (1 + p["scale"]) * turn(xy, p["turn"]) + [p["shift_x"], p["shift_y"]]
    away = xy - [0.8, 0.0]
    xy = xy + p["lens"] * away * np.square(away).sum(1, keepdims=True)
    xy += noise * rng.standard_normal(xy.shape)
    kept = rng.random(len(t)) > 0.03
    if turned:
        yaw = (
            np.interp(when, grid, tracks[:, 2])
            + rng.uniform(-np.pi, np.pi)
            + turned * rng.standard_normal(len(t))
        )
        yaw = np.where(rng.random(len(t)) > 0.05, (yaw + np.pi) % (2 * np.pi) - np.pi, np.nan)
        return np.column_stack([t, xy, yaw])[kept]
    return np.column_stack([t, xy])[kept]


def sign(rng):
    return rng.choice([-1.0, 1.0])


def _two(names, low, high):
    def draw(rng):
        a, r = rng.uniform(0, 2 * np.pi), rng.uniform(low, high)
        return {names[0]: r * np.cos(a), names[1]: r * np.sin(a)}

    return draw


def _one(name, low, high):
    return lambda rng: {name: sign(rng) * rng.uniform(low, high)}


SINGLES = {
    "speed_scale": _one("speed_scale", 0.05, 0.15),
    "speed_offset": _one("speed_offset", 0.03, 0.08),
    "heading_offset": _one("heading_offset", 0.04, 0.12),
    "start_pose": _two(("start_x", "start_y"), 0.006, 0.02),
    "placement": lambda rng: {"scatter": rng.uniform(0.005, 0.01)},
    "hardening": _one("hardening", 0.6, 1.4),
    "plate_turn": _one("plate_turn", 0.06, 0.2),
    "tilt": _two(("tilt_x", "tilt_y"), 0.015, 0.05),
    "speed_friction": lambda rng: {
        "speed_friction": rng.choice([rng.uniform(0.8, 2.5), -rng.uniform(0.35, 0.6)])
    },
    "drag": lambda rng: {"drag": rng.uniform(0.4, 1.5)},
    "grain": lambda rng: {
        "grain": rng.uniform(0.2, 0.5),
        "grain_angle": rng.uniform(-np.pi / 2, np.pi / 2),
    },
    "patch_place": _one("patch_x", 0.025, 0.06),
    "patch_size": lambda rng: {
        "patch_size": rng.choice([rng.uniform(0.015, 0.04), -rng.uniform(0.015, 0.03)])
    },
    "second_patch": lambda rng: {
        "other_x": rng.uniform(0.68, 0.9),
        "other_y": rng.uniform(-0.1, 0.1),
        "other_mu": rng.uniform(0.2, 0.6),
    },
    "camera_shift": _two(("shift_x", "shift_y"), 0.005, 0.02),
    "camera_scale": _one("scale", 0.03, 0.1),
    "camera_scale_at_start": _one("scale_start", 0.03, 0.1),
    "camera_turn": _one("turn", 0.03, 0.1),
    "camera_turn_at_start": _one("turn_start", 0.03, 0.1),
    "latency": lambda rng: {"latency": rng.uniform(0.015, 0.06)},
    "clock_scale": _one("clock", 0.03, 0.1),
}
TURNING = {
    "off_axis": lambda rng: (
        _two(("com_x", "com_y"), 0.002, 0.006)(rng) | {"light": rng.uniform(1.0, 2.0) / RADIUS**2}
    ),
}
MORE = {
    "turning": lambda rng: {"light": rng.uniform(1.0, 2.0) / RADIUS**2},
    "parallax": lambda rng: {
        "near": 1 / rng.uniform(0.8, 2.0),
        "foot_x": rng.uniform(0.5, 1.1),
        "foot_y": rng.uniform(-0.4, 0.4),
    },
    "mass": lambda rng: {"heavier": rng.choice([rng.uniform(0.5, 1.5), -rng.uniform(0.35, 0.6)])},
}
OUTSIDE = {
    "ridge": lambda rng: {"ridge": rng.uniform(2, 5), "ridge_x": rng.uniform(0.66, 0.74)},
    "bowl": lambda rng: {"bowl": rng.uniform(2, 5)},
    "gradient": lambda rng: {"gradient": rng.uniform(2, 5)},
    "lens": _one("lens", 0.3, 0.8),
    "heading_gain": _one("heading_gain", 0.15, 0.4),
    "side_speed": _one("side_speed", 0.2, 0.5),
    "swerve": _one("swerve", 0.15, 0.4),
    "warm": lambda rng: {"warm": rng.uniform(0.3, 0.8)},
    "random_friction": lambda rng: {"warm": -rng.uniform(0.15, 0.4)},
    "random_heading": lambda rng: {"heading_offset": np.nan},
}


def world(kind, seed, pushes=18):
    """Lanes of one world: dict of arrays `[pushes]`, and what is true of it. kind: `null`, or of
    the dicts above.
    """
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    lanes = {k: np.zeros(pushes) for k in ZERO}
    truth = {
        "mu": rng.uniform(0.05, 0.2),
        "e": 10 ** rng.uniform(4, 6),
        "mu_p": rng.uniform(0.2, 0.8),
        "y_p": rng.uniform(-0.1, 0.1),
    }
    for k, v in truth.items():
        lanes[k] = np.full(pushes, v)
    lanes["speed"], lanes["angle"] = (
        rng.permutation(np.linspace(0.4, 0.8, pushes)),
        rng.permutation(np.linspace(-0.3, 0.3, pushes)),
    )
    given = {} if kind == "null" else (SINGLES | TURNING | MORE | OUTSIDE)[kind](rng)
    for k, v in given.items():
        lanes[k] = np.full(pushes, v)
    if kind == "placement":
        for k in ("start_x", "start_y"):
            lanes[k] = lanes["scatter"] * rng.standard_normal(pushes)
    if kind == "warm":
        lanes["warm"] = given["warm"] * np.exp(-np.arange(pushes) / 5)
    if kind == "random_friction":
        lanes["warm"] = given["warm"] * rng.standard_normal(pushes).clip(-1.5, 1.5)
    if kind == "random_heading":
        lanes["heading_offset"] = rng.uniform(0.03, 0.06) * rng.standard_normal(pushes)
    return lanes, truth | {"kind": kind, "seed": seed} | {k: float(v) for k, v in given.items()}


def suite(name, seed, count=None):
    """Kinds and seeds of a suite: `nulls` 60, `singles` each three times, `outside` each twice;
    `turning` 12, `more` each four.
    """
    kinds = {
        "nulls": ["null"] * 60,
        "singles": 3 * list(SINGLES),
        "outside": 2 * list(OUTSIDE),
        "turning": 12 * list(TURNING),
        "more": 4 * list(MORE),
    }[name]
    if count:
        kinds = kinds[:count]
    return [(kind, 1000 * seed + i) for i, kind in enumerate(kinds)]


def write(kinds, folder, pushes=18, fps=60.0, turned=0.0):
    """All worlds of `kinds` as folders of `adaptsim diagnose`, simulated together; turned: noise of
    their yaw rad, 0 for none.
    """
    made = [world(kind, seed, pushes) for kind, seed in kinds]
    lanes = {k: np.concatenate([m[0][k] for m in made]) for k in made[0][0]}
    tracks = np.zeros((len(lanes["mu"]), round((LENGTH + LATE) * 500) + 1, 3))
    for part in (lanes["light"] > 0, lanes["light"] == 0):
        if part.any():
            tracks[part] = simulate({k: v[part] for k, v in lanes.items()})
    for i, ((kind, seed), (own, truth)) in enumerate(zip(kinds, made, strict=True)):
        seen = tracks[i * pushes : (i + 1) * pushes]
        write_world(
            Path(folder) / f"{kind}-{seed}",
            own,
            truth,
            seen,
            np.random.default_rng([seed, 7]),
            fps,
            turned=turned,
        )


def write_world(out, own, truth, tracks, rng, fps=60.0, meta="", turned=0.0):
    """A folder of `adaptsim diagnose`: `tracks [pushes, N, 2 or 3]` m (and rad) of lanes `own`, as
    a camera sees them; meta: more of meta.toml.
    """
    out.mkdir(parents=True, exist_ok=True)
    (out / "meta.toml").write_text(f'task = "pushing"\n{meta}')
    (out / "truth.json").write_text(json.dumps(truth))
    rows = [f"{k + 1},{own['speed'][k]:.6f},{own['angle'][k]:.6f}" for k in range(len(tracks))]
    (out / "actions.csv").write_text("\n".join(["trial,speed,angle", *rows, ""]))
    text = ["trial,time,x,y" + ",yaw" * bool(turned)]
    for k, track in enumerate(tracks):
        seen = camera({n: v[k] for n, v in own.items()}, track, 500, rng, fps, turned=turned)

        def cell(v):
            return "" if np.isnan(v) else f"{v:.6f}"

        text += [",".join([str(k + 1), f"{t:.5f}", *map(cell, row)]) for t, *row in seen]
    (out / "tracks.csv").write_text("\n".join([*text, ""]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--suite", choices=("nulls", "singles", "outside", "turning", "more"), required=True
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, help="the first so many worlds")
    parser.add_argument("--pushes", type=int, default=18)
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument(
        "--yaw", type=float, default=0.0, metavar="RAD", help="write yaw, with noise of so many rad"
    )
    parser.add_argument("--out", required=True)
    a = parser.parse_args()
    write(suite(a.suite, a.seed, a.count), a.out, a.pushes, a.fps, a.yaw)
