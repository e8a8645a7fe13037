"""Folders of measured trials: `actions.csv` and tracks, whatever the task. What cannot be judged is
refused with its row.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.noise import difference_noise
from adaptsim_jax.logs.table import LogTable, read_table
from adaptsim_jax.tasks import camera_record as record
from adaptsim_jax.tasks.camera_record import Columns, RowName

MIN_ROWS, SLOWEST = 8, 0.06  # of one trial; s between its rows (20 Hz and some jitter)


class Size(NamedTuple):
    """Of a sensor's noise: its key in meta.toml, unit, the least that is believed, what is beyond
    any, and an example.
    """

    key: str
    unit: str
    smallest: float
    most: float
    such: float


PLACE = Size("noise", "m", 1e-4, 0.05, 0.0005)


@dataclass(frozen=True)
class TrialKind:
    """What tracks of a task look like.

    Args:
        trial, trials, body: As messages call them.
        reach: m, farther no body goes.
        fastest, slip: m/s and m, a row farther than this from the one before is another thing.
        moves: m, less in all is no trial. never: What it is then, in words.
        ends: s, later rows are left out.
        still: s, the arm touches no body so early.
        aside: m between a body and its declared start, more is another frame.
        min_trials: So few say nothing of effects.
        optional: Columns that are read where they are there. angles: Those in rad, with empty
            cells where they were not seen.
        usual: m, how far from the origin bodies are seen.
    """

    trial: str
    trials: str
    body: str
    reach: float
    fastest: float
    slip: float
    moves: float
    never: str
    ends: float
    still: float
    aside: float
    min_trials: int = 5
    optional: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    usual: float = 0.0


class MeasuredTrack(NamedTuple):
    """Of one trial: times `[R]` s, places `[R, C]` m (angles rad, NaN where not seen), and the
    file's name.
    """

    time: np.ndarray
    places: np.ndarray
    file: str


Tracks = dict[float, MeasuredTrack]
"""By trial."""


@dataclass(frozen=True, kw_only=True)
class TrialRecording:
    """T trials of at most R rows.

    Args:
        names: `[T]`, as the files number them.
        actions: `[T, A]` in the task's units.
        starts: `[T, 2]` m, as declared.
        aside: `[T, 2]` m from there to the first rows' mean.
        time: `[T, R]` s.
        mask: `[T, R]`, 0 behind the last row of a trial.
        noise: m, one standard deviation of a coordinate. noise_source: Where it is known from.
        notes: What the files say beside.
    """

    names: tuple[str, ...]
    actions: np.ndarray
    starts: np.ndarray
    aside: np.ndarray
    time: np.ndarray
    mask: np.ndarray
    noise: float
    noise_source: str
    notes: tuple[str, ...]


class TrialFiles(NamedTuple):
    """Where trials are read from.

    actions: The file of actions, tracks: those of tracks. meta: The table of meta.toml, where: how
    messages call it. without: Trials whose tracks are not looked at.
    """

    actions: Path
    tracks: Sequence[Path]
    meta: Mapping[str, Any]
    where: Path
    without: Sequence[str]


@dataclass
class ReadTrials:
    """Trials of files that have a track.

    names `[T]`. columns: Of actions, by name `[T]`. found: The tracks. more: Which optional columns
    they have. notes: What is said of them.
    """

    files: TrialFiles
    kind: TrialKind
    names: list[float]
    columns: dict[str, np.ndarray]
    found: Tracks
    more: tuple[str, ...]
    notes: list[str]

    def stacked(self, *names: str) -> np.ndarray:
        """Columns of the actions `[T, len(names)]`."""
        return np.stack([self.columns[name] for name in names], 1)

    def laid_out(self, starts: np.ndarray) -> dict[str, np.ndarray]:
        """starts, aside, time, places and mask as `TrialRecording` has them."""
        time, places, mask = padded(self.names, self.found)
        off = aside(self.names, self.found, starts, self.kind.still)
        return {"starts": starts, "aside": off, "time": time, "places": places, "mask": mask}

    def went(self, arrays: Columns) -> np.ndarray:
        """`[T, C]` m from the first to the last row of each track of `laid_out`."""
        rows = zip(arrays["places"], arrays["mask"], strict=True)
        return np.array([p[int(m.sum()) - 1] - p[0] for p, m in rows])

    def recorded(self, arrays: Columns, places: np.ndarray, before: str) -> Table:
        """The fields of `TrialRecording` but actions, with the noise of `places [T, R, C]`, see
        `noise_of`.
        """
        time, mask = arrays["time"], arrays["mask"]
        noise, source = noise_of(self.files.meta, time, places, mask, self.kind.still, before)
        notes = (*self.notes, *rounding_notes(places[mask > 0], noise))
        fields = {name: arrays[name] for name in ("starts", "aside", "time", "mask")}
        names = tuple(f"{n:g}" for n in self.names)
        return {**fields, "names": names, "noise": noise, "noise_source": source, "notes": notes}


def track_files(folder: Path) -> list[Path]:
    """All CSV files of a folder that hold tracks. Raises BadInput where there is none."""
    tracks = sorted(
        p for p in folder.glob("*.csv") if p.name not in ("actions.csv", "next_experiment.csv")
    )
    if not tracks:
        raise BadInput(
            f"{folder}: holds no tracks; add a CSV with columns trial, time, x, y (s and m)"
        )
    return tracks


def read_meta(path: Path, keys: Sequence[str]) -> Table:
    """meta.toml with no keys but `keys`. Raises BadInput."""
    meta = config.read(path)
    for key in meta:
        if key not in keys:
            raise BadInput(f"{path}: key '{key}' is unknown; {config.suggest(key, keys)}")
    return meta


def read_folder(
    folder: str | Path,
    keys: Sequence[str],
    assemble: Callable,
    as_declared: bool,
    without: Sequence[str],
) -> Any:
    """A folder of trials: actions.csv, tracks, and meta.toml of `keys`. Raises BadInput."""
    folder = Path(folder)
    meta = read_meta(folder / "meta.toml", keys)
    files = (folder / "actions.csv", track_files(folder), meta, folder / "meta.toml")
    return assemble(*files, as_declared, without)


def rounding_notes(places: np.ndarray, noise: float) -> list[str]:
    """A note where `places [N, C]` m are rounded to what is seen in the `noise` m."""
    quantum = rounded(places)
    if quantum <= 0.5 * noise:
        return []
    return [f"places are rounded to {1e3 * quantum:.3g} mm, which is in the noise floor"]


def read_actions(
    path: Path, needed: Mapping[str, str], optional: Sequence[str], trials: str
) -> tuple[LogTable, RowName]:
    """The table of an actions file, and how its row i is named. needed: Columns beside `trial` with
    their units. Raises BadInput.
    """
    table = read_table(path, ("trial", *needed, *optional), min_rows=1)
    words = ", ".join(["trial", *[f"{n} ({u})" for n, u in needed.items()]])
    record.check_columns(table.columns, ("trial", *needed), path, words)
    numbers = table.columns["trial"]
    if len(np.unique(numbers)) < len(numbers):
        raise BadInput(f"{path}: a trial is listed twice; number the {trials} one by one")
    return table, record.row_namer(path, table)


def asked_tracks(
    columns: Columns,
    rows: tuple[str, RowName],
    numbers: np.ndarray,
    kind: TrialKind,
    needed: tuple[tuple[str, ...], str],
    most: float,
) -> list[record.CameraTracks]:
    """The tracks of the trials `numbers [N]` that a robot was asked for, of one file.

    Args:
        columns: `[T]` each, with trial, time s, x and y m.
        rows: How messages call the file, and its row i.
        needed: Columns that must be there, and their units in words.
        most: S that a trial lasts at most.

    Raises BadInput.
    """
    where, at = rows
    record.check_columns(columns, needed[0], where, f"{', '.join(needed[0])} ({needed[1]})")
    record.check_numbers(columns["trial"], at, numbers)
    record.check_unit(columns, at, kind.reach, kind.trial, kind.usual)
    return list(record.trials_of(columns, at, where, numbers, most).values())


def read_trials(
    files: TrialFiles,
    kind: TrialKind,
    needed: Mapping[str, str],
    check: Callable[[Columns, RowName], None],
    optional: Sequence[str] = (),
) -> ReadTrials:
    """The trials of files.

    needed: Columns of actions beside `trial`, with their units; check: `(columns, row's name)`
    raises BadInput at an action that no arm makes. Raises BadInput with the row.
    """
    table, row = read_actions(files.actions, needed, optional, kind.trials)
    check(table.columns, row)
    numbers = table.columns["trial"]
    found, more = read_tracks(files, numbers, kind)
    names, notes = tracked(numbers, found, files.where, kind, "12 to 24")
    at = np.array([int(np.flatnonzero(numbers == n)[0]) for n in names])
    columns = {name: column[at] for name, column in table.columns.items()}
    return ReadTrials(files, kind, names, columns, found, more, notes)


def read_tracks(
    files: TrialFiles, numbers: np.ndarray, kind: TrialKind
) -> tuple[Tracks, tuple[str, ...]]:
    """The tracks of all files but those of the trials left out, which are not looked at, and which
    of the optional columns each of them has. Raises BadInput with the row.
    """
    paths, without = files.tracks, files.without
    if unknown := sorted(set(without) - {f"{n:g}" for n in numbers}):
        raise BadInput(
            f"no {kind.trial} is named {unknown[0]!r}; --without takes of "
            f"{', '.join(f'{n:g}' for n in numbers)}"
        )
    found: Tracks = {}
    columns = ("trial", "time", "x", "y", *kind.optional)
    tables = [
        (path, read_table(path, columns, min_rows=1, lost=("x", "y"), gaps=kind.angles))
        for path in paths
    ]
    more = tuple(c for c in kind.optional if all(c in t.columns for _, t in tables))
    for name in (c for c in kind.angles if c not in more):
        have, lack = (
            [path for path, t in tables if (name in t.columns) == has] for has in (True, False)
        )
        if have:
            raise BadInput(
                f"{lack[0]}: no column {name!r}, which {have[0].name} has; add it, empty where it "
                "was not seen, or take it out of all files"
            )
    wanted = _Wanted(numbers, files.actions, kind, more, without)
    for path, table in tables:
        _read_tracks(path, table, wanted, found)
    place = str(paths[0] if len(paths) == 1 else paths[0].parent)
    record.check_different({n: track.places for n, track in found.items()}, place)
    return found, more


class _Wanted(NamedTuple):
    """What tracks are read for: numbers of the trials and the file of actions that lists them;
    more: Optional columns that all files have. without: As `read_tracks` has them.
    """

    numbers: np.ndarray
    actions: Path
    kind: TrialKind
    more: tuple[str, ...]
    without: Sequence[str]


def _read_tracks(path: Path, table: LogTable, wanted: _Wanted, found: Tracks) -> None:
    c, kind, at = table.columns, wanted.kind, record.row_namer(path, table)
    record.check_columns(c, ("trial", "time", "x", "y"), path, "trial, time, x, y (s and m)")
    for i in np.flatnonzero(~np.isin(c["trial"], wanted.numbers))[:1]:
        raise BadInput(
            f"{at(i)}: trial {c['trial'][i]:g} is not in {wanted.actions.name}; add its "
            f"{kind.trial} there"
        )
    record.check_unit(c, at, kind.reach, kind.trial, kind.usual)
    for n in np.unique(c["trial"]):
        if f"{n:g}" in wanted.without:
            continue
        i = np.flatnonzero(c["trial"] == n)

        def row(k, i=i, n=n):
            return f"{at(int(i[k]))}: trial {n:g}"

        if n in found:
            raise BadInput(f"{row(0)}: has a track in {found[n].file} already; keep one")
        p = np.stack([c[name][i] for name in ("x", "y", *wanted.more)], 1)
        found[n] = _read_track(c["time"][i], p, row, wanted, path.name, f"{n:g}")


def _read_track(
    t: np.ndarray, p: np.ndarray, row: RowName, wanted: _Wanted, file: str, number: str
) -> MeasuredTrack:
    """The track of one trial at times `t [R]` s, `p [R, C]`. row: How messages call one."""
    kind = wanted.kind
    record.check_increasing(t, row)
    _check_times(t, row, kind)
    record.check_leaps(t, p[:, :2], row, kind.body, kind.fastest, kind.slip)
    if np.linalg.norm(p[:, :2] - p[0, :2], axis=1).max() < kind.moves:
        raise BadInput(
            f"{row(-1)}: {kind.body} never moved: {kind.never}; leave it out (--without {number}) "
            "or make it again"
        )
    for j in (2 + wanted.more.index(name) for name in kind.angles if name in wanted.more):
        p[:, j] = record.unwrapped(t, p[:, j], row, kind.body)
    keep = (t >= 0.0) & (t <= kind.ends)
    if keep.sum() < MIN_ROWS:
        raise BadInput(
            f"{row(0)}: has {keep.sum()} rows within {kind.ends:g} s of the arm's start; write "
            "seconds since that start"
        )
    return MeasuredTrack(t[keep], p[keep], file)


def _check_times(t: np.ndarray, row: RowName, kind: TrialKind) -> None:
    """BadInput where times `t [R]` s are not those of one trial since the arm's start."""
    if t[-1] - t[0] > 60.0:
        raise BadInput(
            f"{row(-1)}: lasts {t[-1] - t[0]:.6g} s; is time in ms? write seconds since the arm's "
            "start"
        )
    if np.sum((t >= 0.0) & (t <= kind.ends)) < MIN_ROWS and t[0] > kind.ends / 2:
        raise BadInput(
            f"{row(0)}: begins at {t[0]:.9g} s; write seconds since the arm's start, subtract that "
            "of each trial"
        )
    if len(t) < MIN_ROWS:
        raise BadInput(f"{row(0)}: {len(t)} rows; {MIN_ROWS} at least are needed, at 20 Hz or more")
    if t[0] < -0.5:
        raise BadInput(
            f"{row(0)}: begins {-t[0]:.3g} s before the arm's start; time 0 is where the arm starts"
        )


