"""Every reader of recordings with healthy ones of its format, how they are written (with cells that
are text), and what is read.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from adaptsim_jax.logs.pendulum import read_pendulum as read_rig
from adaptsim_jax.logs.read import read_log
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.tasks.pendulum import measured as swings
from tests.faults import damage
from tests.faults.damage import Columns, Kind, Recording
from tests.logs.arm_files import META, arm, write

ARM = ("joint1", "joint2")
EPOCH = 1.7e9


@dataclass(frozen=True)
class Seen:
    """What was read of one trial: `[T]` times from the trial's own zero, and columns that are to be
    as they were, NaN where missing.
    """

    time: np.ndarray
    columns: Columns


@dataclass(frozen=True)
class Read:
    """By trial's place in the recording; told: what was said beside; actions as read."""

    trials: dict[int, Seen]
    told: str = ""
    actions: Columns | None = None


@dataclass(frozen=True)
class Reader:
    """write(folder, recording) -> what `read` takes; off: how far a column may be from what it was;
    resampled: read onto times of its own, and compared with what is read of the healthy one; cases:
    of the quick and of the slow tier.
    """

    name: str
    seed: int
    kind: Kind
    damages: tuple[damage.Damage, ...]
    healthy: Callable[[], list[Recording]]
    write: Callable[[Path, Recording], Path]
    read: Callable[[Path], Read]
    off: float = 0.05
    resampled: bool = False
    cases: tuple[int, int] = (60, 800)


def text(cell) -> str:
    return cell if isinstance(cell, str) else f"{cell:.12g}"


def number(cell) -> float:
    """As a format of plain numbers has it: what is none is NaN."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def numbers(column) -> np.ndarray:
    return np.array([number(cell) for cell in column])


def csv(path: Path, columns: Columns) -> Path:
    rows = [
        ",".join(columns),
        *(",".join(map(text, row)) for row in zip(*columns.values(), strict=True)),
        "",
    ]
    path.write_text("\n".join(rows))
    return path


# ---------------------------------------------------------------- logs of an arm

LOG = Kind(("q1", "q2"), ("v1", "v2"), ("q1", "q2", "tau1", "tau2"))


@cache
def arms() -> list[Recording]:
    return [Recording([arm(count=1, seconds=3.0, seed=seed)[0]]) for seed in range(6)]


def begun(time: np.ndarray) -> np.ndarray:
    return time - (EPOCH if time[0] > 1e6 else 0.0)


def read_pendulum(source: Path) -> Read:
    trial = read_rig(source).trials[0]
    columns = {
        "q1": trial.q[:, 0],
        "q2": trial.q[:, 1],
        "tau1": trial.u[:, 0],
        "tau2": trial.u[:, 1],
    }
    return Read({0: Seen(begun(trial.time), columns)})


def read_mechanism(source: Path) -> Read:
    log = read_log(source, ARM)
    trial = log.trials[0]
    columns = {"q1": trial.q[:, 0], "q2": trial.q[:, 1]}
    if log.input_kind == "torque":
        columns |= {"tau1": trial.u[:, 0], "tau2": trial.u[:, 1]}
    return Read({0: Seen(begun(trial.time), columns)}, " ".join(log.notes))


def write_arm(folder: Path, recording: Recording) -> Path:
    return write(folder, recording.trials, meta=META)


def write_mechanism(folder: Path, recording: Recording) -> Path:
    return write(folder, recording.trials, meta='task = "mechanism"\n')


def write_declared(folder: Path, recording: Recording) -> Path:
    """One table with a column of trials, in degrees and ms, under names that meta.toml tells."""
    scales = {
        "time": 1e3,
        "q1": 180 / np.pi,
        "q2": 180 / np.pi,
        "v1": 180 / np.pi,
        "v2": 180 / np.pi,
    }
    words = {"time": "t", "q1": "shoulder", "tau2": "effort"}
    out = {"trial": ["7"] * len(recording.trials[0]["time"])}
    for name, column in recording.trials[0].items():

        def scaled(cell, name=name):
            return cell if isinstance(cell, str) else cell * scales.get(name, 1.0)

        out[words.get(name, name)] = [scaled(cell) for cell in column]
    folder.mkdir(exist_ok=True)
    named = "\n".join(f'{ours} = "{theirs}"' for ours, theirs in words.items())
    units = 'time = "ms"\nangle = "deg"\nvelocity = "deg/s"'
    (folder / "meta.toml").write_text(f'task = "mechanism"\n[columns]\n{named}\n[units]\n{units}\n')
    return csv(folder / "all.csv", out).parent


def write_npz(folder: Path, recording: Recording) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "meta.toml").write_text('task = "mechanism"\n')
    np.savez(folder / "00.npz", **{k: numbers(x) for k, x in recording.trials[0].items()})
    return folder


def write_lerobot(folder: Path, recording: Recording) -> Path:
    """Angles as state, torques as action."""
    import pyarrow as pa
    from pyarrow import parquet

    c = recording.trials[0]

    def pairs(stem):
        return np.stack([numbers(c[f"{stem}{j}"]) for j in (1, 2)], 1).tolist()

    how = c["named"][0] if "named" in c else "all"
    joints = {"fewer": ARM[:1], "twice": ARM[:1] * 2, "none": (), "all": ARM}[how]

    def names(stem):
        return [f"{joint}.{stem}" for joint in joints] if how != "none" else None

    def vector(stem):
        return {"dtype": "float32", "shape": [2], "names": names(stem)}

    scalar = {
        "timestamp": {"dtype": "float32", "shape": [1]},
        "episode_index": {"dtype": "int64", "shape": [1]},
    }
    features = {"observation.state": vector("pos"), "action": vector("effort")} | scalar
    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": "v3.0", "fps": 100, "features": features})
    )
    n = len(c["time"])
    rows = {
        "observation.state": pairs("q"),
        "action": pairs("tau"),
        "timestamp": numbers(c["time"]),
    }
    rows |= {"episode_index": [0] * n, "frame_index": list(range(n))}
    parquet.write_table(pa.table(rows), folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


def write_bag(storage: str) -> Callable[[Path, Recording], Path]:
    """Joint states, each stamped by the row's time; they arrive every 10 ms whatever their stamps
    say.
    """

    def written(folder: Path, recording: Recording) -> Path:
        from tests.logs.test_bags import LATE, START, Bag

        c, bag = recording.trials[0], Bag(storage)
        table = {k: numbers(x) for k, x in c.items()}

        def flag(name, i):
            return name in c and bool(c[name][i])

        base = (
            0
            if np.max(table["time"], where=np.isfinite(table["time"]), initial=0.0) > 1e5
            else START
        )

        def absent(stem):
            return all(isinstance(cell, str) and not cell for cell in c[f"{stem}1"])

        for i in range(len(table["time"])):
            names, row = (
                list(ARM),
                {
                    s: [table[f"{s}{j}"][i] for j in (1, 2)]
                    for s in ("q", "v", "tau")
                    if not absent(s)
                },
            )
            if flag("reordered", i):
                names, row = names[::-1], {s: x[::-1] for s, x in row.items()}
            if flag("short", i):
                names, row = names[:1], {s: x[:1] for s, x in row.items()}
            if flag("nameless", i):
                names = []
            if flag("foreign", i):
                bag.array("/chatter", START + i * 10**7, [0.0])
            if flag("other", i) or flag("seldom", i):
                bag.joints(
                    "/joint_states", START + i * 10**7 + 5, ("gripper",), [0.1 * i], [0.0], [0.0]
                )
            when = table["time"][i]
            untold = flag("unstamped", i) or not np.isfinite(when)
            if flag("far", i):
                when = when + 7.0
            bag.joints(
                "/joint_states",
                0 if untold else base + round(when * 1e9),
                names,
                row.get("q", ()),
                row.get("v", ()),
                row.get("tau", ()),
                stamp=not untold,
            )
            bag.rows[-1] = (START + LATE + i * 10**7, *bag.rows[-1][1:])
        folder.mkdir(exist_ok=True)
        return bag.write(folder)

    return written


# ---------------------------------------------------------------- a robot's trial of the pendulum


@cache
def hanging() -> list[Recording]:
    """The arm's trials, let go from where they hang; in motion from the first row."""
    out = []
    for recording in arms():
        c = {k: x[40:] for k, x in recording.trials[0].items()}
        c |= {
            "time": c["time"] - c["time"][0],
            "q1": c["q1"] - c["q1"][0] - np.pi,
            "q2": c["q2"] - c["q2"][0],
        }
        out.append(Recording([c]))
    return out


