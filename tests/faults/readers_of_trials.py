"""The readers of pushes, scoops and tosses: healthy recordings of their own, written and read as
folders and as a robot's record.
"""

from functools import cache
from pathlib import Path

import numpy as np

from adaptsim_jax.logs.table import read_table
from adaptsim_jax.tasks.pushing import measured as pushes
from adaptsim_jax.tasks.pushing import model as push
from adaptsim_jax.tasks.pushing.config import PushingConfig
from adaptsim_jax.tasks.pushing.diagnosis import read as push_folder
from adaptsim_jax.tasks.pushing.frame import check_frame
from adaptsim_jax.tasks.robot_trials import AskedTrials
from adaptsim_jax.tasks.scooping import measured as scoops
from adaptsim_jax.tasks.scooping.diagnosis import read as scoop_folder
from adaptsim_jax.tasks.scooping.motion import check_way
from adaptsim_jax.tasks.toss import read as toss_folder
from tests.faults.damage import Columns, Kind, Recording
from tests.faults.readers import Read, Seen, csv
from tests.generators import tosses

COUNT = 8
PUSH = Kind(
    needed=("x", "y"),
    lengths=("x", "y"),
    placed=("x", "y"),
    mirrored="y",
    sizes=(("speed", 100.0), ("speed", 1000.0), ("angle", 180 / np.pi)),
)
SCOOP = Kind(
    needed=("x", "y"),
    lengths=("x", "y"),
    placed=("x", "y"),
    sizes=(("pitch", 180 / np.pi), ("distance", 1e3), ("distance", 100.0)),
)
TOSS = Kind(
    needed=toss_folder.COLUMNS[1:],
    lengths=("x", "y", "z"),
    placed=("z",),
    turn=("qw", "qx", "qy", "qz"),
)
ASKED = Kind(needed=("x", "y"), lengths=("x", "y"), placed=("x", "y"), mirrored="y")
LIFTED = Kind(needed=("x", "y", "on"), lengths=("x", "y"), placed=("x",), mirrored="x")


def slid(speed: float, angle: float, rng) -> Columns:
    """A bottle that is hit after 0.35 s and slides along the push's angle until it stops, at 60
    Hz.
    """
    time = np.arange(85) / 60
    far = np.clip(time - 0.35, 0.0, 0.6)
    s = 1.1 * speed * (far - far**2 / 1.2)
    place = np.array(push.START) + np.stack([s * np.cos(angle), s * np.sin(angle)], 1)
    x, y = (place + 3e-4 * rng.standard_normal(place.shape)).T
    return {"time": time, "x": x, "y": y}


@cache
def pushed(count: int = COUNT) -> list[Recording]:
    out = []
    for seed in range(6):
        rng = np.random.default_rng([45, seed])
        speed, angle = rng.uniform(0.4, 0.8, count), rng.permutation(np.linspace(-0.3, 0.3, count))
        trials = [slid(s, a, rng) for s, a in zip(speed, angle, strict=True)]
        out.append(
            Recording(trials, {"trial": np.arange(1.0, count + 1), "speed": speed, "angle": angle})
        )
    return out


def scooped_one(place, action, rng) -> Columns:
    """A piece that the blade takes along from where it meets it, at 60 Hz."""
    time = np.arange(61) / 60
    pitch, rate, distance = action
    moved = (
        np.logaddexp(0.0, 400.0 * (0.28 * np.clip(time / 0.7, 0, 1) ** 2 - distance - 0.03)) / 400.0
    )
    x, y = place[0] + moved * (0.9 - 0.2 * pitch), place[1] + 0.02 * moved
    z = 0.01 + 0.3 * moved * (0.2 - rate)
    x, y, z = np.stack([x, y, z]) + 3e-4 * rng.standard_normal((3, len(time)))
    return {"time": time, "x": x, "y": y, "z": z}


@cache
def scooped(count: int = COUNT) -> list[Recording]:
    out = []
    for seed in range(6):
        rng = np.random.default_rng([46, seed])
        place = rng.uniform([-0.04, -0.03], [0.04, 0.03], (count, 2))
        action = rng.uniform([0.05, -0.4, 0.01], [0.3, 0.4, 0.06], (count, 3))
        trials = [scooped_one(p, a, rng) for p, a in zip(place, action, strict=True)]
        asked = np.concatenate([np.arange(1.0, count + 1)[:, None], place, action], 1).T
        names = ("trial", "place_x", "place_y", "pitch", "rate", "distance")
        out.append(Recording(trials, dict(zip(names, asked, strict=True))))
    return out


@cache
def tossed() -> list[Recording]:
    out = []
    for seed in range(4):
        _, recorded = tosses.world((47, seed), tosses=16, seconds=0.7)
        out.append(
            Recording([dict(zip(toss_folder.COLUMNS, rows.T, strict=True)) for rows in recorded])
        )
    return out


def write_tracks(task: str):
    """meta.toml, actions.csv and the tracks: of all trials in one table where these have the same
    columns, else one each.
    """

    def written(folder: Path, recording: Recording) -> Path:
        folder.mkdir(exist_ok=True)
        for old in folder.glob("*.csv"):
            old.unlink()
        (folder / "meta.toml").write_text(f'task = "{task}"\n')
        csv(folder / "actions.csv", recording.actions)
        write_tables(folder, recording)
        return folder

    return written


