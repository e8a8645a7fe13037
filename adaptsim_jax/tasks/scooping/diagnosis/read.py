"""Recordings of scoops: a folder of `meta.toml`, `actions.csv` and tracks. What cannot be judged is
refused with its row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks import trial_record
from adaptsim_jax.tasks.camera_record import Columns, RowName
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.model import ScoopOptions, check_options
from adaptsim_jax.tasks.scooping.motion import KIND, check_way
from adaptsim_jax.tasks.trial_record import TrialFiles, TrialRecording

KEYS = ("schema", "task", "shape", "height", "clearance", "press", "repeats", "note", "noise")
REPEATS = (5e-4, 2e-3, 1e-4)
"""How well an arm repeats a scoop: pitch rad, rate rad/s, distance m, one standard deviation."""
_LIMITS = {"pitch": (0.0, 0.35, "rad"), "rate": (-0.6, 0.6, "rad/s"), "distance": (0.0, 0.1, "m")}


@dataclass(frozen=True, kw_only=True)
class Scooped(TrialRecording):
    """Scoops: actions rad, rad/s and m.

    places `[T, R, C]` m: x, y and z where it was seen; options of the declared scoop; shape,
    height: Of the piece where declared. repeats: See `REPEATS`.
    """

    places: np.ndarray
    options: ScoopOptions
    shape: str | None = None
    height: float | None = None
    repeats: tuple[float, ...] = REPEATS

    @property
    def channels(self) -> tuple[str, ...]:
        return ("x", "y", "z")[: self.places.shape[-1]]


def read(folder: str | Path, as_declared: bool = False, without: Sequence[str] = ()) -> Scooped:
    """The scoops of a folder. as_declared: Whatever their places say of the frame; without: scoops
    whose tracks are not looked at. Raises BadInput.
    """
    return trial_record.read_folder(folder, KEYS, assemble, as_declared, without)


def assemble(
    actions: Path,
    tracks: list[Path],
    meta: Table,
    where: Path,
    as_declared: bool = False,
    without: Sequence[str] = (),
    own_frame: bool = False,
) -> Scooped:
    """Scoops of an actions file and tracks' files; see `read`. own_frame: Tracks count from
    anywhere. Each is moved to begin at its place.
    """
    files = TrialFiles(actions, tracks, meta, where, without)
    needed = {"place_x": "m", "place_y": "m", **{k: unit for k, (_, _, unit) in _LIMITS.items()}}
    trials = trial_record.read_trials(files, KIND, needed, _check_actions)
    names, found = trials.names, trials.found
    starts, acts = trials.stacked("place_x", "place_y"), trials.stacked(*_LIMITS)
    given = {k: float(meta[k]) for k in ("clearance", "press") if k in meta}
    options = check_options(replace(ScoopOptions(), **given))
    trial_record.check_spacing(names, found)
    if own_frame:
        found |= _moved(names, found, starts)
        trials.notes.append(
            "places are counted from where each piece lay: a shifted camera or piece would not show"
        )
    arrays = trials.laid_out(starts)
    if not as_declared:
        _check_frame(trials, arrays)
    places = arrays["places"]
    fields = trials.recorded(arrays, places, "blade came")
    if not trials.more:
        fields["notes"] += (
            "no heights were seen (column z): a blade's lift and a piece's height show less",
        )
    shape, height = _piece(meta, where)
    piece = {"shape": shape, "height": height, "repeats": _repeats(meta, where)}
    return Scooped(**fields, **piece, actions=acts, places=places, options=options)


def _check_actions(c: Columns, trials: RowName) -> None:
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
    for n, off in zip(names, trial_record.aside(names, found, starts, KIND.still), strict=True):
        p = found[n].places
        moved[n] = found[n]._replace(places=p - np.pad(off, (0, p.shape[1] - 2)))
    return moved


def _piece(meta: Table, where: Path) -> tuple[str | None, float | None]:
    shape, height = meta.get("shape"), meta.get("height")
    if shape is not None:
        config.pick("shape", shape, model.SHAPES)
    if height is not None and not (isinstance(height, int | float) and 0.01 <= height <= 0.035):
        raise BadInput(
            f"{where}: height = {height!r} is no height of a piece within 0.01 to 0.035 m; write "
            "e.g. 0.02"
        )
    return shape, None if height is None else float(height)


def _repeats(meta: Table, where: Path) -> tuple[float, ...]:
    given = meta.get("repeats", REPEATS)
    if len(given) != 3 or not all(isinstance(v, int | float) and 0 < v < 0.1 for v in given):
        raise BadInput(
            f"{where}: repeats = {given!r}; give three sizes in rad, rad/s, m, such as "
            f"{list(REPEATS)}"
        )
    return tuple(map(float, given))


def _check_frame(trials: trial_record.ReadTrials, arrays: Columns) -> None:
    """BadInput where tracks are of another frame, before anything is fitted."""
    aside, where = arrays["aside"], trials.files.where
    x, y = np.median(aside, 0)
    if np.hypot(x, y) > KIND.aside:
        raise BadInput(
            f"{where}: pieces lie ({x:.3g}, {y:.3g}) m from where they are declared: another "
            "frame? give tracks from the middle of the box that place_x, place_y count from, x "
            "along the spatula's way"
        )
    trial_record.check_starts(trials.names, aside, KIND, where)
    check_way(trials.went(arrays), str(where), trials.names)
