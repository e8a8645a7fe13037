"""What each parameter does to the balance of forces: a column of mean force in the windows, linear
in amplitudes.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import BALANCE
from adaptsim_jax.attribution.equation.balance import (
    GAIN,
    Balance,
    acting,
    actuator_force,
    effect_force,
    force_of,
    read_more,
    read_wrong,
    residual,
    tilting,
)
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.catalogue import ETA, TILTS

VALUE_STEP = 0.02  # share of a value, by which it is moved for a difference
MIN_VALUE_STEP = 1e-4  # SI unit of the value: by which it is moved at least for a difference


class EffectTable:
    """Columns [K, n] of entries of a vector and of candidates, made when asked for. About the
    values of `vector`.
    """

    def __init__(self, problem: TreeProblem, balance: Balance, vector: Vector):
        self.problem, self.balance, self.vector = problem, balance, vector
        self.values = values_of(problem, balance.group, vector)
        self.place = {j: k for k, j in enumerate(balance.group.joints)}
        self.explained: Any = (
            0.0  # of what is missing [K, n], by a set of columns that is fitted already
        )
        if GAIN in self.values.effects:
            own = self.values.effects[GAIN]["gain"][:, 0]
        else:
            own = np.zeros(balance.joints)
        self.scale = np.maximum(1.0 + own, BALANCE.min_scale)
        self._made: dict = {}

    def missing(self) -> np.ndarray:
        """Force that is missing [K, n]."""
        return self._cached(
            "missing", lambda: residual(self.problem, self.balance, self.vector, self._acting())
        )

    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """`actuator_force`."""
        return self._cached("driven", lambda: actuator_force(self.balance, self.values))

    def of(self, entry: Entry, shape: Mapping[str, float] | None = None) -> np.ndarray:
        """Column [K, n] of an entry, at the shapes of a candidate where it is one's."""
        if entry.owner == GAIN:
            return self._gain(entry)
        return self._of(entry, shape) / self.scale

    def _gain(self, entry: Entry) -> np.ndarray:
        """What the motion takes of an actuator, by the model: of what was told the noise would be
        read as a gain.
        """
        averaged = self._cached("told", lambda: self.balance.averaged(self.driven()[0]))
        needed = averaged + self.missing() - self.explained
        return needed / self.scale * np.isin(self.balance.group.joints, entry.joints)

    def _of(self, entry: Entry, shape: Mapping[str, float] | None) -> np.ndarray:
        if entry.owner == INERTIA:
            return self._inertia(self.place[entry.joints[0]], entry.name)
        if entry.owner == TILT:
            way = np.cross(
                np.asarray(self.balance.group.model.tree.gravity),
                np.eye(3)[TILTS.index(entry.name)],
            )
            return tilting(self.balance, self.values.inertial[..., 0], way)
        effect = self.problem.effect(entry.owner)
        if effect.place == "measurement":
            return self._read(effect, entry)
        known = next((p for p in effect.parameters if p.name == entry.name), None)
        curved = known is None or known.off is None or effect.jump or effect.place == "command"
        if curved and shape is None:
            return self._difference(entry) * self.scale
        column = self._everywhere(effect, entry.name, tuple(sorted((shape or {}).items())))
        if effect.pair:
            return self._paired(effect, entry, shape)
        own = np.zeros(column.shape[1])
        own[[self.place[j] for j in entry.joints if j in self.place]] = 1.0
        return column * own

    def stack(
        self, entries: Sequence[Entry], shape: Mapping[str, float] | None = None
    ) -> np.ndarray:
        """[K, n, E]."""
        if not entries:
            return np.zeros((*self.missing().shape, 0))
        return np.stack([self.of(e, shape) for e in entries], -1)

    def _inertia(self, body: int, name: str) -> np.ndarray:
        if "slope" not in self._made:
            eta = np.zeros((self.balance.joints, 10))
            for e, z in zip(self.vector.entries, self.vector.values, strict=True):
                if e.owner == INERTIA and e.joints[0] in self.place:
                    eta[self.place[e.joints[0]], ETA.index(e.name)] = z
            self._made["slope"] = self.balance.group.inertias.at(eta)[1]
        part = self.balance.regressor[:, :, 10 * body : 10 * body + 10]
        return -part @ self._made["slope"][body, :, ETA.index(name)]

    def _read(self, effect: Effect, entry: Entry) -> np.ndarray:
        way = 1.0 * np.isin(self.balance.group.joints, entry.joints)
        of = [share * way for share in read_more(effect, entry.name)]

        def slope():
            return -read_wrong(self.balance, self.values.inertial[..., 0], *of, slope=True)

        return self._cached((effect.name, entry.joints), slope)

    def _at(self, effect: Effect, shape: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Parameters [n] of an effect as they are, those of `shape` laid over its shapes."""
        now = self.values.effects[effect.name]
        out = {k: np.array(z[:, 0], float) for k, z in now.items()}
        for p in effect.shapes:
            if p.name in shape and not self._acts(effect):
                out[p.name][:] = shape[p.name]
        return out

    def _acts(self, effect: Effect) -> bool:
        return any(
            e.owner == effect.name and e.joints[0] in self.place for e in self.vector.entries
        )

    def _everywhere(self, effect: Effect, name: str, shape: tuple) -> np.ndarray:
        """Change of the mean force [K, n] per unit of a parameter at every joint."""
        key = (effect.name, name, shape)
        if key not in self._made:
            given = dict(shape)
            here = self._at(effect, given)
            size = self._size(effect, name, here, given)
            away = here | {name: here[name] + size}

            def act(p):
                return force_of(self.balance, self.values, effect, p, self.driven())

            self._made[key] = (act(away) - act(here)) / size
        return self._made[key]

    def _size(
        self, effect: Effect, name: str, here: Mapping[str, np.ndarray], given: Mapping[str, float]
    ) -> Any:
        """By which a parameter is moved for a column; of friction that gives over a band, as far as
        it may be off.
        """
        if effect.jump or effect.place == "command":
            return given.get(name, 0.01)
        if not np.any(self.balance.group.model.tree.rub):
            return 1.0
        torque = self.problem.reach.torque[list(self.balance.group.joints)]
        own = self.balance.inertia * np.sqrt(
            np.mean(np.square(self.balance.acceleration), 0)
        )  # of a joint that nothing drives
        return np.maximum(
            0.5 * np.abs(here[name]),
            BALANCE.friction_off * np.where(torque > 0.0, torque, own + MIN_VALUE_STEP),
        )

    def _paired(self, effect: Effect, entry: Entry, shape) -> np.ndarray:
        here = self._at(effect, shape or {})
        own = np.zeros(self.balance.joints)
        own[[self.place[j] for j in entry.joints]] = 1.0

        def act(p):
            return effect_force(self.balance, self.values, effect, p, self.driven())

        return act(here | {entry.name: here[entry.name] + own}) - act(here)

    def _difference(self, entry: Entry) -> np.ndarray:
        """Of an entry of the vector that does not act linearly."""
        at = self.vector.index()[entry.key]
        value = self.vector.values[at]
        size = max(VALUE_STEP * abs(value), MIN_VALUE_STEP)
        size = -size if value + size > entry.high else size
        effect = self.problem.effect(entry.owner)
        if effect.scales_torque or effect.place == "measurement":
            moved = self.vector.values.copy()
            moved[at] += size
            there = residual(self.problem, self.balance, self.vector.at(moved))
            return (self.missing() - there) / size
        here = {k: z[:, 0] for k, z in self.values.effects[effect.name].items()}
        own = np.isin(self.balance.group.joints, entry.joints)

        def act(p):
            return force_of(self.balance, self.values, effect, p, self.driven())

        now, share = self._cached((effect.name, "now"), lambda: act(here)), self._acting()[1]
        return (act(here | {entry.name: here[entry.name] + size * own}) - now) / size / share

    def _acting(self) -> tuple[np.ndarray, np.ndarray]:
        return self._cached("acting", lambda: acting(self.balance, self.values))

    def _cached(self, key: Hashable, make: Callable[[], Any]) -> Any:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]
