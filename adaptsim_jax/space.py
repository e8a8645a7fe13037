"""Omega, the box of simulation parameters, and the distributions over it (paper, section 4.1).

Everything that learns works in *unit coordinates* `u: [..., D]`, where the box is `[0, 1]^D`
whatever the scale of a parameter; `Space.physical` and `Space.unit` convert to and from physical
values. Targets may lie outside the box: the maps extrapolate, they never clamp.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput, brief, finite

Scale = Literal["linear", "log", "categorical"]


@dataclass(frozen=True)
class Parameter:
    """One simulation parameter: its range in Omega and the range in which it means anything at all.

    `low`, `high` are in `unit`. A log parameter is linear in its logarithm; a categorical one takes
    the integers `low..high` and is rounded whenever it is made physical.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    scale: Scale = "linear"
    physical_low: float = -np.inf
    physical_high: float = np.inf
    description: str = ""

    def __post_init__(self):
        if not self.low < self.high:
            raise BadInput(
                f"parameter {self.name}: low {self.low} is not below high {self.high}; swap or "
                "widen them"
            )
        if self.scale == "log" and self.low <= 0:
            raise BadInput(f"parameter {self.name}: a log scale needs low > 0, got {self.low}")
        if self.scale not in ("linear", "log", "categorical"):
            raise BadInput(
                f"parameter {self.name}: scale {self.scale!r} is none of linear, log, categorical"
            )


@dataclass(frozen=True)
class Space:
    """A box of parameters; hashable, so that it may be closed over or be static under jit."""

    parameters: tuple[Parameter, ...]

    def __post_init__(self):
        names = [p.name for p in self.parameters]
        if len(set(names)) != len(names):
            raise BadInput(f"parameter names repeat: {names}; each must be unique")

    def within(self, low: Sequence[float], high: Sequence[float]) -> "Space":
        """The same box with the range, `low[i]` to `high[i]`, in which each parameter means
        anything at all.
        """
        ends = zip(self.parameters, low, high, strict=True)
        return Space(tuple(replace(p, physical_low=a, physical_high=b) for p, a, b in ends))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def dim(self) -> int:
        return len(self.parameters)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        is_log = np.array([p.scale == "log" for p in self.parameters])
        raw = np.array([(p.low, p.high) for p in self.parameters])
        ends = np.where(is_log[:, None], np.log(np.where(is_log[:, None], raw, 1.0)), raw)
        return ends[:, 0], ends[:, 1], is_log

    @property
    def is_categorical(self) -> np.ndarray:
        return np.array([p.scale == "categorical" for p in self.parameters])

    def physical(self, u: jax.Array) -> jax.Array:
        """Unit coordinates `[..., D]` to physical values `[..., D]` in each parameter's unit."""
        u = jnp.asarray(u)
        low, high, is_log = (
            jnp.asarray(b, u.dtype if b.dtype != bool else bool) for b in self._bounds()
        )
        lead = (1,) * (u.ndim - 1)
        x = low.reshape(*lead, -1) + u * (high - low).reshape(*lead, -1)
        x = jnp.where(is_log.reshape(*lead, -1), jnp.exp(x), x)
        return jnp.where(jnp.asarray(self.is_categorical).reshape(*lead, -1), jnp.round(x), x)

    def named(self, u: jax.Array) -> dict[str, float]:
        """Give the physical values at `u [D]` (unit coordinates) by name."""
        return dict(zip(self.names, map(float, np.asarray(self.physical(u))), strict=True))

    def unit(self, x: jax.Array) -> jax.Array:
        """Physical values `[..., D]` to unit coordinates `[..., D]`; outside Omega it
        extrapolates.
        """
        x = jnp.asarray(x)
        low, high, is_log = (
            jnp.asarray(b, x.dtype if b.dtype != bool else bool) for b in self._bounds()
        )
        lead = (1,) * (x.ndim - 1)
        is_log = is_log.reshape(*lead, -1)
        y = jnp.where(is_log, jnp.log(jnp.where(is_log, x, 1.0)), x)
        return (y - low.reshape(*lead, -1)) / (high - low).reshape(*lead, -1)

    def sample(self, key: jax.Array, shape: tuple[int, ...] = ()) -> jax.Array:
        """Uniform over the box, in unit coordinates `[*shape, D]`; every category of a categorical
        parameter as likely.
        """
        u = jax.random.uniform(key, (*shape, self.dim))
        if not self.is_categorical.any():
            return u
        steps, lead = self.category_steps().astype(u.dtype), (1,) * len(shape)
        steps = jnp.asarray(steps).reshape(*lead, -1)
        drawn = jnp.minimum(jnp.floor(u * (steps + 1.0)), steps) / steps
        return jnp.where(jnp.asarray(self.is_categorical).reshape(*lead, -1), drawn, u)

    def snap(self, u: jax.Array) -> jax.Array:
        """`u [..., D]` with categorical coordinates moved to the category that they are rounded to.

        Between two categories there is nothing: distances and steps are only right from one to
        another.
        """
        if not self.is_categorical.any():
            return u
        lead = (1,) * (u.ndim - 1)
        steps = jnp.asarray(self.category_steps().astype(u.dtype)).reshape(*lead, -1)
        return jnp.where(
            jnp.asarray(self.is_categorical).reshape(*lead, -1), jnp.round(u * steps) / steps, u
        )

    def category_steps(self) -> np.ndarray:
        """Steps from the first category to the last, `[D]`; 1 for other parameters."""
        return np.array(
            [max(p.high - p.low, 1.0) if p.scale == "categorical" else 1.0 for p in self.parameters]
        )

    def values(self, settings: Mapping[str, float], where: str = "parameters") -> np.ndarray:
        """Named physical values to an array `[D]`, each checked: all names there, none unknown,
        physically possible.
        """
        for name in settings:
            if name not in self.names:
                raise BadInput(f"{where}: unknown parameter {name!r}; {suggest(name, self.names)}")
        return np.array([self._checked(p, settings, where) for p in self.parameters])

    @staticmethod
    def _checked(p: Parameter, settings: Mapping[str, float], where: str) -> float:
        if p.name not in settings:
            raise BadInput(
                f"{where}: parameter {p.name!r} is missing; add it, in {p.unit or 'its own unit'}"
            )
        value = finite(settings[p.name])
        if value is None:
            given = brief(settings[p.name])
            raise BadInput(
                f"{where}: {p.name} = {given} is not a finite number; give one in "
                f"{p.unit or 'its unit'}"
            )
        if not p.physical_low <= value <= p.physical_high:
            raise BadInput(
                f"{where}: {p.name} = {value} {p.unit} is outside its physical range "
                f"[{p.physical_low:g}, {p.physical_high:g}]; mend the value or its unit"
            )
        return value