def tracked(
    numbers: np.ndarray, found: Tracks, where: Path, kind: TrialKind, serve: str
) -> tuple[list[float], list[str]]:
    """The trials that have a track, and a note for each that has none. Raises BadInput where too
    few are left.
    """
    names = [n for n in numbers if n in found]
    if len(names) < kind.min_trials:
        raise BadInput(
            f"{where}: {len(names)} {kind.trials} have a track; to judge effects "
            f"{kind.min_trials} are needed, {serve} serve"
        )
    gaps = [f"trial {n:g}: {hole}" for n in names for hole in record.holes(found[n].time)]
    return names, [
        f"trial {n:g} has no track and is left out" for n in numbers if n not in found
    ] + gaps


def check_spacing(names: Sequence[float], found: Tracks) -> None:
    """BadInput at the first trial whose rows are too far apart, by a clock that was checked
    before.
    """
    for n in names:
        step = float(np.median(np.diff(found[n].time)))
        if step > SLOWEST:
            raise BadInput(
                f"{found[n].file}: trial {n:g}: rows {step:.2g} s apart; 20 Hz at least are "
                "needed: record it so, or mend time where the camera did"
            )


def check_starts(names: Sequence[float], aside: np.ndarray, kind: TrialKind, where: Path) -> None:
    """BadInput at the first trial whose body stands elsewhere than the others do, as against what
    is declared, by more than `kind.aside` m.
    """
    distance = np.linalg.norm(aside - np.median(aside, 0), axis=1)
    for k in np.flatnonzero(distance > kind.aside)[:1]:
        off = 100 * distance[k]
        raise BadInput(
            f"{where}: trial {names[k]:g}: {kind.body} stands {off:.0f} cm from where it is "
            "declared, beside the other trials: of another frame, or of another trial? mend it, "
            f"or leave it out (--without {names[k]:g})"
        )


