"""Names of scoops as the engine bears them out: an objective of the search.

Its models are fitted by emulators and compared by the engine.

What does not hold out is dropped. The best in a place is named; others that predict left-out scoops
as well are its class.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Step
from adaptsim_jax.diagnosis.fit import Fit
from adaptsim_jax.diagnosis.models import Model, added, beats, finished, paired, without
from adaptsim_jax.diagnosis.objective import FittedCandidate, Objective
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.rules import Evidence, step_reason
from adaptsim_jax.diagnosis.testing import Test
from adaptsim_jax.diagnosis.trials import does_as_well, likely, steadiness
from adaptsim_jax.effects.base import Effect

REPLACED = 3  # effects at most that others take the place of


@dataclass(frozen=True)
class EngineModel:
    """Effects as the engine judges them.

    model: with left-out errors by the engine; emulated: the same effects by the emulator of the
    search; begun: values [P] from which these are to be fitted, of a rival that has none.
    """

    model: Model
    emulated: Any
    begun: np.ndarray

    @property
    def added(self) -> tuple[Effect, ...]:
        return self.model.added

    @property
    def fit(self) -> Fit:
        return self.model.fit


@dataclass(frozen=True)
class BornOut(Evidence):
    """Evidence of scoops that are left out, simulated by the engine."""

    model: EngineModel
    less: EngineModel
    candidate: Effect
    criteria: Criteria
    test: Test
    steadiness: float
    units = "scoops by the engine"

    @property
    def min_steadiness(self) -> float:
        return 0.0

    @property
    def at_bound(self) -> bool:
        return False

    @property
    def level(self) -> float:
        return self.criteria.confidence

    @property
    def price(self) -> float:
        return self.criteria.size


@dataclass(frozen=True)
class EngineObjective(Objective):
    """Effects that the emulator named; nothing is added.

    engine: the model of effects from values [P], with its left-out errors by the engine; null: the
    declared model by it.
    """

    problem: Problem
    criteria: Criteria
    engine: Callable[[Sequence[Effect], np.ndarray], Model]
    null: Model
    _rivals: dict = field(default_factory=dict)
    _replaced: list = field(default_factory=list)

    def model(self, emulated: Model) -> EngineModel:
        """An emulated model as the engine judges it."""
        if not emulated.added:
            return EngineModel(self.null, emulated, emulated.fit.values)
        by_engine = self.engine(emulated.added, emulated.fit.values)
        return EngineModel(by_engine, emulated, emulated.fit.values)

    def evidence(self, model: EngineModel, candidates: Sequence[Effect]) -> list[Evidence]:
        rows: list[Evidence] = []
        for c in candidates:
            less = self.model(without(self.problem, model.emulated, c, self.criteria.rounds))
            test = paired(less.fit.held, model.fit.held)
            steady = steadiness(self.problem, model.model, c)
            rows.append(BornOut(model, less, c, self.criteria, test, steady))
        return rows

    def in_place_of(self, e: BornOut) -> list[FittedCandidate]:
        """Fitted once: for what is better, and for what does as well."""
        if id(e) not in self._rivals:
            self._rivals[id(e)] = e, list(self._instead(e))
        return self._rivals[id(e)][1]

    def _instead(self, e: BornOut):
        """Those of which a few steps of the emulator leave least."""
        problem, rough, tries = self.problem, e.less.emulated, []
        for s in likely(problem, e.model.emulated, rough, e.candidate):
            values, loss = added(problem, rough, s, 2 * self.criteria.glance)
            tries.append((loss, values, s.candidate))
        for _, values, c in sorted(tries, key=lambda t: t[0])[: self.criteria.tried]:
            by_engine = self.engine((*rough.added, c), values)
            test = paired(by_engine.fit.held, e.model.fit.held)
            passed = does_as_well(test, self.criteria)
            yield FittedCandidate(c, EngineModel(by_engine, None, values), test, passed)

    def simpler(
        self, model: EngineModel, rows: Sequence[BornOut]
    ) -> tuple[EngineModel, Sequence[Step]]:
        """With an effect that does better in the place of another: an emulator flatters what it was
        drawn around.
        """
        if len(self._replaced) == REPLACED:
            return model, ()
        for e in rows:
            best = None
            for one in self.in_place_of(e):
                known = best.model if best else model
                if beats(self.problem, one.model.model, known.model, self.criteria):
                    best = one
            if best is None:
                continue
            self._replaced.append(e.candidate)
            effects = (*e.less.added, best.candidate)
            rounds = self.criteria.rounds
            emulated = finished(self.problem, effects, best.model.begun, rounds)
            reason = step_reason("better_in_its_place", best.test.gain, one=best.candidate.name)
            step = Step("replaced", e.candidate, best.test, reason)
            return EngineModel(best.model.model, emulated, best.model.begun), [step]
        return model, ()
