"""The balance of torques along the measured motion as an objective of the search for effects.

Everything is linear but for a few shapes, which lie on grids. So no set of effects is a minimum to
be stuck in, and thousands of sets are judged in seconds.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, adjacent
from adaptsim_jax.attribution.equation.balance import rms
from adaptsim_jax.attribution.equation.searched import Searched, needed, ranked, worth_apart
from adaptsim_jax.attribution.equation.solve import Solved, compared
from adaptsim_jax.attribution.parameters import BODY_MASS, INERTIA, Vector
from adaptsim_jax.diagnosis.criteria import LOOK_ALIKE, Criteria
from adaptsim_jax.diagnosis.finding import Step
from adaptsim_jax.diagnosis.objective import FittedCandidate, Objective, Round
from adaptsim_jax.diagnosis.rules import Evidence, Reason, refusal, step_reason
from adaptsim_jax.diagnosis.testing import Test, false_discovery, preferred
from adaptsim_jax.effects.base import Traits
from adaptsim_jax.effects.joints.catalogue import BODY_MASS as MASS


@dataclass(frozen=True)
class BalanceEvidence(Evidence):
    """Evidence of the torque along the motion: a set of effects `whole`, with a candidate in it.

    less, model: without it and with it (`BalanceModel`); alike: joints at which what like drives
    have is in the set; naming: whether it is asked about a name, and no more about its place in the
    set.
    """

    state: Searched
    whole: Solved
    candidate: JointCandidate
    test: Test
    price: float
    level: float
    less: Any = None
    model: Any = None
    alike: int = 0
    naming: bool = False
    apart: float | None = None
    units = "blocks"
    loss = "squared missing torque"

    @property
    def criteria(self) -> Criteria:
        return self.state.criteria

    @property
    def traits(self) -> Traits:
        return self.state.problem.effect(self.candidate.effect).traits

    @property
    def gain(self) -> float:
        return self.test.gain * self.state.carry(self.candidate)

    @property
    def steadiness(self) -> float:
        return steadiness(self.whole, self.candidate)

    @property
    def min_steadiness(self) -> float:
        return self.state.limits.steady

    @property
    def at_bound(self) -> bool:
        return at_bound(_known(self.whole), self.candidate, self.state.criteria.bound)

    @property
    def read_so(self) -> bool:
        """Whether it is a shift that may be how rows are read."""
        return read_so(self.state, self.whole, self.candidate)

    @property
    def stays_unnamed(self) -> bool:
        """What like drives have together, and takes something off here too, is fitted everywhere
        and named where it holds out alone.
        """
        return self.alike > 1 and self.test.gain > 0.0

    @property
    def values(self) -> np.ndarray:
        return self.whole.step[_numbers(self.whole, self.candidate)]

    @property
    def unresolved_shift(self) -> float | None:
        """Of a single joint, or of some; that of all of them is fitted and not named."""
        if self.candidate.sharing == "common" or not self.state.commanded or not self.read_so:
            return None
        return float(self.values[0]) / self.state.reach.dt

    @property
    def torque_share(self) -> tuple[float, float] | None:
        """Root mean squares. What predicts stays in the model, and has no name."""
        if self.read_so or not self.naming:
            return None
        return share_of_torque(self.state, self.whole, self.candidate)


def share_of_torque(state: Searched, whole: Solved, c: JointCandidate) -> tuple[float, float]:
    """Root mean square of an effect's torque over that of the joint at which it is most, and the
    least of that by which it has a name.
    """
    at = _numbers(whole, c)
    force = whole.columns[..., at] @ whole.step[at]
    return float(np.max(rms(force) / np.maximum(state.torque, 1e-300))), state.limits.worth


def read_so(state: Searched, whole: Solved, c: JointCandidate) -> bool:
    """Whether it is a shift of all commands by less than a row, or of measured torques by as much
    as loggers pair them with angles: how rows are read, and no effect. A delay and a lag of the
    same joints are one filter: their sum counts.
    """
    if not _shifts(state, c.effect):
        return False
    value = sum(
        z
        for e, z in zip(whole.entries, whole.step, strict=True)
        if set(e.joints) == set(c.joints) and _shifts(state, e.owner)
    )
    value = float(value) / state.reach.dt
    if not state.commanded:
        return abs(value) < state.limits.paired
    return -state.criteria.within_row < value < state.criteria.min_shift


def _shifts(state: Searched, effect: str) -> bool:
    problem = state.problem
    return problem.offers(effect) and problem.effect(effect).shifts_commands


def _numbers(whole: Solved, c: JointCandidate) -> list[int]:
    keys = {e.key for e in c.entries}
    return [i for i, e in enumerate(whole.entries) if e.key in keys]


def _known(whole: Solved) -> dict[tuple, float]:
    """Values by the keys of entries."""
    return {e.key: e.start + z for e, z in zip(whole.entries, whole.step, strict=True)}


def steadiness(whole: Solved, c: JointCandidate) -> float:
    """Its amplitudes over their standard errors, root mean square: a torque of two numbers has
    twice the chance that one is large.
    """
    at = _numbers(whole, c)
    return float(rms(whole.step[at] / np.maximum(whole.error[at], 1e-300)))


def at_bound(known: Mapping[tuple, float], c: JointCandidate, share: float) -> bool:
    """Whether an amplitude is at an end of its range. known: values by the keys of entries."""
    return any(e.at_bound(known[e.key], share) for e in c.entries)


LIKE_A_BODY = MASS.look_alikes


@dataclass(frozen=True)
class BalanceModel:
    """Effects in the balance of a group.

    whole: all entries, fitted; asked: of each effect at how many driven joints it was looked for;
    final, errors: the vector with shapes fitted too and its standard errors [P], of the last model.
    """

    added: tuple[JointCandidate, ...]
    whole: Solved = field(repr=False)
    asked: Mapping[str, int] = field(default_factory=dict)
    final: Vector | None = None
    errors: np.ndarray | None = None


@dataclass(frozen=True)
class BalanceObjective(Objective):
    """The balance of a group. every: candidates of which it can tell."""

    state: Searched
    every: Sequence[JointCandidate]

    @property
    def most_effects(self) -> int:
        """A few for each joint: friction and a rotor are in all of them."""
        return 3 * self.state.balance.joints + self.state.criteria.most_effects

    def model(
        self, added: Sequence[JointCandidate], asked: Mapping[str, int] | None = None
    ) -> BalanceModel:
        """A set of effects, fitted."""
        return BalanceModel(tuple(added), self.state.set_of(added), asked or {})

    def declared(self) -> BalanceModel:
        return self.model(())

    def scores(self, model: BalanceModel) -> Sequence[object]:
        """None: what is ranked first is compared on what was left out at once."""
        return ()

    def begun(self, null: BalanceModel) -> tuple[BalanceModel, Sequence[Step]]:
        """With what all joints are likely to have (`likely_first`)."""
        added, steps = likely_first(self.state, self.every)
        return self.model(added), steps

    def rounds(self, base: BalanceModel) -> Iterator[Round]:
        """Laws first, then what only describes. Beside a shift of commands that is no way of
        reading rows none other of the same joints is tried: both are one filter.
        """
        state, added = self.state, base.added

        def shifts(c):
            return state.problem.effect(c.effect).shifts_commands

        shifted = [c for c in added if shifts(c) and not read_so(state, base.whole, c)]
        late = {j for c in shifted for j in c.joints}
        free = [c for c in self.open_candidates(added) if not shifts(c) or not late & set(c.joints)]
        for laws in (True, False):
            some = [c for c in free if state.problem.effect(c.effect).describes is not laws]
            yield Round(self._attempts(base, some))

    def _attempts(
        self, base: BalanceModel, some: Sequence[JointCandidate]
    ) -> Iterator[FittedCandidate]:
        state = self.state
        for c in ranked(state, base.whole, some)[: state.limits.tried]:
            c = state.settled(base.added, c)
            model = self.model([*base.added, c])
            test = compared(state.rows, base.whole, model.whole, state.own(c))
            price, level = self.price(c), state.limits.level
            reason = refusal(BalanceEvidence(state, model.whole, c, test, price, level))
            yield FittedCandidate(c, model, test, reason is None, reason)

    def price(self, c: JointCandidate) -> float:
        """The least share that an effect must take off, of a law for each of its numbers."""
        if self.state.problem.effect(c.effect).describes:
            return self.state.criteria.described
        return self.state.limits.gain * len(c.entries)

    def better(self, one: FittedCandidate, other: FittedCandidate) -> bool:
        """By what each takes off all joints at which it shows, for the numbers that it has."""

        def value(attempt):
            c = attempt.candidate
            gain = attempt.test.gain * self.state.carry(c)
            return gain - self.state.limits.gain * len(c.entries)

        return value(one) > value(other)

    def members(self, model: BalanceModel) -> tuple[BalanceModel, Sequence[Step]]:
        """Each joint's as an effect of its own."""
        state, parts = self.state, [k for c in model.added for k in c.split()]
        driven = {j for j, k in state.local.items() if np.any(state.averaged[:, k])}
        asked = Counter(k.effect for k in parts if driven & set(k.joints))
        return self.model(parts, asked), ()

    def evidence(self, model: BalanceModel, candidates: Sequence[JointCandidate]) -> list[Evidence]:
        """Of what like drives have, levels are those of a false discovery rate."""
        state, limits, tests = self.state, self.state.limits, []
        for c in candidates:
            less = self.model([k for k in model.added if k is not c], model.asked)
            tests.append((c, less, compared(state.rows, less.whole, model.whole, state.own(c))))
        rows: list[Evidence] = []
        for c, less, test in tests:
            level, alike = limits.level, 0
            if state.likely(c):
                p = [t.p for k, _, t in tests if k.effect == c.effect]
                alike = len(p)
                asked = max(1, model.asked.get(c.effect, 0))
                level = max(level, false_discovery(p, limits.discovery, asked))
            shapes = [k for k in self.every if k.key == c.key] or [c]
            apart = worth_apart(state, less.whole, shapes)[0][0]
            e = BalanceEvidence(state, model.whole, c, test, self.price(c), level, less, model)
            rows.append(replace(e, alike=alike, apart=apart))
        return rows

    def simpler(
        self, model: BalanceModel, rows: Sequence[BalanceEvidence]
    ) -> tuple[BalanceModel, Sequence[Step]]:
        """One effect in the place of two; then without those that only made up for a shape on a
        grid, with the shapes of all others fitted.
        """
        found = self.one_for_two(model) or self.body_first(rows)
        if found is not None:
            return found
        asked = [e.candidate for e in rows if not (e.stays_unnamed and refusal(e))]
        stay, final, errors = needed(self.state, model.added, asked)
        gone = [c for c in model.added if c not in stay]
        reason = step_reason("shape_artefact")
        if not gone:
            gone = [c for c in asked if at_bound(final.known(), c, self.state.criteria.bound)]
            stay = [c for c in stay if c not in gone]
            reason = step_reason("ends_at_bound")
        if not gone:
            return replace(model, final=final, errors=errors), ()
        return self.model(stay, model.asked), [Step("dropped", c, None, reason) for c in gone]

    def one_for_two(self, model: BalanceModel) -> tuple[BalanceModel, Sequence[Step]] | None:
        """The set with one effect in the place of two of a joint, which forward steps took for it.

        None where none does as well, or one of the two does by itself: a trifle beside it does not
        make it another.
        """
        state, whole = self.state, model.whole
        for pair in combinations(model.added, 2):
            one, other = pair
            if not set(one.joints) & set(other.joints):
                continue
            less = self.model([k for k in model.added if k is not one and k is not other])
            alone = [self._test(self.model([*less.added, k]).whole, whole, pair) for k in pair]
            if min(t.gain for t in alone) < self._gap(pair, less.whole, whole):
                continue
            for k, more, _, passed in (a[:4] for a in self.instead(pair, less, whole)):
                test = self._test(less.whole, more.whole, (k,))
                price = state.limits.gain * len(k.entries)
                evidence = BalanceEvidence(state, more.whole, k, test, price, state.limits.level)
                if passed and not refusal(evidence):
                    reason = step_reason("one_for_two", one=one.effect, other=other.effect)
                    new = self.model([*less.added, *k.split()], model.asked)
                    return new, [Step("replaced", k, test, reason)]
        return None

    def body_first(
        self, rows: Sequence[BalanceEvidence]
    ) -> tuple[BalanceModel, Sequence[Step]] | None:
        """The set with a body of another mass in the place of what such a body looks like. None
        where none does as well.
        """
        for e in (e for e in rows if e.candidate.effect in LIKE_A_BODY):
            for one in (a for a in self.in_place_of(e) if a.candidate.effect == BODY_MASS):
                if one.passed and one.test.gain < self.state.criteria.gap:
                    reason = step_reason("body_first", one=e.candidate.effect)
                    return one.model, [Step("replaced", one.candidate, one.test, reason)]
        return None

    def in_place_of(self, e: BalanceEvidence) -> Iterator[FittedCandidate]:
        return self.instead((e.candidate,), e.less, e.whole)

    def instead(
        self, gone: Sequence[JointCandidate], less: BalanceModel, whole: Solved
    ) -> Iterator[FittedCandidate]:
        """Single effects beside those of `less` in the place of what is gone: others at its joints,
        the same at joints beside. whole: with what is gone.
        """
        state = self.state
        names, joints = {c.effect for c in gone}, {j for c in gone for j in c.joints}
        alike = names & {BODY_MASS, *LIKE_A_BODY}
        near = [
            k
            for k in self.open_candidates(less.added)
            if any(adjacent(state.problem, k, c) or k.effect == c.effect == INERTIA for c in gone)
            or (k.effect == BODY_MASS and alike)
        ]
        shows = set(state.own(*gone))
        others = [
            k
            for k in near
            if (not joints & set(k.joints) if k.effect in names else shows & set(state.own(k)))
        ]
        others = [k for k in others if not state.problem.effect(k.effect).describes]
        gap = self._gap(gone, less.whole, whole)
        for k in ranked(state, less.whole, others)[: LOOK_ALIKE.fitted]:
            k = state.settled(less.added, k)
            other = self.model([*less.added, k], less.asked)
            test = self._test(other.whole, whole, (*gone, k))
            passed = test.gain < gap and not at_bound(_known(other.whole), k, state.criteria.bound)
            yield FittedCandidate(k, other, test, passed)

    def open_candidates(self, added: Sequence[JointCandidate]) -> list[JointCandidate]:
        """Candidates that are not in a set, at none of their joints."""
        taken = {(c.effect, j) for c in added for j in c.joints}
        return [c for c in self.every if not any((c.effect, j) in taken for j in c.joints)]

    def _test(self, less: Solved, whole: Solved, some: Sequence[JointCandidate]) -> Test:
        """Of two sets at the joints where some effects show."""
        return compared(self.state.rows, less, whole, self.state.own(*some))

    def _gap(self, gone: Sequence[JointCandidate], less: Solved, whole: Solved) -> float:
        """Share of the loss by which what stands in the place of `gone` may be worse and still do
        as well.
        """
        gain = self._test(less, whole, gone).gain
        return max(self.state.criteria.gap, 1.0 - (1.0 - gain) ** self.state.criteria.alike)

    def unnamed(self, e: BalanceEvidence) -> Reason | None:
        """How rows are read; what like joints have and could not be shown by itself; a trifle."""
        if e.read_so:
            return step_reason("as_logged")
        if refusal(e):
            return step_reason("of_like_joints")
        return refusal(replace(e, naming=True))

    def closed(
        self, null: BalanceModel, model: BalanceModel, rows: Sequence[Evidence]
    ) -> tuple[BalanceModel, BalanceModel]:
        """The declared model by the weights that the search came to."""
        return self.model(()), model


def likely_first(
    state: Searched, every: Sequence[JointCandidate]
) -> tuple[list[JointCandidate], list[Step]]:
    """What all joints are likely to have, each kind at all of them as one candidate.

    Joint by joint it is judged in the end, since one hides another: a file's damping and rotors
    that are not there hide dry friction that is.
    """
    added: list[JointCandidate] = []
    steps: list[Step] = []
    first = [e for e in state.problem.effects if e.traits.tried_first]
    for effect in sorted(first, key=lambda e: e.traits.tried_first):
        sharing = "common" if effect.traits.shared else "joint"
        some = [c for c in every if c.effect == effect.name and c.sharing == sharing]
        if (
            effect.shifts_commands
        ):  # of all commands, where there are any, else it looks like rotors
            some = ranked(state, state.set_of(added), some)[:1] if state.commanded else []
        if not some:
            continue
        less, more = state.set_of(added), state.set_of([*added, *some])
        joints = sorted({k for c in some for k in state.own(c)})
        test = compared(state.rows, less, more, joints)
        if preferred(test, state.limits.gain, state.limits.level):
            added = [*added, *some]
            state.weigh(state.set_of(added))
            steps += [Step("added", c, test, step_reason("likely_first")) for c in some]
    return added, steps
