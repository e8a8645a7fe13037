"""Recordings of tosses: a folder of `meta.toml`, the declared MJCF, and poses. What cannot be
judged is refused with its row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.logs.noise import difference_noise
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.mechanisms.quaternions import between, continuous, rotated
from adaptsim_jax.tasks import camera_record as record
from adaptsim_jax.tasks.toss.body import TossedBody, read_body
from adaptsim_jax.tasks.trial_record import read_meta

PLACE, TURN = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
COLUMNS = ("time", *PLACE, *TURN)
KEYS = (
    "schema",
    "task",
    "model",
    "noise",
    "noise_turn",
    "note",
    "name",
    "description",
    "source",
    "license",
)


@dataclass(frozen=True)
class TossCriteria:
    """What decides whether poses of tosses are refused.

    Args:
        trials: Tosses, so that each can be left out.
        rows: Rows of a toss: a window and a flight.
        slowest: s between its rows: an impact lasts some ms.
        distance: m that no motion capture spans, so it is another unit.
        fastest: m/s between two rows: what is faster is another body.
        spin: rad/s between two rows: what is faster is an exchanged marker.
        noise: m, the smallest noise that is believed: differences of a lying body fall below any.
        noise_turn: rad, the same of turns.
        norm: By which a quaternion may miss unit length: rounding to two digits.
        struck: Of the body's size, by which a flight that strikes nothing leaves no parabola.
        sunk: Of the body's size below the plane, from which it is another frame: soft contacts
            sink less.
    """

    trials: int = 5
    rows: int = 20
    slowest: float = 0.02
    distance: float = 20.0
    fastest: float = 20.0
    spin: float = 100.0
    noise: float = 1e-5
    noise_turn: float = 1e-4
    norm: float = 0.02
    struck: float = 0.1
    sunk: float = 0.25


TOSS = TossCriteria()


@dataclass(frozen=True)
class Tossed:
    """T tosses. names `[T]`. time: Of each `[R]` s from its first row; place: `[R, 3]` m; turn:
    `[R, 4]` unit quaternions w first, of continuous sign; noise m and noise_turn rad of one
    coordinate. notes: What the files say beside.
    """

    names: tuple[str, ...]
    time: tuple[np.ndarray, ...]
    place: tuple[np.ndarray, ...]
    turn: tuple[np.ndarray, ...]
    noise: float
    noise_turn: float
    noise_source: str
    body: TossedBody
    notes: tuple[str, ...] = ()

    def without(self, names: Sequence[str]) -> "Tossed":
        """Without these tosses. Raises BadInput where one is not there, or too few are left."""
        if unknown := sorted(set(names) - set(self.names)):
            raise BadInput(
                f"no toss is named {unknown[0]!r}; --without takes of {', '.join(self.names)}"
            )
        keep = [k for k, name in enumerate(self.names) if name not in set(names)]
        if len(keep) < TOSS.trials:
            raise BadInput(f"--without leaves {len(keep)} tosses; a diagnosis needs {TOSS.trials}")
        return self.only(keep)

    def only(self, keep: Sequence[int]) -> "Tossed":
        """These tosses by number."""
        rows = {
            k: tuple(getattr(self, k)[i] for i in keep) for k in ("names", "time", "place", "turn")
        }
        return replace(self, **rows)


def read(folder: str | Path, as_declared: bool = False, without: Sequence[str] = ()) -> Tossed:
    """The tosses of a folder. as_declared: Whatever the poses say of the frame; without: tosses
    that are left out. Raises BadInput.
    """
    folder = Path(folder)
    where = folder / "meta.toml"
    meta = read_meta(where, KEYS)
    if not isinstance(meta.get("model"), str):
        raise BadInput(
            f'{where}: names no model; add model = "cube.xml", the MJCF of the body over a plane'
        )
    body = read_body(folder / meta["model"])
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise BadInput(
            f"{folder}: holds no tosses; add a CSV for each with columns {', '.join(COLUMNS)}"
        )
    found: dict[str, tuple[np.ndarray, ...]] = {}
    notes: list[str] = []
    for path in files:
        _read_file(path, found, notes)
    if len(found) < TOSS.trials:
        raise BadInput(
            f"{folder}: holds {len(found)} tosses; to judge effects {TOSS.trials} are needed, 20 "
            "to 30 serve"
        )
    names = tuple(found)
    time, place, turn = (tuple(found[n][k] for n in names) for k in range(3))
    if not as_declared:
        _check_frame(body, names, time, place, turn, where)
    noise, noise_turn, source = _noise(meta, where, place, turn)
    return Tossed(
        names, time, place, turn, noise, noise_turn, source, body, tuple(dict.fromkeys(notes))
    ).without(without)


def _read_file(path: Path, found: dict[str, tuple[np.ndarray, ...]], notes: list[str]) -> None:
    """The tosses of a file into `found`: one by the file's name, or as many as its column `trial`
    numbers.
    """
    table = read_table(path, ("trial", *COLUMNS), min_rows=1)

    c, at = table.columns, record.row_namer(path, table)
    record.check_columns(
        c, COLUMNS, path, "time (s), x, y, z (m) and qw, qx, qy, qz (body to world)"
    )
    if table.ignored:
        notes.append(
            f"columns {', '.join(table.ignored)} are not used: what moves is taken from the poses"
        )
    record.check_unit(c, at, TOSS.distance, "toss")
    norm = np.sqrt(sum(np.square(c[q]) for q in TURN))
    for i in np.flatnonzero(np.abs(norm - 1.0) > TOSS.norm)[:1]:
        raise BadInput(
            f"{at(i)}: the quaternion's length is {norm[i]:.4g}, not 1; mend or remove that row"
        )
    numbers = c.get("trial")
    for number in [None] if numbers is None else np.unique(numbers):
        if number is None:
            i = np.arange(len(c["time"]))
        else:
            i = np.flatnonzero(numbers == number)
        name = path.stem if number is None else f"{number:g}"

        def trials(k, i=i):
            return at(int(i[k]))

        if name in found:
            raise BadInput(
                f"{trials(0)}: there is a toss named {name} already; number the tosses one by one"
            )
        place = np.stack([c[n][i] for n in PLACE], 1)
        turn = np.stack([c[n][i] for n in TURN], 1) / norm[i, None]
        found[name] = _one(c["time"][i], place, turn, trials)
        notes += [f"toss {name}: {hole}" for hole in record.holes(found[name][0])]


def _one(time: np.ndarray, place: np.ndarray, turn: np.ndarray, trials) -> tuple[np.ndarray, ...]:
    record.check_increasing(time, trials)
    if len(time) < TOSS.rows or np.median(np.diff(time)) > TOSS.slowest:
        gap = np.median(np.diff(time)) if len(time) > 1 else 0.0
        raise BadInput(
            f"{trials(0)}: {len(time)} rows {gap:.2g} s apart; a toss needs {TOSS.rows} at 50 Hz "
            "or more, time in seconds"
        )
    gaps = np.diff(time)
    record.check_leaps(time, place, trials, "the body", TOSS.fastest)
    turn = continuous(turn)
    spun = np.linalg.norm(between(turn[:-1], turn[1:]), axis=1)
    for k in np.flatnonzero((spun > TOSS.spin * gaps) & (spun > 0.5))[:1] + 1:
        raise BadInput(
            f"{trials(k)}: the body turns by {spun[k - 1]:.2g} rad between two rows; remove what "
            "is not it"
        )
    return time - time[0], place, turn


def _check_frame(body: TossedBody, names, time, place, turn, where: Path) -> None:
    """Another frame, another body, another order of the quaternion: told before anything is
    fitted.
    """
    corners = body.corners()
    low = [lowest(p, q, corners) for p, q in zip(place, turn, strict=True)]
    sunk = float(np.median([z.min() for z in low]))
    floats = float(np.median([z[-1] for z in low]))
    swapped = [lowest(p, np.roll(q, 1, axis=1), corners) for p, q in zip(place, turn, strict=True)]

    def spread(all_rows):
        return float(np.median([np.abs(z[-3:]).max() for z in all_rows]))

    if spread(swapped) < 0.3 * spread(low) and spread(low) > 0.05 * body.size:
        raise BadInput(
            f"{where}: bodies lie on the plane only where quaternions have w last; name the "
            "columns so that qw is the scalar"
        )
    if sunk < -TOSS.sunk * body.size:
        raise BadInput(
            f"{where}: bodies go {-1e3 * sunk:.3g} mm below the plane z = 0 (median of the "
            "tosses); give poses in a frame whose z is upwards from the plane, in m, and the "
            "body's size in the model"
        )
    if min(floats, sunk) > body.size:
        raise BadInput(
            f"{where}: bodies never come nearer to the plane z = 0 than "
            f"{1e3 * min(floats, sunk):.3g} mm; give poses in a frame whose z is upwards from the "
            "plane"
        )

    for name, t, p, z in zip(names, time, place, low, strict=True):
        fall = np.polynomial.polynomial.Polynomial.fit(t, p[:, 2], 2)
        if z.min() > body.size and np.abs(p[:, 2] - fall(t)).max() > TOSS.struck * body.size:
            raise BadInput(
                f"{where}: toss {name}: the body strikes something {1e3 * z.min():.3g} mm above "
                "the plane z = 0, the others come down to it: of another frame? mend it, or leave "
                f"it out (--without {name})"
            )
        if z.min() < -2.0 * TOSS.sunk * body.size:
            raise BadInput(
                f"{where}: toss {name}: the body goes {-1e3 * z.min():.3g} mm below the plane z = "
                "0, the others do not: of another frame? mend it, or leave it out (--without "
                f"{name})"
            )


def lowest(place: np.ndarray, turn: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Height `[R]` m of the lowest of the body's points."""
    return (place[:, None] + rotated(turn[:, None], corners[None]))[..., 2].min(1)


def _noise(meta: Table, where: Path, place, turn) -> tuple[float, float, str]:
    """Of one coordinate, as declared or by third differences, which motion hardly has at these
    rates outside of impacts.
    """
    observed = []
    spins = [between(q[:-1], q[1:]) for q in turn]
    angles = [np.cumsum(np.pad(z, ((1, 0), (0, 0))), 0) for z in spins]
    for rows, minimum in ((place, TOSS.noise), (angles, TOSS.noise_turn)):
        observed.append(max(float(difference_noise(rows, pooled=True)[0]), minimum))
    source = "third differences"
    for i, (key, most) in enumerate((("noise", 0.02), ("noise_turn", 0.2))):
        if key in meta:
            value = finite(meta[key])
            if value is None or not 0.0 < value < most:
                unit, usual = (("m", "0.0002"), ("rad", "0.002"))[i]
                raise BadInput(
                    f"{where}: {key} = {brief(meta[key])} is no size in {unit}; write e.g. {usual}"
                )
            observed[i], source = value, "declared"
    return observed[0], observed[1], source
