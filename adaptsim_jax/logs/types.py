"""What was measured: a trial and a recording, in SI units, as every later stage sees them."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Trial:
    """One trial: `time: [T]` s, `q: [T, 2]` rad, `v: [T, 2]` rad/s or None, `torque: [T, 2]` N m.

    A torque holds from its row to the next. `commanded: [T, 2]` N m is there where the file has it
    beside measured torques. `ignored` lists the file's other columns.
    """

    name: str
    path: str
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    torque: np.ndarray
    commanded: np.ndarray | None = None
    ignored: tuple[str, ...] = ()

    @property
    def dt(self) -> float:
        """Median sampling interval in s."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True)
class Recording:
    """A folder of trials and what its `meta.toml` declares.

    `geometry`: l1, l2 in m and g in m/s^2, as far as known; `noise`: sensor std by channel (rad,
        rad/s, N m);
    `torque_source`: `measured`, `commanded`, `applied` or `mixed`; `model_file`: path of a mended
        model.
    """

    path: str
    task: str
    model: str
    angle_zero: str
    geometry: dict[str, float]
    known: dict[str, float]
    noise: dict[str, float]
    trials: tuple[Trial, ...]
    torque_source: str
    notes: tuple[str, ...] = ()
    model_file: str | None = None
    left_out: tuple[str, ...] = ()  # trials whose files were not read

    @property
    def samples(self) -> int:
        """Rows over all trials."""
        return sum(len(trial.time) for trial in self.trials)

    def replace(self, **changes) -> "Recording":
        """A copy with these fields changed."""
        return replace(self, **changes)
