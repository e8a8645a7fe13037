"""The contract of a simulator that is diagnosed: quantities, channels, stretches, candidates, and
one function that predicts.

Whatever predicts what was measured is a simulator: MuJoCo, a network, sixty lines of NumPy. The
core asks it for nothing but `predict`; what it may override, because it knows better, is
`linearise`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.core.registry import Registry, function_named
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.effects.base import Effect, Quantity

DERIVATIVE_STEP = 1e-2  # of a quantity's scale, to either side, by which a derivative is taken


@dataclass(frozen=True)
class Channel:
    """One measured signal: its name, unit, and noise (standard deviation, in that unit)."""

    name: str
    unit: str
    noise: float


@dataclass(frozen=True)
class Stretches:
    """What is compared: W stretches of at most R rows of C channels, each with S numbers of its own
    that are fitted (its start).

    Args:
        trial: `[W]` which of `names` each is of; time `[W, R]`; measured `[W, R, C]`.
        seen: `[W, R, C]` 1 where something was measured (a stretch that is shorter ends unseen).
        start: `[W, S]` a first guess, S 0 where starts are known.
        scale: `[S]` a size that matters of each.
        prior: `[S]` how far each may be from its first guess (standard deviation), where readings
            do not tell.
    """

    trial: np.ndarray
    names: tuple[str, ...]
    time: np.ndarray
    measured: np.ndarray
    seen: np.ndarray
    start: np.ndarray
    scale: np.ndarray
    prior: np.ndarray | None = None

    @property
    def count(self) -> int:
        return len(self.trial)

    def of(self, which: np.ndarray) -> "Stretches":
        """Those stretches alone."""
        lanes = {k: getattr(self, k)[which] for k in ("trial", "time", "measured", "seen", "start")}
        return replace(self, **lanes)


class Simulator(Protocol):
    """What is asked of a simulator. declared: names of quantities that are fitted whatever is
    found.

    Optional: `linearise` (see that function); `notes`: of quantities by name sentences for the
    report; and `mended`: {file name: what makes its text of
    quantities by name}: files of the simulator's own that a diagnosis leaves beside `model.toml`;
    one that fails is a line of the report, which is written before.
    """

    @property
    def quantities(self) -> tuple[Quantity, ...]: ...
    @property
    def declared(self) -> tuple[str, ...]: ...
    @property
    def channels(self) -> tuple[Channel, ...]: ...
    @property
    def stretches(self) -> Stretches: ...
    @property
    def candidates(self) -> tuple[Effect, ...]: ...

    def predict(self, values: np.ndarray, starts: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Outputs `[B, R, C]` of a batch: stretch `which [B]` from starts `[B, S]` with values `[B,
        P]` of all quantities.
        """
        ...


def check_simulator(simulator: Simulator) -> None:
    """Raises BadInput where sizes and names of a simulator do not agree, or two predictions of the
    same differ.
    """
    s, names = simulator.stretches, [q.name for q in simulator.quantities]
    shape = (s.count, s.time.shape[1], len(simulator.channels))
    if len(set(names)) < len(names):
        raise BadInput(
            f"simulator: quantities {', '.join(names)} have a name twice; give each its own"
        )
    asked = [*simulator.declared, *(q for c in simulator.candidates for q in c.names)]
    if unknown := sorted(set(asked) - set(names)):
        raise BadInput(f"simulator: no quantity is named {unknown[0]!r}; it has {', '.join(names)}")
    for what, x, wanted in (
        ("measured", s.measured, shape),
        ("seen", s.seen, shape),
        ("start", s.start, (s.count, len(s.scale))),
    ):
        if x.shape != wanted:
            raise BadInput(f"simulator: stretches.{what} has shape {x.shape}; {wanted} is wanted")
    if s.count < FOLD.min_stretches:
        raise BadInput(
            f"simulator: {s.count} stretches are too few to leave any out; give at least "
            f"{FOLD.min_stretches}"
        )
    if len(gone := np.argwhere((s.seen > 0) & ~np.isfinite(s.measured))):
        w, r, c = gone[0]
        where = f"stretch {w}, row {r}, channel {simulator.channels[c].name}"
        raise BadInput(f"simulator: {where} is not finite though it is seen; write seen = 0 there")
    values = np.tile([q.default for q in simulator.quantities], (s.count, 1))
    one, two = (
        np.asarray(simulator.predict(values, s.start, np.arange(s.count))) for _ in range(2)
    )
    if one.shape != shape:
        raise BadInput(
            f"simulator: predict gives shape {one.shape}; {shape} is wanted (stretches, rows, "
            "channels)"
        )
    gone = np.flatnonzero(~np.isfinite(np.where(s.seen > 0, one, 0.0)).all((1, 2)))
    if len(gone) == s.count:
        raise BadInput(
            "simulator: predict gives no finite numbers of any stretch at neutral values; is a "
            "start or a unit wrong?"
        )
    if not np.array_equal(one, two, equal_nan=True):
        raise BadInput(
            "simulator: predict gives two answers to one question; fix its seed, or pass its "
            "state as a start"
        )


