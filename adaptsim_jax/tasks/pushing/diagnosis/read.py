"""Recordings of pushes: a folder of `meta.toml`, `actions.csv` and tracks. What cannot be judged is
refused with its row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks import trial_record
from adaptsim_jax.tasks.camera_record import Columns, RowName
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.frame import KIND, check_frame
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.planar import TWINS, PlanarCoefficients, check_options
from adaptsim_jax.tasks.trial_record import TrialFiles, TrialRecording

TURN = trial_record.Size("noise_yaw", "rad", 5e-3, 0.2, 0.01)
"""The least is what a step of 1 ms costs the turn of a bottle."""
KEYS = ("schema", "task", "friction", "coefficients", "mass", "note", "noise", TURN.key)


@dataclass(frozen=True, kw_only=True)
class Pushed(TrialRecording):
    """Pushes: actions m/s and rad.

    xy `[T, R, 2]` m; options and coefficients of the declared push. yaw `[T, R]` rad where the
    bottle's turn was measured, to the left positive, from each push's first rows; turned `[T, R]`:
    rows that show it; noise_yaw rad.
    """

    xy: np.ndarray
    options: PushOptions
    coefficients: PlanarCoefficients
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
    """The pushes of a folder. as_declared: Whatever their directions say of the frame; without:
    pushes whose tracks are not looked at. Raises BadInput.
    """
    return trial_record.read_folder(folder, KEYS, assemble, as_declared, without)


def assemble(
    actions: Path,
    tracks: list[Path],
    meta: Table,
    where: Path,
    as_declared: bool = False,
    without: Sequence[str] = (),
) -> Pushed:
    """Pushes of an actions file and tracks' files; see `read`."""
    files = TrialFiles(actions, tracks, meta, where, without)
    units, begun = {"speed": "m/s", "angle": "rad"}, ("start_x", "start_y")
    trials = trial_record.read_trials(files, KIND, units, _check_actions, begun)
    c, names = trials.columns, trials.names
    starts = np.stack(
        [c.get(k, np.full(len(names), z)) for k, z in zip(begun, model.START, strict=True)], 1
    )
    arrays = trials.laid_out(starts)
    time, xy, acts = arrays["time"], arrays["places"][..., :2], trials.stacked("speed", "angle")
    _check_start(starts, arrays["aside"], where)
    trial_record.check_starts(names, arrays["aside"], KIND, where)
    trial_record.check_spacing(names, trials.found)
    if not as_declared:
        # a slight turn is an effect of the catalogue
        check_frame(names, acts[:, 1], trials.went(arrays)[:, :2], str(where))
    mass = float(meta.get("mass", model.NOMINAL_MASS))
    options = PushOptions(friction=meta.get("friction", "clean"), mass=mass)
    which = config.pick("coefficients", meta.get("coefficients", "native"), TWINS)
    fields = trials.recorded(arrays, xy, "hit")
    if trials.more:
        fields |= _turns(time, arrays["places"][..., 2], arrays["mask"], meta, where)
    return Pushed(
        **fields, actions=acts, xy=xy, options=check_options(options), coefficients=TWINS[which]
    )


def _check_actions(c: Columns, trials: RowName) -> None:
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


def _turns(time, yaw, mask, meta: Table, where: Path) -> Table:
    """yaw, turned and noise_yaw of `Pushed`. A marker sits as it was glued on, so each push is
    counted from its first rows.
    """
    turned = mask * ~np.isnan(yaw)
    out = np.zeros_like(yaw)
    for k, (t, z) in enumerate(zip(time, yaw, strict=True)):
        if len(observed := np.flatnonzero(turned[k])):
            if t[observed[0]] < KIND.still:
                first = observed[t[observed] < KIND.still]
            else:
                first = observed[:1]
            out[k] = np.interp(t, t[observed], z[observed]) - z[first].mean()
    noise, _ = trial_record.noise_of(meta, time, out[..., None], turned, KIND.still, "hit", TURN)
    if noise > TURN.most:
        raise BadInput(
            f"{where}: yaw scatters by {noise:.2g} rad before the hit; is it in degrees? write "
            "radians"
        )
    return {"yaw": out, "turned": turned, "noise_yaw": noise}


def _check_start(starts, aside, where: Path) -> None:
    """Another frame, told before anything is fitted."""
    off = float(np.linalg.norm(np.median(aside, 0)))
    if off > KIND.aside:
        x, y = np.median(aside + starts, 0)
        raise BadInput(
            f"{where}: bottles stand at ({x:.3g}, {y:.3g}) m, {100 * off:.0f} cm from where they "
            "are declared: another frame? give tracks in the arm's base frame, or start_x, "
            "start_y in actions.csv"
        )