def write_tables(folder: Path, recording: Recording, first: int = 1) -> None:
    parts = [
        {"trial": [k] * len(next(iter(c.values()))), **c}
        for k, c in enumerate(recording.trials, first)
    ]
    if all(list(part) == list(parts[0]) for part in parts):
        csv(
            folder / "tracks.csv",
            {k: [cell for part in parts for cell in part[k]] for k in parts[0]},
        )
        return
    for part, c in zip(parts, recording.trials, strict=True):
        csv(folder / f"track_{part['trial'][0] if part['trial'] else 'empty'}.csv", part or c)


def write_tosses(folder: Path, recording: Recording) -> Path:
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.csv"):
        old.unlink()
    (folder / "meta.toml").write_text('task = "toss"\nmodel = "cube.xml"\n')
    (folder / "cube.xml").write_text(tosses.xml(step=1e-3, friction=0.25, time=0.004, damping=0.5))
    for k, c in enumerate(recording.trials, 1):
        csv(folder / f"{k}.csv", c)
    return folder


def seen(names, time, places, mask, axes) -> dict[int, Seen]:
    """Trials as read, by their place in the recording."""
    out = {}
    for name, t, p, m in zip(names, time, places, mask, strict=True):
        here = m > 0
        out[int(name) - 1] = Seen(t[here], dict(zip(axes, p[here].T, strict=False)))
    return out


def read_pushes(source: Path) -> Read:
    r = push_folder.read(source)
    asked = dict(zip(("speed", "angle"), r.actions.T, strict=True)) | {
        "trial": np.array(r.names, float)
    }
    return Read(seen(r.names, r.time, r.xy, r.mask, "xy"), " ".join(r.notes), asked)


def read_scoops(source: Path) -> Read:
    r = scoop_folder.read(source)
    asked = dict(zip(("pitch", "rate", "distance"), r.actions.T, strict=True)) | {
        "trial": np.array(r.names, float)
    }
    asked |= dict(zip(("place_x", "place_y"), r.starts.T, strict=True))
    return Read(seen(r.names, r.time, r.places, r.mask, "xyz"), " ".join(r.notes), asked)


def read_tosses(source: Path) -> Read:
    """Quaternions are one turn whatever their sign: compared with w positive."""
    r, out = toss_folder.read(source), {}
    for name, time, place, turn in zip(r.names, r.time, r.place, r.turn, strict=True):
        columns = dict(zip(("x", "y", "z"), place.T, strict=True)) | turned(
            dict(zip(TOSS.turn, turn.T, strict=True))
        )
        out[int(name) - 1] = Seen(time, columns)
    return Read(out, " ".join(r.notes))


def turned(q: Columns) -> Columns:
    """The nine numbers of the turn, alike for q and -q."""
    return {f"{a}*{b}": q[a] * q[b] for a in q for b in q}


# ---------------------------------------------------------------- what a robot's session asked for

ANGLES = np.array([-0.25, 0.2])


@cache
def asked_pushes() -> list[Recording]:
    out = []
    for seed in range(6):
        rng = np.random.default_rng([48, seed])
        out.append(Recording([slid(rng.uniform(0.5, 0.8), a, rng) for a in ANGLES]))
    return out


@cache
def asked_scoops() -> list[Recording]:
    out = []
    for seed in range(6):
        rng = np.random.default_rng([49, seed])
        trials = [scooped_one(rng.uniform(-0.03, 0.03, 2), (0.2, 0.1, 0.03), rng) for _ in range(2)]
        for k, c in enumerate(trials):
            del c["z"]
            c["on"] = np.where(c["time"] > 0.6, float(k), 0.0)
        out.append(Recording(trials))
    return out


def write_record(folder: Path, recording: Recording) -> Path:
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.csv"):
        old.unlink()
    write_tables(folder, recording)
    return next(iter(sorted(folder.glob("*.csv"))))


def read_push_record(path: Path) -> Read:
    table = read_table(path, pushes.COLUMNS, min_rows=1)

    def at(i):
        return f"{path}: {table.row_word} {table.lines[i]}"

    asked = AskedTrials(
        np.array([1, 2]), np.array([[0.8, 0.0]] * 2), np.stack([[0.6, 0.6], ANGLES], 1)
    )
    points = pushes.measured_trajectory(table.columns, at, str(path), asked, PushingConfig()).points
    way = np.asarray(points[:, -1], float) - np.array(push.START)
    check_frame(asked.numbers.tolist(), ANGLES, way, str(path))
    return of_points(np.asarray(points))


def read_scoop_record(path: Path) -> Read:
    table = read_table(path, scoops.COLUMNS, min_rows=1)

    def at(i):
        return f"{path}: {table.row_word} {table.lines[i]}"

    asked = AskedTrials(np.array([1, 2]), np.zeros((2, 2)), np.zeros((2, 3)))
    read = scoops.measured_trajectory(table.columns, at, str(path), asked)
    check_way(np.asarray(read.points[:, -1], float), str(path), asked.numbers)
    return of_points(np.asarray(read.points), np.asarray(read.success))


def of_points(points: np.ndarray, success=(0.0, 0.0)) -> Read:
    """points `[2, K, 2]` m on the task's own times, and whether each trial succeeded."""
    own = np.arange(points.shape[1], dtype=float)

    def columns(k):
        return {
            "x": points[k, :, 0],
            "y": points[k, :, 1],
            "on": np.full(len(own), success[k]),
        }

    return Read({k: Seen(own, columns(k)) for k in range(2)})