class Gaussian(NamedTuple):
    """A simulation parameter distribution E: mean within Omega, fixed spread; both in unit
    coordinates.

    mean: `[..., D]`, std: `[..., D]`.
    """

    mean: jax.Array
    std: jax.Array


def gaussian(space: Space, mean: jax.Array, std: float | Sequence[float] = 1e-4) -> Gaussian:
    """E with the given mean (unit coordinates, clipped to the box) and standard deviation in
    fractions of the range.

    A categorical parameter's mean is one of its categories.
    """
    mean = space.snap(jnp.clip(jnp.asarray(mean), 0.0, 1.0))
    return Gaussian(mean, jnp.broadcast_to(jnp.asarray(std, mean.dtype), mean.shape))


def sample(key: jax.Array, dist: Gaussian, shape: tuple[int, ...] = ()) -> jax.Array:
    """Draw unit coordinates `[*shape, D]` from E, truncated to the box by clipping."""
    noise = jax.random.normal(key, (*shape, *dist.mean.shape), dist.mean.dtype)
    lead = (1,) * len(shape)
    mean = dist.mean.reshape(*lead, *dist.mean.shape)
    std = dist.std.reshape(*lead, *dist.std.shape)
    return jnp.clip(mean + noise * std, 0.0, 1.0)


MINUS, PLUS, STAY = 0, 1, 2


def step(space: Space, dist: Gaussian, action: jax.Array, delta: jax.Array | float) -> Gaussian:
    """Move the mean of E by one adaptation step (paper, section 4.1): `action: [D]` of {MINUS,
    PLUS, STAY}.

    `delta` is a fraction of the range; a categorical parameter moves by a whole category. Clipped
    to the box.
    """
    one = jnp.asarray(1.0 / space.category_steps(), dist.mean.dtype)
    size = jnp.where(jnp.asarray(space.is_categorical), one, delta)
    move = jnp.array([-1.0, 1.0, 0.0], dist.mean.dtype)[action] * size
    return dist._replace(mean=jnp.clip(dist.mean + move, 0.0, 1.0))
