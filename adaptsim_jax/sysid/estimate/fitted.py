"""A fitted model with what it leaves unexplained, and how two of them are compared."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import count

import numpy as np

from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import Candidate
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.problem import Active
from adaptsim_jax.sysid.estimate.variance import Kernels, Linearised, VarianceComponents

Instance = tuple[str, str]  # (effect, where)
_numbers = count()


class Code(Enum):
    """How a fit ended, in words."""

    SETTLED = "its likelihood settled"
    UNSETTLED = "its rounds ran out before its likelihood settled"
    JUDGED = "judged where it was, nothing refitted"
    RAN_AWAY = "the model runs away, or leaves residuals that no covariance describes"


class Incomparable(ValueError):
    """Likelihoods of fits that were judged under different responses to force."""


@dataclass(frozen=True)
class Response:
    """How outputs answer to forces, and what unexplained forces do to residuals; rivals share it. number: of this response, by which
    fits say under which of them they were judged."""

    lin: Linearised
    kernels: Kernels
    number: int = field(default_factory=_numbers.__next__)


def respond(lin: Linearised) -> Response:
    """The response of one linearisation."""
    return Response(lin, variance.force_kernels(lin))


@dataclass(frozen=True)
class Start:
    """Where a fit begins: effects, theta `[P]`, eff `[E]`, initial states x0 `[W, S]` (None: those in the data), and the residual
    covariance `parts` to begin with. ended: the least-squares fit that ended there, where there is one."""

    active: Active
    theta: np.ndarray
    eff: np.ndarray
    x0: np.ndarray | None
    parts: VarianceComponents
    ended: FitResult | None = None

    @classmethod
    def after(cls, ended: FitResult, active: Active, parts: VarianceComponents) -> "Start":
        """Where a least-squares fit of those effects ended."""
        return cls(active, ended.theta, ended.eff, ended.x0, parts, ended)


@dataclass(frozen=True)
class Fit:
    """A candidate model with its own residual covariance and its likelihood window by window `[W]`, and how its fit ended. One that
    ran away has a likelihood of nothing, an infinite force and no parameters."""

    candidate: Candidate
    parts: VarianceComponents
    likelihood: np.ndarray
    weight: np.ndarray  # [n, taus] how far forces of each kind move the outputs (`Kernels.weight`)
    amiss: tuple[tuple[Instance, str], ...] = ()  # effects whose fitted values are not theirs, and why (`Effect.amiss`)
    response: int = -1  # number of the response that it was judged under
    code: Code = Code.JUDGED

    @property
    def ok(self) -> bool:
        return self.code is not Code.RAN_AWAY

    @property
    def moving(self) -> np.ndarray:
        """Variance of the unexplained force per joint `[n]` (N m)^2, each part weighed by how far it moves the outputs."""
        return (self.parts.force * self.weight).sum(1)

    @property
    def active(self) -> Active:
        return self.candidate.active

    @property
    def total(self) -> float:
        return float(self.likelihood.sum())

    @property
    def size(self) -> int:
        """How many numbers it took from the data, phases of trials included."""
        return len(self.candidate.names) + self.candidate.phases

    def merit(self, price: float) -> float:
        """Log-likelihood less the price of its parameters."""
        return self.total - price * self.size

    def start(self, **changed) -> Start:
        """A start from where it stands, with these fields of `Start` changed."""
        c = self.candidate
        return replace(Start(c.active, c.theta, c.eff, c.refit.point.x0, self.parts), **changed)

    def at_bound(self) -> tuple[str, ...]:
        """Effect parameters that ended at the edge of what they may be. Some shapes have natural ends: Dahl's bristle has no
        damping, a lossless stop no loss, and before a recording there was no torque, or the first one."""
        c = self.candidate
        stuck = zip(c.names, c.refit.point.z, c.refit.at_bound, strict=True)
        return tuple(
            n
            for n, z, at in stuck
            if at and "/" in n and not n.endswith("/before") and not (z == 0.0 and n.endswith(("/damping", "/loss")))
        )


def gain(new: Fit, old: Fit, price: float = 0.0) -> float:
    """Log-likelihood of one fit over another, less the price of the parameters that it has more.

    Raises `Incomparable` where they were judged under different responses to force: those are different measures (forces on a joint
    that sticks do nothing), which `fit.seen_anew` makes one.
    """
    if new.response != old.response:
        raise Incomparable(
            f"the fits of {new.active} and {old.active} were judged under different responses; see one anew"
        )
    return rough_gain(new, old) if price == 0.0 else new.merit(price) - old.merit(price)


def rough_gain(new: Fit, old: Fit) -> float:
    """The same where either may have been judged about another model: good for what is clear by far, and for what cannot be had
    under one response (models of different geometries)."""
    return new.total - old.total


def likeliest(fits: Iterable[Fit], price: float = 0.0) -> Fit | None:
    """The fit of most merit, the first of equals; None of none. Raises `Incomparable` as `gain` does."""
    fits = list(fits)
    for one in fits:
        gain(one, fits[0])
    return max(fits, key=lambda one: one.merit(price), default=None)


def doubtful(model: Fit, base: Fit) -> set[Instance]:
    """Effects that `base` lacks whose amplitude has the wrong sign or is beyond what the effect may be, or whose values make
    them another effect."""
    bounded = {(effect, where) for effect, where, _ in (n.split("/") for n in model.at_bound())}
    return (bounded | {instance for instance, _ in model.amiss}) - set(base.active)


def plausible(model: Fit, base: Fit) -> bool:
    """No effect is doubtful; what the base model has is not judged."""
    return not doubtful(model, base)


def force_ratio(new: Fit, old: Fit) -> float:
    """Unexplained force after over before, over all joints, weighed by what it does to the motion."""
    return float(np.sqrt(new.moving.sum() / max(old.moving.sum(), 1e-300)))
