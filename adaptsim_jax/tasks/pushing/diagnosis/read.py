"""Recordings of pushes: a folder of `meta.toml`, `actions.csv` and tracks. What cannot be judged is refused with its row."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.sysid.io.table import read_table
from adaptsim_jax.tasks.camera_record import check_increasing, check_unit
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.frame import check_frame
from adaptsim_jax.tasks.pushing.measured import FASTEST, SLIP, STILL
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.planar import DEFAULT, DRAKE, PlanarCoefficients, check_options

LEAST_TRIALS, LEAST_ROWS, SLOWEST = 5, 8, 0.06  # pushes; rows of one; s between its rows (20 Hz and some jitter)
QUIET = 0.15  # s; no plate within the bounds touches the bottle so early
LEAST_NOISE = 1e-4  # m
FAR, ASIDE = 3.0, 0.15  # m: farther no push goes; m between start and first row from which it is another frame
KEYS = ("schema", "task", "friction", "coefficients", "mass", "note", "noise")


@dataclass(frozen=True)
class Pushed:
    """T pushes of at most R rows.

    names `[T]`; actions `[T, 2]` m/s, rad; starts `[T, 2]` m as declared; aside `[T, 2]` m from there to the first rows' mean; time
    `[T, R]` s, xy `[T, R, 2]` m, mask `[T, R]`; noise m of one coordinate; notes: what the files say beside.
    """

    names: tuple[str, ...]
    actions: np.ndarray
    starts: np.ndarray
    aside: np.ndarray
    time: np.ndarray
    xy: np.ndarray
    mask: np.ndarray
    noise: float
    noise_source: str
    options: PushOptions
    coefficients: PlanarCoefficients
    notes: tuple[str, ...] = ()


def read(folder: str | Path, as_declared: bool = False, without: Sequence[str] = ()) -> Pushed:
    """The pushes of a folder. as_declared: whatever their directions say of the frame; without: pushes whose tracks are not looked
    at. Raises BadInput."""
    folder = Path(folder)
    meta = config.read(folder / "meta.toml")
    for key in meta:
        if key not in KEYS:
            raise BadInput(f"{folder / 'meta.toml'}: key '{key}' is unknown{config.suggest(key, KEYS)}")
    tracks = sorted(p for p in folder.glob("*.csv") if p.name not in ("actions.csv", "next_experiment.csv"))
    if not tracks:
        raise BadInput(f"{folder}: holds no tracks; add a CSV with columns trial, time, x, y (s and m)")
    return assemble(folder / "actions.csv", tracks, meta, folder / "meta.toml", as_declared, without)


def assemble(
    actions: Path,
    tracks: list[Path],
    meta: dict[str, Any],
    where: Path,
    as_declared: bool = False,
    without: Sequence[str] = (),
) -> Pushed:
    """Pushes of an actions file and tracks' files; see `read`."""
    table = read_table(actions, ("trial", "speed", "angle", "start_x", "start_y"), least=1)
    for name in ("trial", "speed", "angle"):
        if name not in table.columns:
            raise BadInput(f"{actions}: column '{name}' is missing; needed are trial, speed (m/s), angle (rad)")
    c = table.columns
    told = lambda i: f"{actions}: {table.row_word} {table.lines[i]}"
    for i, (speed, angle) in enumerate(zip(c["speed"], c["angle"], strict=True)):
        if not 0.1 <= speed <= 2.0:
            raise BadInput(f"{told(i)}: speed {speed:g} is not within 0.1 to 2 m/s; is it in another unit?")
        if abs(angle) > 1.2:
            raise BadInput(f"{told(i)}: angle {angle:g} rad is beyond any push; is it in degrees? write radians")
    numbers = c["trial"]
    if len(np.unique(numbers)) < len(numbers):
        raise BadInput(f"{actions}: a trial is listed twice; number the pushes one by one")
    if unknown := sorted(set(without) - {f"{n:g}" for n in numbers}):
        raise BadInput(f"no push is named {unknown[0]!r}; --without takes of {', '.join(f'{n:g}' for n in numbers)}")
    found = {}
    for path in tracks:
        _read_tracks(path, numbers, actions, found, without)
    missing = [n for n in numbers if n not in found]
    names = [n for n in numbers if n in found]
    if len(names) < LEAST_TRIALS:
        raise BadInput(
            f"{where}: {len(names)} pushes have a track; to judge effects {LEAST_TRIALS} are needed, 12 to 24 serve"
        )
    row = {n: i for i, n in enumerate(numbers)}
    at = np.array([row[n] for n in names])
    default = lambda k: c.get(f"start_{'xy'[k]}", np.full(len(numbers), model.START[k]))[at]
    starts = np.stack([default(0), default(1)], 1)
    longest = max(len(found[n][0]) for n in names)
    time, xy, mask = np.zeros((len(at), longest)), np.zeros((len(at), longest, 2)), np.zeros((len(at), longest))
    for k, n in enumerate(names):
        t, p, _ = found[n]
        time[k], xy[k], mask[k, : len(t)] = (
            np.pad(t, (0, longest - len(t)), "edge"),
            np.pad(p, ((0, longest - len(t)), (0, 0)), "edge"),
            1,
        )
    acts = np.stack([c["speed"], c["angle"]], 1)[at]
    aside = _aside(names, found, starts)
    _check_start(starts, aside, where)
    ends = np.array([p[int(m.sum()) - 1] - p[0] for p, m in zip(xy, mask, strict=True)])
    if not as_declared:
        check_frame(acts[:, 1], ends, str(where))  # a slight turn is an effect of the catalogue
    noise, source = _noise(meta, time, xy, mask)
    notes = [f"trial {n:g} has no track and is left out" for n in missing]
    quantum = _quantum(xy[mask > 0])
    if quantum > 0.5 * noise:
        notes.append(f"places are rounded to {1e3 * quantum:.3g} mm, which is in the noise floor")
    options = PushOptions(friction=meta.get("friction", "clean"), mass=float(meta.get("mass", model.NOMINAL_MASS)))
    which = config.pick("coefficients", meta.get("coefficients", "native"), ("native", "drake"))
    return Pushed(
        tuple(f"{n:g}" for n in names),
        acts,
        starts,
        aside,
        time,
        xy,
        mask,
        noise,
        source,
        check_options(options),
        DRAKE if which == "drake" else DEFAULT,
        tuple(notes),
    )