def padded(names: Sequence[float], found: Tracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times `[T, R]`, places `[T, R, C]` and mask `[T, R]`, each track held after its last row."""
    longest = max(len(found[n].time) for n in names)
    short = [longest - len(found[n].time) for n in names]
    time = np.stack(
        [np.pad(found[n].time, (0, k), "edge") for n, k in zip(names, short, strict=True)]
    )
    places = np.stack(
        [
            np.pad(found[n].places, ((0, k), (0, 0)), "edge")
            for n, k in zip(names, short, strict=True)
        ]
    )
    return time, places, np.stack([np.arange(longest) < longest - k for k in short]).astype(float)


def aside(names: Sequence[float], found: Tracks, starts: np.ndarray, still: float) -> np.ndarray:
    """`[T, 2]` m from the declared `starts [T, 2]` to the mean of the rows before `still` s; 0
    where there are none.
    """
    rows = [found[n].places[found[n].time < still, :2] for n in names]
    return np.array(
        [r.mean(0) - s if len(r) else np.zeros(2) for r, s in zip(rows, starts, strict=True)]
    )


def noise_of(
    meta: Mapping[str, Any], time, places, mask, still: float, before: str, size: Size = PLACE
) -> tuple[float, str]:
    """Noise of a coordinate of `places [T, R, C]`, and where it is known from: declared, rows
    before `still` s, or third differences.

    Rounding hides smaller noise of a body at rest, not of one that moves: it is the least that is
    believed.
    """
    if (given := meta.get(size.key)) is not None:
        if not isinstance(given, int | float) or not 0.0 < given < size.most:
            raise BadInput(
                f"meta.toml: {size.key} = {given!r} is no size in {size.unit}; write e.g. "
                f"{size.such:g}"
            )
        return float(given), "declared"
    minimum = max(size.smallest, rounded(places[mask > 0]) / np.sqrt(12.0))
    total, count = 0.0, 0
    for t, p, m in zip(time, places, mask, strict=True):
        r = p[(m > 0) & (t < still)]
        if len(r) > 1:
            total += float(np.square(r - r.mean(0)).sum())
            count += r.shape[1] * (len(r) - 1)
    if count >= 20:
        return max(float(np.sqrt(total / count)), minimum), f"rows before the {before}"
    rows = [p[m > 0] for p, m in zip(places, mask, strict=True)]
    return max(float(difference_noise(rows, pooled=True)[0]), minimum), "third differences"


def rounded(places: np.ndarray) -> float:
    """The step of places `[N, C]` whose first coordinate is rounded to a grid; 0 where it is
    not.
    """
    d = np.diff(np.unique(np.round(places[:, 0], 7)))
    d = d[d > 1e-7]
    if len(d) < 10:
        return 0.0
    step = float(d.min())
    if step > 5e-5 and np.all(np.abs(d / step - np.round(d / step)) < 0.02):
        return step
    return 0.0