def read_swing(source: Path) -> Read:
    path = source / "00.csv"
    table = read_table(path, swings.COLUMNS)
    read = swings.measured_trajectory(
        table.columns, str(path), lines=table.lines, row_word=table.row_word
    )
    return Read({0: of_swing(read)})


def of_swing(read) -> Seen:
    angles = np.asarray(read.angles)
    return Seen(np.arange(len(angles)) * 1.0, {"q1": angles[:, 0], "q2": angles[:, 1]})


ROS = Kind(LOG.angles, LOG.optional, LOG.needed, scales=(1e3, 1e6))
BAGS = (15, 400)
READERS = [
    Reader("diagnose, double pendulum", 42, LOG, damage.LOGS, arms, write_arm, read_pendulum),
    Reader("diagnose, mechanism", 44, LOG, damage.LOGS, arms, write_mechanism, read_mechanism),
    Reader(
        "robot record, pendulum",
        43,
        LOG,
        damage.LOGS,
        hanging,
        write_arm,
        read_swing,
        resampled=True,
    ),
    Reader(
        "mechanism, names and units declared",
        50,
        LOG,
        damage.LOGS,
        arms,
        write_declared,
        read_mechanism,
    ),
    Reader("mechanism, npz", 51, LOG, damage.ARRAYS, arms, write_npz, read_mechanism),
    Reader(
        "mechanism, ROS 1 bag",
        52,
        ROS,
        damage.BAGS,
        arms,
        write_bag("bag"),
        read_mechanism,
        cases=BAGS,
    ),
    Reader(
        "mechanism, ROS 2 bag",
        53,
        ROS,
        damage.BAGS,
        arms,
        write_bag("ros2"),
        read_mechanism,
        cases=BAGS,
    ),
    Reader(
        "mechanism, MCAP", 54, ROS, damage.BAGS, arms, write_bag("mcap"), read_mechanism, cases=BAGS
    ),
    Reader("mechanism, LeRobot", 55, LOG, damage.SETS, arms, write_lerobot, read_mechanism),
]
