"""What is fitted, as one flat vector: inertial parameters by body, and parameters of effects by
joint.

The inertial parameters of a body are those of its declared ones under a transformation near the
identity,
J = U0 V(eta) V(eta)' U0', of its pseudo-inertia (log-Cholesky: Rucker and Wensing, 2022), so they
are admissible at any eta and all ten numbers are without unit. A weak prior holds what the data do
not fix at what was declared.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.criteria import PRIOR_WIDTH
from adaptsim_jax.diagnosis.steps import bounded_step
from adaptsim_jax.effects.joints import catalogue
from adaptsim_jax.effects.joints.catalogue import BODY, WIDEST
from adaptsim_jax.mechanisms.tree import Tree

INERTIA, BODY_MASS, TILT = (e.name for e in (BODY, catalogue.BODY_MASS, catalogue.TILT))
BODY_NUMBERS = tuple(p.name for e in (BODY, catalogue.BODY_MASS) for p in e.parameters)
OF_BODIES = (INERTIA, BODY_MASS)


@dataclass(frozen=True)
class Entry:
    """One number of the vector. `owner` is an effect's name or `inertia`; joints: where it acts
    (several: one shared value; a body goes by its joint); off: its value where nothing is added;
    prior: standard deviation about `start`, infinite where none.
    """

    owner: str
    name: str
    joints: tuple[int, ...]
    start: float
    off: float
    low: float
    high: float
    unit: str
    prior: float = np.inf

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        return self.owner, self.name, self.joints

    def at_bound(self, value: float, share: float) -> bool:
        """Whether a value lies at an end of the range (within a share of it) that is neither where
        it is off nor where it began.
        """

        def near(end):
            return bool(np.isfinite(end)) and abs(value - end) <= share * abs(end)

        lightest = self.owner == BODY_MASS and self.name == "mass"  # may well be the body's
        below = self.low < min(self.off, self.start) and not lightest
        return near(self.high) or (below and near(self.low))


@dataclass(frozen=True)
class Vector:
    """Entries and their values [P]."""

    entries: tuple[Entry, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.entries)

    def index(self) -> dict[tuple, int]:
        return {e.key: i for i, e in enumerate(self.entries)}

    def pairs(self) -> Iterator[tuple[Entry, float]]:
        """Each entry with its value."""
        return zip(self.entries, self.values.tolist(), strict=True)

    def known(self) -> dict[tuple, float]:
        """Values by key."""
        return {e.key: z for e, z in self.pairs()}

    def bodies(self, joints: Sequence[int]) -> np.ndarray:
        """What is fitted of the bodies that joints move, by `BODY_NUMBERS` [n, 14]."""
        out = np.zeros((len(joints), len(BODY_NUMBERS)))
        for e, z in self.pairs():
            if e.owner in OF_BODIES and e.joints[0] in joints:
                out[joints.index(e.joints[0]), BODY_NUMBERS.index(e.name)] = z
        return out

    @property
    def low(self) -> np.ndarray:
        return np.array([e.low for e in self.entries])

    @property
    def high(self) -> np.ndarray:
        return np.array([e.high for e in self.entries])

    @property
    def precision(self) -> np.ndarray:
        return np.array([e.prior**-2.0 for e in self.entries])

    @property
    def start(self) -> np.ndarray:
        return np.array([e.start for e in self.entries])

    def at(self, values: np.ndarray) -> "Vector":
        return replace(self, values=np.asarray(values, float))

    def bounded_step(self, hess: np.ndarray, slope: np.ndarray, damping: float) -> np.ndarray:
        """Step [P] by normal equations without the prior, which is added, within the bounds."""
        prior = self.precision
        slope = slope - prior * (self.values - self.start)
        ends = self.low - self.values, self.high - self.values
        return bounded_step(hess + np.diag(prior), slope, *ends, damping)

    def with_entries(
        self, added: Iterable[Entry], values: Sequence[float] | None = None
    ) -> "Vector":
        """With more entries; those there are already keep their values."""
        known = self.index()
        fresh = [e for e in added if e.key not in known]
        start = [e.start for e in fresh] if values is None else list(values)
        return Vector(self.entries + tuple(fresh), np.concatenate([self.values, start]))

    def without(self, keys: Iterable[tuple]) -> "Vector":
        """Without some entries."""
        gone = set(keys)
        keep = [i for i, e in enumerate(self.entries) if e.key not in gone]
        return Vector(tuple(self.entries[i] for i in keep), self.values[keep])


def pseudo_inertia(inertial):
    """Pseudo-inertia [4, 4] of (m, m c, Ixx, Ixy, Ixz, Iyy, Iyz, Izz) [10] about the body's
    origin.
    """
    m, x, y, z, xx, xy, xz, yy, yz, zz = inertial
    half = 0.5 * (xx + yy + zz)
    row_x = [half - xx, -xy, -xz, x]
    row_y = [-xy, half - yy, -yz, y]
    row_z = [-xz, -yz, half - zz, z]
    return jnp.array([row_x, row_y, row_z, [x, y, z, m]])


def inertial_of(j):
    """The reverse of `pseudo_inertia`."""
    a, b, c = j[0, 0], j[1, 1], j[2, 2]
    weight = [j[3, 3], j[0, 3], j[1, 3], j[2, 3]]
    about_x = [b + c, -j[0, 1], -j[0, 2]]
    about_y = [a + c, -j[1, 2]]
    return jnp.stack([*weight, *about_x, *about_y, a + b])


def root(inertial: np.ndarray) -> np.ndarray:
    """Upper triangular U0 [4, 4] with U0 U0' the pseudo-inertia, of a thin body thickened by a
    hundredth of its size.
    """
    j = np.asarray(pseudo_inertia(np.asarray(inertial, float)))
    com = j[:3, 3] / j[3, 3]
    second = j[:3, :3] - j[3, 3] * np.outer(com, com)
    value, vector = np.linalg.eigh(second)
    value = np.maximum(value, max(value.max(), 1e-8 * j[3, 3]) * 1e-4)
    second = vector @ np.diag(value) @ vector.T
    j = j.copy()
    j[:3, :3] = second + j[3, 3] * np.outer(com, com)
    flip = np.eye(4)[::-1]
    return flip @ np.linalg.cholesky(flip @ j @ flip) @ flip


def moved(u0, numbers):
    """Inertial parameters [10] at `BODY_NUMBERS` [14] from the root of the declared ones [4, 4]."""
    a, dx, dy, dz, xy, xz, yz, tx, ty, tz, *more = numbers
    one, zero = jnp.exp(0.0 * a), 0.0 * a
    triangle = [
        [jnp.exp(dx), xy, xz, tx],
        [zero, jnp.exp(dy), yz, ty],
        [zero, zero, jnp.exp(dz), tz],
        [zero, zero, zero, one],
    ]
    u = u0 @ (jnp.array(triangle) * jnp.exp(a))
    return inertial_of(_reweighed(u @ u.T, *more))


LEAST_MASS = 0.05  # of a body's mass, that a change of it leaves at least


def _reweighed(j, mass, *moments):
    """A pseudo-inertia [4, 4] with more mass and first moments. More mass alone is at the centre of
    mass; the second moments about that grow in proportion.
    """
    centre = j[:, 3] / j[3, 3]
    factor = jnp.maximum(1.0 + mass / j[3, 3], LEAST_MASS)
    there = centre + jnp.stack([*moments, 0.0 * mass]) / (factor * j[3, 3])
    spread = j - j[3, 3] * jnp.outer(centre, centre)
    return factor * (spread + j[3, 3] * jnp.outer(there, there))


@jax.jit
def _moved_all(roots, numbers):
    """[nb, 10] and its derivative [nb, 10, 14]."""
    return jax.vmap(moved)(roots, numbers), jax.vmap(jax.jacfwd(moved, argnums=1))(roots, numbers)


@dataclass(frozen=True)
class Inertias:
    """Declared inertial parameters [nb, 10] and the roots of those that have a mass."""

    declared: np.ndarray
    roots: np.ndarray
    massive: np.ndarray  # [nb] bool

    def at(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inertial parameters [nb, 10] at `BODY_NUMBERS` [nb, 14], and their derivative
        [nb, 10, 14].
        """
        with jax.enable_x64(True):
            value, slope = (np.array(z) for z in _moved_all(self.roots, np.asarray(numbers, float)))
        none = np.all(numbers == 0.0, axis=1) | ~self.massive
        value[none] = self.declared[none]
        slope[~self.massive] = 0.0
        return value, slope