def residuals(
    simulator: Simulator, values: np.ndarray, starts: np.ndarray, which: np.ndarray
) -> np.ndarray:
    """Measured less predicted, over the noise: `[B, R C]`, zero where nothing was seen; what ran
    away is a thousand noises off.
    """
    s = simulator.stretches
    noise = np.array([c.noise for c in simulator.channels])
    with np.errstate(over="ignore", invalid="ignore"):
        off = (s.measured[which] - simulator.predict(values, starts, which)) / noise
    off = np.nan_to_num(np.clip(off, -1e6, 1e6), nan=1e3)
    return np.where(s.seen[which] > 0, off, 0.0).reshape(len(which), -1)


def differences(
    simulator: Simulator,
    values: np.ndarray,
    starts: np.ndarray,
    which: np.ndarray,
    ways: Sequence[tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Derivatives `[B, R C, K]` of predictions over the noise along K ways, by central differences,
    on all cores.

    Each way is a pair of `(d values [P], d starts [S])` of the size of a unit step; differences are
    taken over `DERIVATIVE_STEP` of it.
    """

    def along(way: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        def at(step: float) -> np.ndarray:
            return residuals(simulator, values + step * way[0], starts + step * way[1], which)

        ahead, behind = at(DERIVATIVE_STEP), at(-DERIVATIVE_STEP)
        return (behind - ahead) / (2.0 * DERIVATIVE_STEP)

    if not len(ways):
        return np.zeros((len(which), simulator.stretches.measured[0].size, 0))
    return np.stack(parallel_map(along, list(ways)), -1)


def linearise(
    simulator: Simulator,
    values: np.ndarray,
    starts: np.ndarray,
    which: np.ndarray,
    basis: np.ndarray,
    starts_too: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of predictions over the noise: by starts `[B, R C, S]` (in steps of
    `Stretches.scale`; S is 0 without `starts_too`), and by values along the rows of `basis [K, P]`,
    `[B, R C, K]`. A simulator with a `linearise` of its own, of the same arguments, gives its own.
    """
    own = getattr(simulator, "linearise", None)
    if own is not None:
        return own(values, starts, which, basis, starts_too)
    none_v, none_s = np.zeros(values.shape[1]), np.zeros(starts.shape[1])
    steps = np.diag(simulator.stretches.scale) if starts_too else ()
    by_start = differences(simulator, values, starts, which, [(none_v, row) for row in steps])
    return by_start, differences(simulator, values, starts, which, [(row, none_s) for row in basis])


OF_MECHANISMS = ("tree", "mujoco")

SIMULATORS: Registry[Callable[[Path], Simulator]] = Registry("simulators", own={})


def simulator_named(name: str) -> Callable[[Path], Simulator]:
    """What makes a simulator of a folder: an entry point's name, `module:function` or
    `file.py:function`.

    Raises BadInput where there is none of that name.
    """
    if name in SIMULATORS:
        return SIMULATORS[name]
    if ":" in name:
        return function_named(name, "--simulator")
    known = (*OF_MECHANISMS, *SIMULATORS, "module:function", "file.py:function")
    raise BadInput(f"--simulator: '{name}' is unknown; {suggest(name, known)}")
