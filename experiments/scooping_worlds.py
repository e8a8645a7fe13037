"""Worlds of scoops: tracks that a camera would record, from the physics of the scoop written anew,
with or without an effect.

Shares no code with the package: NumPy, float64, SAP's problem by Newton's method with a bisected
line search. Step, points of the contact surfaces and regularisation are the declared engine's,
which are part of the model. All worlds of a call are simulated side by side.

    # writes a folder for each world
    python experiments/scooping_worlds.py --suite singles --seed 1 --out worlds/
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

G, R, DENSITY, DT, TAU, SLIP, CLEAR = 9.81, 0.015, 1000.0, 2.5e-3, 0.2, 1e-2, 5e-5
KNOTS = (0.0, 0.25, 0.35, 0.6, 0.7, 1.0)
AHEAD, BELOW, GRIP = 0.177, 0.143, 0.10
BLADE, NECK = ((-0.0501, 0.0002), (0.05, 0.0006)), ((-0.1083, 0.0048), (0.01, 0.001), 0.46)
COLUMNS, ACROSS, NECK_MU = (6, 8, 2, 4), 2, 0.15
SHAPES = ("ellipsoid", "cylinder", "box")
REPEATS = (5e-4, 2e-3, 1e-4)  # rad, rad/s, m: how well the arm repeats an action
OWN = (
    "speed_scale lift_scale pitch_offset distance_offset start_x start_y clearance tilt drag "
    "adhesion blade_friction"
).split()
SEEN = "shift_x shift_y shift_z scale turn latency clock near foot_x foot_y".split()


def spun(a, x, z):
    """A vector turned nose down by `a` rad."""
    return np.cos(a) * x + np.sin(a) * z, np.cos(a) * z - np.sin(a) * x


def blade_motion(p):
    """The tip's x, z m and pitch rad `[B, N + 1]` of all lanes."""
    t = np.arange(round(1.0 / DT) + 1) * DT

    def run(values):
        return CubicSpline(KNOTS, values, bc_type="clamped").antiderivative()(t)

    forward = run((0.0, 0.6, 0.7, 0.2, 0.0, 0.0))[None] * (1 + p["speed_scale"])[:, None]
    own = run((0.0, 0.0, -0.6, -0.6, 0.0, 0.0))
    added = run((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
    turned = (own[None] + p["rate"][:, None] * added) * (1 + p["lift_scale"])[:, None]
    pitch = (p["pitch"] + p["pitch_offset"])[:, None]
    at_x, at_z = spun(pitch, AHEAD, -(BELOW - GRIP))
    at_z = at_z - GRIP
    now_x, now_z = spun(turned, at_x, at_z)
    x = -R - (p["distance"] + p["distance_offset"] + p["start_x"])[:, None] + forward + now_x - at_x
    z, theta = now_z - at_z, pitch + turned
    (cx, cz), (hx, hz) = BLADE
    edge = np.minimum(spun(theta, cx + hx, cz - hz)[1], spun(theta, cx - hx, cz - hz)[1])
    return x, z + np.maximum(0, CLEAR + p["clearance"][:, None] - z - edge), theta


class Piece:
    """Pieces of all lanes: mass, inertia, pressure field and outline."""

    def __init__(self, g, h, e):
        self.g, self.hz, self.e = g[:, None], h[:, None] / 2, e[:, None]

        def pick(a, b, c):
            return np.select([g == 0, g == 1], [a, b], c)

        hz = h / 2
        self.mass = DENSITY * pick(
            4 / 3 * np.pi * R * R * hz, 2 * np.pi * R * R * hz, 8 * R * R * hz
        )
        self.inertia = self.mass * pick(
            (R * R + hz * hz) / 5, (3 * R * R + 4 * hz * hz) / 12, (R * R + hz * hz) / 3
        )
        load, core = self.mass * G / e, np.minimum(R, hz)
        low, high = np.zeros_like(hz), core * 0.9
        for _ in range(60):
            d = (low + high) / 2
            u = d / hz
            borne = pick(np.pi * R * R * (u * u - 2 * u**3 / 3), 0, 0)
            flat = (R * R * d - R * d * d + d**3 / 3) / core
            borne = np.where(g == 0, borne, pick(0, np.pi, 4.0) * flat)
            low, high = np.where(borne < load, d, low), np.where(borne < load, high, d)
        self.rest = hz - d

    def chord(self, x, z, tx, tz):
        """Where lines through (x, z) along (tx, tz) lie inside, along them."""
        a, b = (tx / R) ** 2 + (tz / self.hz) ** 2, x * tx / R**2 + z * tz / self.hz**2
        root = np.sqrt(np.maximum(b * b - a * ((x / R) ** 2 + (z / self.hz) ** 2 - 1), 0))
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [
                np.sort(np.stack([(-w - q) / t, (w - q) / t]), 0)
                for q, t, w in ((x, tx, R), (z, tz, self.hz))
            ]

        def inside(q, w):
            return np.where(np.abs(q) <= w, np.inf, -np.inf)

        low = np.full(np.broadcast(x, tx).shape, -np.inf)
        high = -low
        for (one, two), q, t, w in zip(ends, (x, z), (tx, tz), (R, self.hz), strict=True):
            along = np.abs(t) < 1e-9
            low = np.maximum(low, np.where(along, -inside(q, w), one))
            high = np.minimum(high, np.where(along, inside(q, w), two))
        is_round = self.g == 0
        return np.where(is_round, (-b - root) / a, low), np.where(
            is_round, (-b + root) / a, np.maximum(high, low)
        )

    def wide(self, x, z):
        """Half the width across over (x, z)."""
        left = 1 - (x / R) ** 2 - np.where(self.g == 0, (z / self.hz) ** 2, 0)
        return np.where(self.g == 2, R, R * np.sqrt(np.maximum(left, 1e-12)))

    def field(self, x, y, z):
        """Pressure over modulus, and its slopes along x and z."""
        scaled = np.sqrt((x / R) ** 2 + (y / R) ** 2 + (z / self.hz) ** 2 + 1e-12)
        core, axis = np.minimum(R, self.hz), np.sqrt(x * x + y * y + 1e-12)
        box = self.g == 2
        side = np.where(box, np.minimum(R - abs(x), R - abs(y)), R - axis)
        out = np.where(box, -np.sign(x) * (abs(x) >= abs(y)), -x / axis)
        end = self.hz - abs(z)
        near = end < side
        is_round = self.g == 0
        return (
            np.where(is_round, 1 - scaled, np.where(near, end, side) / core),
            np.where(is_round, -x / (R * R * scaled), np.where(near, 0, out) / core),
            np.where(is_round, -z / (self.hz**2 * scaled), np.where(near, -np.sign(z), 0) / core),
        )


def strips(tip, speed, p):
    """Table, blade, its front and the neck: origin, tangent, half length, velocity at a point's
    arm, friction; each `[B, 4]`.
    """
    count = len(tip)
    (cx, cz), (hx, hz) = BLADE
    (nx, nz), (kx, kz), rise = NECK
    x, z, a = tip.T[..., None]
    ox, oz = spun(
        a,
        np.array([cx, cx + hx, nx + kz * np.sin(rise)]),
        np.array([cz + hz, cz, nz + kz * np.cos(rise)]),
    )
    tx, tz = spun(a, np.array([1.0, 0.0, np.cos(rise)]), np.array([0.0, -1.0, -np.sin(rise)]))

    def flat(v, rest):
        return np.concatenate([np.full((count, 1), v), rest], 1)

    mu = p["mu"][:, None]
    blade = mu * (1 + p["blade_friction"][:, None])
    friction = np.concatenate([mu, blade, blade, 2 * blade * NECK_MU / (blade + NECK_MU)], 1)
    moving = np.array([0.0, 1.0, 1.0, 1.0])
    return {
        "ox": flat(0.0, x + ox),
        "oz": flat(0.0, z + oz),
        "tx": flat(1.0, tx),
        "tz": flat(0.0, tz),
        "half": np.tile([9.0, hx, hz, kx], (count, 1)),
        "mu": friction,
        "ax": x * moving,
        "az": z * moving,
        "vx": speed[:, :1] * moving,
        "vz": speed[:, 1:2] * moving,
        "w": speed[:, 2:] * moving,
    }


def contacts(piece, pose, s):
    """Points `[B, N]`: Jacobian rows normal and tangential (x, z, spin), surface speeds, stiffness
    and so on.
    """
    px, pz, a = pose.T[..., None]

    def local(x, z):
        return spun(-a, x, z)

    ox, oz = s["ox"] - px, s["oz"] - pz
    bx, bz = local(ox, oz)
    ux, uz = local(s["tx"], s["tz"])
    low, high = piece.chord(bx, bz, ux, uz)
    low, high = np.maximum(low, -s["half"]), np.minimum(high, s["half"])
    length = np.maximum(high - low, 0)
    which = np.repeat(np.arange(4), [c * ACROSS for c in COLUMNS])
    columns = np.repeat(COLUMNS, [c * ACROSS for c in COLUMNS])
    middle = np.concatenate([np.repeat(np.arange(c) + 0.5, ACROSS) for c in COLUMNS])
    nodes, weights = np.polynomial.legendre.leggauss(ACROSS)
    node, weight = (np.tile(v, sum(COLUMNS)) for v in ((nodes + 1) / 2, weights / 2))

    def pick(v):
        return v[:, which]

    step = pick(length) / columns
    at = pick(low) + step * middle
    tx, tz = pick(s["tx"]), pick(s["tz"])
    x, z = pick(bx) + at * pick(ux), pick(bz) + at * pick(uz)
    wide = piece.wide(x, z)
    depth, gx, gz = piece.field(x, wide * node, z)
    growth = gz * pick(ux) - gx * pick(uz)
    active = (depth > 0) & (growth > 1e-6) & (step > 0)
    rx, rz = pick(ox) + at * tx, pick(oz) + at * tz
    # arms are from the piece's centre; the spatula's motion is about its tip
    vx = pick(s["vx"]) + pick(s["w"]) * (rz - (pick(s["az"]) - pz))
    vz = pick(s["vz"]) - pick(s["w"]) * (rx - (pick(s["ax"]) - px))
    stiff = np.where(active, 2 * step * wide * weight * piece.e * growth, 1.0) * DT * (DT + TAU)
    light = 1 / piece.mass[:, None] + (rx**2 + rz**2) / (2 * piece.inertia[:, None])
    return {
        "n": np.stack([-tz, tx, -tz * rz - tx * rx], -1),
        "t": np.stack([tx, tz, tx * rz - tz * rx], -1),
        "lift": vz * tx - vx * tz,
        "slide": vx * tx + vz * tz,
        "stiff": stiff,
        "grip": 1 / (SLIP * light),
        "press": np.where(active, depth / np.where(active, growth, 1) / (DT + TAU), 0),
        "mu": pick(s["mu"]),
        "on": active,
    }


def law(c, vn, vt):
    """Impulses against normal and tangential speed, and their derivatives nn, nt, tt."""
    yn, yt = (c["press"] - vn) * c["stiff"], vt * c["grip"]
    m = c["mu"] * c["stiff"] / c["grip"]
    yr = abs(yt)
    stick = (yr <= c["mu"] * yn) & c["on"]
    slide = (yn > -m * yr) & c["on"] & ~stick
    share = 1 / (1 + c["mu"] * m)
    way = np.where(vt < 0, -c["mu"], c["mu"])
    normal = np.where(stick, yn, np.where(slide, (yn + m * yr) * share, 0))
    slope = np.where(slide, c["stiff"] * share, 0)
    return (
        normal,
        np.where(stick, yt, way * normal),
        np.where(stick, c["stiff"], slope),
        -slope * way,
        np.where(stick, c["grip"], slope * way * way),
    )


def solved(c, mass, free, guess):
    """Velocities `[B, 3]` that minimise SAP's cost."""
    v, todo = guess.copy(), np.arange(len(guess))
    for turn in range(60):
        k = {name: z[todo] for name, z in c.items()}
        m, f, now = mass[todo], free[todo], v[todo]
        vn, vt = (
            np.einsum("bni,bi->bn", k["n"], now) - k["lift"],
            np.einsum("bni,bi->bn", k["t"], now) - k["slide"],
        )
        pn, pt, nn, nt, tt = law(k, vn, vt)
        pull = np.einsum("bn,bni->bi", pn, k["n"]) - np.einsum("bn,bni->bi", pt, k["t"])
        gradient = m * (now - f) - pull

        def size(z, m=m):
            return np.sqrt((z * z / m).sum(1))

        far = size(gradient) > 1e-9 * (size(m * f) + size(pull) + 1e-9)
        if not far.any():
            break
        todo, k = todo[far], {name: z[far] for name, z in k.items()}
        m, f, now, gradient, vn, vt, nn, nt, tt = (
            z[far] for z in (m, f, now, gradient, vn, vt, nn, nt, tt)
        )
        if turn > 9 and turn % 2:  # hold what hardly slides, where the minimum lies on a kink
            held = k["on"] & (nt != 0) & (abs(vt) < 1e-4)
            nn, nt, tt = (
                np.where(held, k["stiff"], nn),
                np.where(held, 0, nt),
                np.where(held, k["grip"], tt),
            )
        mixed = np.einsum("bn,bni,bnj->bij", nt, k["n"], k["t"])
        bend = np.einsum("bn,bni,bnj->bij", nn, k["n"], k["n"]) + np.einsum(
            "bn,bni,bnj->bij", tt, k["t"], k["t"]
        )
        bend = bend + mixed + mixed.transpose(0, 2, 1) + m[:, :, None] * np.eye(3)
        move = -np.linalg.solve(bend, gradient[..., None])[..., 0]
        an, at = np.einsum("bni,bi->bn", k["n"], move), np.einsum("bni,bi->bn", k["t"], move)

        def slope(share, k=k, m=m, f=f, now=now, move=move, vn=vn, vt=vt, an=an, at=at):
            pn, pt, *_ = law(k, vn + share[:, None] * an, vt + share[:, None] * at)
            return (m * (now + share[:, None] * move - f) * move).sum(1) - (pn * an - pt * at).sum(
                1
            )

        low, high = np.zeros(len(now)), np.ones(len(now))
        over = slope(high) > 0
        share = high.copy()
        if over.any():
            for _ in range(26):
                share = (low + high) / 2
                up = slope(share) > 0
                low, high = np.where(up, low, share), np.where(up, share, high)
            share = np.where(over, share, 1.0)
        v[todo] = now + share[:, None] * move
    return v


def simulate(lanes):
    """Poses `[B, N + 1, 3]` (x from where the piece lies, z, nose-down angle) of all lanes: dict of
    arrays `[B]`.
    """
    p = {k: np.asarray(v, float) for k, v in lanes.items()}
    piece = Piece(p["g"], p["h"], p["e"])
    tip = np.stack(blade_motion(p), -1)
    count = len(p["mu"])
    mass = np.stack([piece.mass, piece.mass, piece.inertia], 1)
    pose, v = np.stack([np.zeros(count), piece.rest, np.zeros(count)], 1), np.zeros((count, 3))
    out = [pose]
    for n in range(tip.shape[1] - 1):
        now, speed = tip[:, n], (tip[:, n + 1] - tip[:, n]) / DT
        c = contacts(piece, pose, strips(now, speed, p))
        on_table = np.exp(-np.maximum(pose[:, 1] - piece.rest, 0) / 1e-3)
        ahead, above = spun(-now[:, 2], pose[:, 0] - now[:, 0], pose[:, 1] - now[:, 1])

        def sigmoid(u):
            return 1 / (1 + np.exp(-np.clip(u, -50, 50)))

        over = sigmoid(-ahead / 1e-3) * sigmoid((piece.hz[:, 0] + 3e-3 - above) / 1e-3)
        sx, sz = spun(now[:, 2], np.zeros(count), -p["adhesion"] * over)
        ax = G * np.sin(p["tilt"]) - p["drag"] * on_table * v[:, 0] + sx
        free = v + DT * np.stack([ax, -G * np.cos(p["tilt"]) + sz, np.zeros(count)], 1)
        v = solved(c, mass, free, v)
        pose = pose + DT * v
        out.append(pose)
    return np.stack(out, 1)


def camera(p, poses, place, rng, fps, noise, side):
    """What a camera says of one scoop, lane `p` (scalars): rows (time, x, y[, z])."""
    t = np.arange(rng.uniform(0, 0.2) / fps, 1.0 - rng.uniform(0, 0.1), 1 / fps)
    when = (1 + p["clock"]) * t - p["latency"]
    x, z = (np.interp(when, np.arange(len(poses)) * DT, poses[:, i]) for i in range(2))
    x, y = place[0] + p["start_x"] + x, place[1] + p["start_y"] + 0 * x
    # the ray from a camera 1 / near above (foot_x, foot_y) through the piece meets the table beyond
    # it
    far = 1 / (1 - z * p["near"])
    x, y = p["foot_x"] + far * (x - p["foot_x"]), p["foot_y"] + far * (y - p["foot_y"])
    c, s = np.cos(p["turn"]), np.sin(p["turn"])
    more = 1 + p["scale"]
    xyz = np.stack(
        [
            more * (c * x - s * y) + p["shift_x"],
            more * (s * x + c * y) + p["shift_y"],
            more * z + p["shift_z"],
        ],
        1,
    )
    xyz = xyz + noise * rng.standard_normal(xyz.shape)
    return np.column_stack([t, xyz if side else xyz[:, :2]])[rng.random(len(t)) > 0.03]


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
    "lift_scale": _one("lift_scale", 0.12, 0.3),
    "pitch_offset": lambda rng: {
        "pitch_offset": rng.choice([rng.uniform(0.02, 0.06), -rng.uniform(0.015, 0.03)])
    },
    "distance_offset": lambda rng: {
        "distance_offset": rng.choice([rng.uniform(2e-3, 6e-3), -rng.uniform(2e-3, 4e-3)])
    },
    "place_offset": lambda rng: {
        "start_x": rng.choice([rng.uniform(2e-3, 8e-3), -rng.uniform(2e-3, 4e-3)]),
        "start_y": sign(rng) * rng.uniform(2e-3, 8e-3),
    },
    "placement": lambda rng: {"scatter": rng.uniform(1.5e-3, 3e-3)},
    "clearance": lambda rng: {"clearance": rng.uniform(1.5e-4, 6e-4)},
    "blade_friction": lambda rng: {
        "blade_friction": rng.choice([rng.uniform(0.4, 1.0), -rng.uniform(0.35, 0.6)])
    },
    "adhesion": lambda rng: {"adhesion": rng.uniform(2.0, 8.0)},
    "tilt": _one("tilt", 0.025, 0.07),
    "drag": lambda rng: {"drag": rng.uniform(1.5, 5.0)},
    "shape": lambda rng: {"other_shape": 1.0},
    "height": lambda rng: {"other_height": sign(rng) * rng.uniform(2e-3, 4e-3)},
    "camera_shift": _two(("shift_x", "shift_y"), 0.004, 0.015),
    "camera_scale": _one("scale", 0.03, 0.1),
    "camera_turn": _one("turn", 0.03, 0.1),
    "latency": lambda rng: {"latency": rng.uniform(0.015, 0.06)},
    "clock_scale": _one("clock", 0.03, 0.1),
}
MORE = {
    "parallax": lambda rng: {
        "near": 1 / rng.uniform(0.5, 1.2),
        "foot_x": rng.uniform(-0.3, 0.3),
        "foot_y": rng.uniform(-0.3, 0.3),
    },
}
ZERO = dict.fromkeys([*OWN, *SEEN], 0.0)


def world(kind, seed, scoops=20):
    """Lanes of one world: dict of arrays `[scoops]`, places `[scoops, 2]`, what is true of it and
    what is declared.
    """
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    g = int(rng.integers(0, 2))
    truth = {
        "mu": rng.uniform(0.25, 0.4),
        "e": 10 ** rng.uniform(4, 5.7),
        "g": g,
        "h": rng.uniform(0.015, 0.025),
    }
    lanes = {k: np.full(scoops, float(v)) for k, v in (ZERO | truth).items()}

    def spread(low, high):
        return rng.permutation(np.linspace(low, high, scoops))

    asked = {
        "pitch": spread(np.radians(2), np.radians(10)),
        "rate": spread(-0.2, 0.2),
        "distance": spread(0.005, 0.02),
    }
    place = rng.uniform([-0.04, -0.03], [0.04, 0.03], (scoops, 2))
    given = {} if kind == "null" else (SINGLES | MORE)[kind](rng)
    for k, v in given.items():
        if k in lanes:
            lanes[k] = np.full(scoops, v)
    if kind == "placement":
        lanes["start_x"], lanes["start_y"] = given["scatter"] * rng.standard_normal(
            (2, scoops)
        ).clip(-2, 2)
    for (k, v), size in zip(asked.items(), REPEATS, strict=True):
        lanes[k] = v + size * rng.standard_normal(scoops)
    declared = {}
    if kind == "shape":
        declared["shape"] = SHAPES[1 - g]
    if kind == "height":
        declared["height"] = round(truth["h"] + given["other_height"], 4)
    truth = truth | {"kind": kind, "seed": seed} | {k: float(v) for k, v in given.items()}
    return lanes, asked, place, truth, declared


def suite(name, seed, count=None):
    """Kinds and seeds of a suite: `nulls` 30, `singles` each twice, `more` each four times."""
    kinds = {"nulls": ["null"] * 30, "singles": 2 * list(SINGLES), "more": 4 * list(MORE)}[name]
    if count:
        kinds = kinds[:count]
    return [(kind, 1000 * seed + i) for i, kind in enumerate(kinds)]


def write(kinds, folder, scoops=20, fps=60.0, noise=5e-4, side=True):
    """All worlds of `kinds` as folders of `adaptsim diagnose`, simulated together."""
    made = [world(kind, seed, scoops) for kind, seed in kinds]
    lanes = {k: np.concatenate([m[0][k] for m in made]) for k in made[0][0]}
    poses = simulate(lanes)
    for i, ((kind, seed), (own, asked, place, truth, declared)) in enumerate(
        zip(kinds, made, strict=True)
    ):
        rng = np.random.default_rng([seed, 7])
        out = Path(folder) / f"{kind}-{seed}"
        out.mkdir(parents=True, exist_ok=True)
        meta = [f"{k} = {json.dumps(v)}" for k, v in ({"task": "scooping"} | declared).items()]
        (out / "meta.toml").write_text("\n".join([*meta, ""]))
        (out / "truth.json").write_text(json.dumps(truth))
        columns = zip(place[:, 0], place[:, 1], *asked.values(), strict=True)
        rows = [",".join([str(k), *(f"{v:.6f}" for v in row)]) for k, row in enumerate(columns, 1)]
        (out / "actions.csv").write_text(
            "\n".join(["trial,place_x,place_y,pitch,rate,distance", *rows, ""])
        )
        text = ["trial,time,x,y" + ",z" * side]
        for k in range(scoops):
            scalars = {n: v[k] for n, v in own.items()}
            seen = camera(scalars, poses[i * scoops + k], place[k], rng, fps, noise, side)
            text += [",".join([str(k + 1), *(f"{v:.6f}" for v in row)]) for row in seen]
        (out / "tracks.csv").write_text("\n".join([*text, ""]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--suite", choices=("nulls", "singles", "more"), required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, help="the first so many worlds")
    parser.add_argument("--scoops", type=int, default=20)
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--above", action="store_true", help="seen from above alone: no heights")
    parser.add_argument("--out", required=True)
    a = parser.parse_args()
    write(suite(a.suite, a.seed, a.count), a.out, a.scoops, a.fps, side=not a.above)
