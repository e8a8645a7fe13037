"""Recordings of pushes: a folder of `meta.toml`, `actions.csv` and tracks. What cannot be judged is
refused with its row.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks import trial_record
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.frame import check_each, check_frame, check_hits, check_order
from adaptsim_jax.tasks.pushing.measured import FASTEST, SLIP, STILL, USUAL
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.planar import DEFAULT, DRAKE, PlanarCoefficients, check_options

STILL_SPEED = 0.15  # s; no plate within the bounds touches the bottle so early
ASIDE = 0.15  # m between start and first row from which it is another frame
TURN = trial_record.Size("noise_yaw", "rad", 5e-3, 0.2, 0.01)
"""The least is what a step of 1 ms costs the turn of a bottle."""
KEYS = ("schema", "task", "friction", "coefficients", "mass", "note", "noise", TURN.key)
KIND = trial_record.TrialKind(
    "push",
    "pushes",
    "the bottle",
    reach=3.0,
    fastest=FASTEST,
    slip=SLIP,
    moves=2 * STILL,
    ends=3.0,
    usual=USUAL,
    never="the hit never came, or the track ends before",
    optional=("yaw",),
    angles=("yaw",),
)


@dataclass(frozen=True)
class Pushed:
    """T pushes of at most R rows.

    names `[T]`; actions `[T, 2]` m/s, rad; starts `[T, 2]` m as declared; aside `[T, 2]` m from
    there to the first rows' mean; time `[T, R]` s, xy `[T, R, 2]` m, mask `[T, R]`; noise m of one
    coordinate; notes: what the files say beside. yaw `[T, R]` rad where the bottle's turn was
    measured, to the left positive, from each push's first rows; turned `[T, R]`: rows that show it;
    noise_yaw rad.
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
    yaw: np.ndarray | None = None
    turned: np.ndarray | None = None
    noise_yaw: float = 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        if self.yaw is None:
            return ("x", "y")
        return ("x", "y", "yaw")

    @property
    def places(self) -> np.ndarray:
        """`[T, R, C]` m and rad."""
        if self.yaw is None:
            return self.xy
        return np.concatenate([self.xy, self.yaw[..., None]], -1)

    @property
    def known(self) -> np.ndarray:
        """`[T, R, C]`: what was measured."""
        known = np.repeat(self.mask[..., None], 2, -1)
        if self.turned is None:
            return known
        return np.concatenate([known, self.turned[..., None]], -1)

    @property
    def sizes(self) -> np.ndarray:
        """`[C]` m and rad: the noise of each channel."""
        return np.array([self.noise, self.noise, self.noise_yaw][: len(self.channels)])


def read(folder: str | Path, as_declared: bool = False, without: Sequence[str] = ()) -> Pushed:
    """The pushes of a folder. as_declared: whatever their directions say of the frame; without:
    pushes whose tracks are not looked at. Raises BadInput.
    """
    return trial_record.read_folder(folder, KEYS, assemble, as_declared, without)


def assemble(
    actions: Path,
    tracks: list[Path],
    meta: dict[str, Any],
    where: Path,
    as_declared: bool = False,
    without: Sequence[str] = (),
) -> Pushed:
    """Pushes of an actions file and tracks' files; see `read`."""
    table, trials = trial_record.read_actions(
        actions, {"speed": "m/s", "angle": "rad"}, ("start_x", "start_y"), KIND.trials
    )
    c = table.columns
    _check_actions(c, trials)
    numbers = c["trial"]
    found, more = trial_record.read_tracks(tracks, numbers, actions, KIND, without, as_declared)
    names, notes = trial_record.tracked(numbers, found, where, KIND, "12 to 24")
    row = {n: i for i, n in enumerate(numbers)}
    at = np.array([row[n] for n in names])

    def default(k):
        return c.get(f"start_{'xy'[k]}", np.full(len(numbers), model.START[k]))[at]

    starts = np.stack([default(0), default(1)], 1)
    time, places, mask = trial_record.padded(names, found)
    xy = places[..., :2]
    acts = np.stack([c["speed"], c["angle"]], 1)[at]
    aside = trial_record.aside(names, found, starts, STILL_SPEED)
    _check_start(starts, aside, where)
    trial_record.check_starts(names, aside, ASIDE, KIND.body, where)
    ends = np.array([p[int(m.sum()) - 1] - p[0] for p, m in zip(xy, mask, strict=True)])
    if not as_declared:
        check_hits([found[n].began for n in names], acts, starts, trial_record.place_of(tracks))
    trial_record.check_spacing(names, found)
    if not as_declared:
        check_frame(acts[:, 1], ends, str(where))  # a slight turn is an effect of the catalogue
        check_order(names, acts[:, 1], ends, str(where))
        check_each(names, acts[:, 1], ends, str(where))
    noise, source = trial_record.noise_of(meta, time, xy, mask, STILL_SPEED, "hit")
    notes += trial_record.rounding_notes(xy[mask > 0], noise)
    options = PushOptions(
        friction=meta.get("friction", "clean"), mass=float(meta.get("mass", model.NOMINAL_MASS))
    )
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
        *(_turns(time, places[..., 2], mask, meta, where) if more else (None, None, 0.0)),
    )


def _check_actions(c: Mapping[str, np.ndarray], trials: Callable) -> None:
    """BadInput at a push that no arm makes."""
    for i, (speed, angle) in enumerate(zip(c["speed"], c["angle"], strict=True)):
        if not 0.1 <= speed <= 2.0:
            raise BadInput(
                f"{trials(i)}: speed {speed:g} is not within 0.1 to 2 m/s; is it in another unit?"
            )
        if abs(angle) > 1.2:
            raise BadInput(
                f"{trials(i)}: angle {angle:g} rad is beyond any push; is it in degrees? write "
                "radians"
            )


def _turns(
    time, yaw, mask, meta: dict[str, Any], where: Path
) -> tuple[np.ndarray, np.ndarray, float]:
    """yaw, turned, noise_yaw of `Pushed`: a marker sits as it was glued on, so that each push is
    counted from its first rows.
    """
    turned = mask * ~np.isnan(yaw)
    out = np.zeros_like(yaw)
    for k, (t, z) in enumerate(zip(time, yaw, strict=True)):
        if len(observed := np.flatnonzero(turned[k])):
            if t[observed[0]] < STILL_SPEED:
                first = observed[t[observed] < STILL_SPEED]
            else:
                first = observed[:1]
            out[k] = np.interp(t, t[observed], z[observed]) - z[first].mean()
    noise, _ = trial_record.noise_of(meta, time, out[..., None], turned, STILL_SPEED, "hit", TURN)
    if noise > TURN.most:
        raise BadInput(
            f"{where}: yaw scatters by {noise:.2g} rad before the hit; is it in degrees? write "
            "radians"
        )
    return out, turned, noise


def _check_start(starts, aside, where: Path) -> None:
    """Another frame, told before anything is fitted."""
    off = float(np.linalg.norm(np.median(aside, 0)))
    if off > ASIDE:
        x, y = np.median(aside + starts, 0)
        raise BadInput(
            f"{where}: bottles stand at ({x:.3g}, {y:.3g}) m, {100 * off:.0f} cm from where they "
            "are declared: another frame? give tracks in the arm's base frame, or start_x, "
            "start_y in actions.csv"
        )
