"""Recordings of scoops: a folder of `meta.toml`, `actions.csv` and tracks. What cannot be judged is
refused with its row.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks import trial_record
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.measured import (
    FASTEST,
    MAX_DISTANCE,
    SLIP,
    USUAL,
    check_mirrored,
    check_way,
)
from adaptsim_jax.tasks.scooping.model import ScoopOptions, check_options
from adaptsim_jax.tasks.scooping.motion import check_reach

STILL_SPEED = 0.05  # s; no blade within the bounds touches the piece so early
ASIDE = 0.10  # m between place and first rows from which it is another frame
KEYS = ("schema", "task", "shape", "height", "clearance", "press", "repeats", "note", "noise")
REPEATS = (5e-4, 2e-3, 1e-4)
"""How well an arm repeats a scoop: pitch rad, rate rad/s, distance m, one standard deviation."""
KIND = trial_record.TrialKind(
    "scoop",
    "scoops",
    "the piece",
    reach=MAX_DISTANCE,
    fastest=FASTEST,
    slip=SLIP,
    moves=0.01,
    ends=model.SECONDS,
    never="the blade never came, or the track ends before",
    optional=("z",),
    usual=USUAL,
)
_LIMITS = {"pitch": (0.0, 0.35, "rad"), "rate": (-0.6, 0.6, "rad/s"), "distance": (0.0, 0.1, "m")}


@dataclass(frozen=True)
class Scooped:
    """T scoops of at most R rows.

    names `[T]`; actions `[T, 3]` rad, rad/s, m; starts `[T, 2]` m as declared; aside `[T, 2]` m
    from there to the first rows' mean; time `[T, R]` s, places `[T, R, C]` m (x, y and z where it
    was seen), mask `[T, R]`; noise m of one coordinate; shape, height: of the piece where declared;
    repeats: see `REPEATS`; notes: what the files say beside.
    """

    names: tuple[str, ...]
    actions: np.ndarray
    starts: np.ndarray
    aside: np.ndarray
    time: np.ndarray
    places: np.ndarray
    mask: np.ndarray
    noise: float
    noise_source: str
    options: ScoopOptions
    shape: str | None = None
    height: float | None = None
    repeats: tuple[float, ...] = REPEATS
    notes: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        return ("x", "y", "z")[: self.places.shape[-1]]


def read(folder: str | Path, as_declared: bool = False, without: Sequence[str] = ()) -> Scooped:
    """The scoops of a folder. as_declared: whatever their places say of the frame; without: scoops
    whose tracks are not looked at. Raises BadInput.
    """
    return trial_record.read_folder(folder, KEYS, assemble, as_declared, without)


def assemble(
    actions: Path,
    tracks: list[Path],
    meta: dict[str, Any],
    where: Path,
    as_declared: bool = False,
    without: Sequence[str] = (),
    own_frame: bool = False,
) -> Scooped:
    """Scoops of an actions file and tracks' files; see `read`. own_frame: tracks count from
    anywhere. Each is moved to begin at its place.
    """
    needed = {"place_x": "m", "place_y": "m", **{k: unit for k, (_, _, unit) in _LIMITS.items()}}
    table, trials = trial_record.read_actions(actions, needed, (), KIND.trials)
    c = table.columns
    _check_actions(c, trials)
    numbers = c["trial"]
    found, more = trial_record.read_tracks(tracks, numbers, actions, KIND, without, as_declared)
    names, notes = trial_record.tracked(numbers, found, where, KIND, "12 to 24")
    at = np.array([int(np.flatnonzero(numbers == n)[0]) for n in names])
    starts = np.stack([c["place_x"], c["place_y"]], 1)[at]
    acts = np.stack([c[name] for name in _LIMITS], 1)[at]
    options = replace(
        ScoopOptions(), **{k: float(meta[k]) for k in ("clearance", "press") if k in meta}
    )
    if not as_declared:
        check_reach(
            [found[n].began for n in names],
            acts,
            check_options(options),
            trial_record.place_of(tracks),
        )
        check_mirrored(starts[:, 1], np.array([found[n].places[0, 1] for n in names]), str(where))
    trial_record.check_spacing(names, found)
    if own_frame:
        found |= _moved(names, found, starts)
        notes.append(
            "places are counted from where each piece lay: a shifted camera or piece would not show"
        )
    time, places, mask = trial_record.padded(names, found)
    aside = trial_record.aside(names, found, starts, STILL_SPEED)
    if not as_declared:
        _check_frame(names, starts, aside, places, mask, where)
    noise, source = trial_record.noise_of(meta, time, places, mask, STILL_SPEED, "blade came")
    notes += trial_record.rounding_notes(places[mask > 0], noise)
    if not more:
        notes.append(
            "no heights were seen (column z): a blade's lift and a piece's height show less"
        )
    shape, height = _piece(meta, where)
    return Scooped(
        tuple(f"{n:g}" for n in names),
        acts,
        starts,
        aside,
        time,
        places,
        mask,
        noise,
        source,
        options,
        shape,
        height,
        _repeats(meta, where),
        tuple(notes),
    )


def _check_actions(c: Mapping[str, np.ndarray], trials: Callable) -> None:
    """BadInput at a scoop that no arm makes."""
    for name, (low, high, unit) in _LIMITS.items():
        for i in np.flatnonzero((c[name] < low) | (c[name] > high))[:1]:
            if name != "distance":
                mend = "in degrees? write radians"
            else:
                mend = "in mm? write metres"
            raise BadInput(
                f"{trials(i)}: {name} {c[name][i]:g} is not within {low:g} to {high:g} {unit}; is "
                f"it {mend}"
            )


def _moved(names: Sequence[float], found: trial_record.Tracks, starts: np.ndarray) -> Any:
    """The tracks, each moved to begin at its place of `starts [T, 2]` m."""
    moved = {}
    for n, off in zip(names, trial_record.aside(names, found, starts, STILL_SPEED), strict=True):
        p = found[n].places
        moved[n] = found[n]._replace(places=p - np.pad(off, (0, p.shape[1] - 2)))
    return moved


def _piece(meta: dict[str, Any], where: Path) -> tuple[str | None, float | None]:
    shape, height = meta.get("shape"), meta.get("height")
    if shape is not None:
        config.pick("shape", shape, model.SHAPES)
    if height is not None and not (isinstance(height, int | float) and 0.01 <= height <= 0.035):
        raise BadInput(
            f"{where}: height = {height!r} is no height of a piece within 0.01 to 0.035 m; write "
            "e.g. 0.02"
        )
    return shape, None if height is None else float(height)


def _repeats(meta: dict[str, Any], where: Path) -> tuple[float, ...]:
    given = meta.get("repeats", REPEATS)
    if len(given) != 3 or not all(isinstance(v, int | float) and 0 < v < 0.1 for v in given):
        raise BadInput(
            f"{where}: repeats = {given!r}; give three sizes in rad, rad/s, m, such as "
            f"{list(REPEATS)}"
        )
    return tuple(map(float, given))


def _check_frame(names, starts, aside, places, mask, where: Path) -> None:
    """Another frame, told before anything is fitted."""
    off = float(np.linalg.norm(np.median(aside, 0)))
    if off > ASIDE:
        x, y = np.median(aside, 0)
        raise BadInput(
            f"{where}: pieces lie ({x:.3g}, {y:.3g}) m from where they are declared: another "
            "frame? give tracks from the middle of the box that place_x, place_y count from, x "
            "along the spatula's way"
        )
    trial_record.check_starts(names, aside, ASIDE, KIND.body, where)
    check_way(
        np.array([p[int(m.sum()) - 1] - p[0] for p, m in zip(places, mask, strict=True)]),
        str(where),
        names,
    )