def _read_tracks(path: Path, numbers: np.ndarray, actions: Path, found: dict, without: Sequence[str]) -> None:
    table = read_table(path, ("trial", "time", "x", "y"), least=1)
    at = lambda i: f"{path}: {table.row_word} {table.lines[i]}"
    for name in ("trial", "time", "x", "y"):
        if name not in table.columns:
            raise BadInput(f"{path}: column '{name}' is missing; needed are trial, time, x, y (s and m)")
    c = table.columns
    for i in np.flatnonzero(~np.isin(c["trial"], numbers))[:1]:
        raise BadInput(f"{at(i)}: trial {c['trial'][i]:g} is not in {actions.name}; add its push there")
    check_unit(c, at, FAR, "push")
    for n in np.unique(c["trial"]):
        if f"{n:g}" in without:
            continue
        i = np.flatnonzero(c["trial"] == n)
        told = lambda k, i=i, n=n: f"{at(int(i[k]))}: trial {n:g}"
        if n in found:
            raise BadInput(f"{told(0)}: has a track in {found[n][2]} already; keep one")
        t, p = c["time"][i], np.stack([c["x"][i], c["y"][i]], 1)
        check_increasing(t, told)
        if t[-1] > 60.0:
            raise BadInput(f"{told(-1)}: lasts {t[-1]:.6g} s; is time in ms? write seconds since the arm's start")
        if len(t) < LEAST_ROWS or np.median(np.diff(t)) > SLOWEST:
            raise BadInput(
                f"{told(0)}: {len(t)} rows {np.median(np.diff(t)) if len(t) > 1 else 0:.2g} s apart; 20 Hz at least are needed"
            )
        if t[0] < -0.5:
            raise BadInput(f"{told(0)}: begins {-t[0]:.3g} s before the arm's start; time 0 is where the arm starts")
        leap = np.linalg.norm(np.diff(p, axis=0), axis=1)
        for k in np.flatnonzero(leap > FASTEST * np.diff(t) + SLIP)[:1] + 1:
            raise BadInput(
                f"{told(k)}: the bottle jumps {100 * leap[k - 1]:.0f} cm between two rows; remove what is not it"
            )
        if np.linalg.norm(p - p[0], axis=1).max() < 2 * STILL:
            raise BadInput(
                f"{told(-1)}: the bottle never moved: the hit never came, or the track ends before; leave it out "
                f"(--without {n:g}) or push again"
            )
        keep = (t >= 0.0) & (t <= 3.0)
        found[n] = t[keep], p[keep], path.name


def _aside(names, found, starts) -> np.ndarray:
    rows = [found[n][1][found[n][0] < QUIET] for n in names]
    return np.array([r.mean(0) - s if len(r) else np.zeros(2) for r, s in zip(rows, starts, strict=True)])


def _check_start(starts, aside, where: Path) -> None:
    """Another frame, told before anything is fitted."""
    off = float(np.linalg.norm(np.median(aside, 0)))
    if off > ASIDE:
        x, y = np.median(aside + starts, 0)
        raise BadInput(
            f"{where}: bottles stand at ({x:.3g}, {y:.3g}) m, {100 * off:.0f} cm from where they are declared: another frame? "
            "give tracks in the arm's base frame, or start_x, start_y in actions.csv"
        )


def _noise(meta, time, xy, mask) -> tuple[float, str]:
    if "noise" in meta:
        if not isinstance(meta["noise"], int | float) or not 0.0 < meta["noise"] < 0.05:
            raise BadInput(f"meta.toml: noise = {meta['noise']!r} is no size in m; write e.g. 0.0005")
        return float(meta["noise"]), "declared"
    total, count = 0.0, 0
    for t, p, m in zip(time, xy, mask, strict=True):
        r = p[(m > 0) & (t < QUIET)]
        if len(r) > 1:
            total, count = total + float(np.square(r - r.mean(0)).sum()), count + 2 * (len(r) - 1)
    if count >= 20:
        return max(float(np.sqrt(total / count)), LEAST_NOISE), "rows before the hit"
    d = np.concatenate([np.diff(p[m > 0], 3, axis=0).ravel() for p, m in zip(xy, mask, strict=True)])
    return max(float(1.4826 * np.median(np.abs(d)) / np.sqrt(20.0)), LEAST_NOISE), "third differences"


def _quantum(xy: np.ndarray) -> float:
    """The step of values that are rounded to a grid; 0 where they are not."""
    d = np.diff(np.unique(np.round(xy[:, 0], 7)))
    d = d[d > 1e-7]
    if len(d) < 10:
        return 0.0
    step = float(d.min())
    return step if step > 5e-5 and np.all(np.abs(d / step - np.round(d / step)) < 0.02) else 0.0