def inertias(declared: np.ndarray) -> Inertias:
    """Of the declared ones [nb, 10]; bodies without mass stay so."""
    declared = np.asarray(declared, float)
    massive = declared[:, 0] > 0.0
    with jax.enable_x64(True):
        roots = np.stack(
            [root(d) if m else np.eye(4) for d, m in zip(declared, massive, strict=True)]
        )
    return Inertias(declared, roots, massive)


def inertia_entries(massive: np.ndarray) -> tuple[Entry, ...]:
    """Ten entries for each body that has a mass."""
    make = partial(Entry, INERTIA, start=0.0, off=0.0, unit="1", prior=PRIOR_WIDTH.inertia)
    return tuple(
        make(name, (int(b),), low=-wide, high=wide)
        for b in np.flatnonzero(massive)
        for name, wide in WIDEST.items()
    )


@dataclass(frozen=True)
class Weights:
    """channel [2n]: 1 / size of a residual of each channel (0: not measured); stretch [W]."""

    channel: np.ndarray
    stretch: np.ndarray


@dataclass(frozen=True)
class TreeFit:
    """A model fitted: its vector, starts by group [2n, W] (see `simulate`), weights, loss by
    stretch [W], and how it ended.
    """

    vector: Vector
    starts: tuple[np.ndarray, ...]
    weights: Weights
    loss: np.ndarray
    code: str
    rounds: int

    @property
    def total(self) -> float:
        return float(self.loss.sum())


@dataclass(frozen=True)
class Normal:
    """Normal equations by fold: hess [F, P, P], slope [F, P]; of the shared parameters with starts
    eliminated.
    """

    hess: np.ndarray
    slope: np.ndarray


def body_mass_entries(tree: Tree, body: int) -> tuple[Entry, ...]:
    """Entries of more mass and first moments of a body, within what the machine could carry."""
    inertial, place = np.asarray(tree.inertial), np.asarray(tree.place)
    mass = inertial[:, 0]
    length = max(
        np.linalg.norm(place[1:], axis=1).max(initial=0.0),
        np.linalg.norm(inertial[mass > 0, 1:4] / mass[mass > 0, None], axis=1).max(initial=0.0),
    )
    most = float(mass.sum())
    far = most * float(length)
    make = partial(Entry, BODY_MASS, joints=(body,), start=0.0, off=0.0)
    least = -float(mass[body]) * (1.0 - 1.0 / PRIOR_WIDTH.body_factor)
    spread = PRIOR_WIDTH.inertia
    return make("mass", low=least, high=most, unit="kg", prior=spread * most), *(
        make(p.name, low=-far, high=far, unit="kg m", prior=spread * far)
        for p in catalogue.BODY_MASS.parameters[1:]
    )
