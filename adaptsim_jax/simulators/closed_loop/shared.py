"""Numbers that the servos of a machine share (a delay, a filter, a payload, gravity fed forward,
like rotors), each joint's own numbers eliminated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import (
    LawFit,
    fit_from_grid,
    fit_law,
    gains,
    held_out_pieces,
    linearise,
    paired_t,
    pull_loss,
    score,
    solve,
    sum_squares,
    weights,
)
from adaptsim_jax.simulators.closed_loop.imposed import JointProblem
from adaptsim_jax.simulators.closed_loop.law import clip_law, step_law
from adaptsim_jax.simulators.closed_loop.stepping import errors, squared

DELAY_NAMES = ("delay", "lag")
DAMPING = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0)
INFORMATIVE = 3  # joints from which a common delay begins: those that move most over their noise


@dataclass(frozen=True)
class Attempt:
    """A number that all joints share, fitted: fits by joint, the share that it takes off what was
    left out (log, all joints together), the worst joint's, and the p of its test.
    """

    name: str
    fits: tuple[LawFit, ...]
    gain: float
    worst: float
    p: float

    @property
    def passes(self) -> bool:
        """Whether left-out pieces bear it out, and no joint is harmed."""
        is_harmless = self.worst > -CLOSED_LOOP.harm
        is_enough = self.gain > CLOSED_LOOP.shared_gain
        return bool(is_enough and is_harmless and self.p < CLOSED_LOOP.level)


def make_attempt(
    problems: Sequence[JointProblem], before: Sequence[LawFit], name: str, fits: Sequence[LawFit]
) -> Attempt:
    """How fits with a shared number do against those without, on pieces that were left out."""

    def gain_of_joint(row):
        problem, old, new = row
        return gains(
            problem, held_out_pieces(problem, old).sums, held_out_pieces(problem, new).sums
        )

    gains_by_joint = np.array(
        parallel_map(gain_of_joint, list(zip(problems, before, fits, strict=True)))
    )
    total = gains_by_joint.sum(0)
    return Attempt(
        name, tuple(fits), float(total.mean()), float(gains_by_joint.mean(1).min()), paired_t(total)
    )


def with_value(problem: JointProblem, fit: LawFit, name: str, value: float) -> LawFit:
    """The fit with another value of a shared number."""
    law = fit.law._replace(**{name: value})
    return fit.of(clip_law(problem.servo, problem.scales, law, (name,)))


def fit_shared(
    problems: Sequence[JointProblem],
    fits: Sequence[LawFit],
    name: str,
    value: float,
    rounds: int = 8,
) -> tuple[LawFit, ...]:
    """Gauss and Newton's fit of one number that all joints share, and of their own."""
    fits = tuple(with_value(p, f, name, value) for p, f in zip(problems, fits, strict=True))
    weights_of_joints: list[np.ndarray] | None = None
    for _ in range(rounds):
        if weights_of_joints is None:
            weights_of_joints = [
                weights(p, sum_squares(p, f.law)) for p, f in zip(problems, fits, strict=True)
            ]
        rows = list(zip(problems, fits, weights_of_joints, strict=True))
        equations = parallel_map(lambda row: _normal(*row, name), rows)
        before = sum(z[2] for z in equations)
        tries = [_schur_step(equations, damping) for damping in DAMPING]

        def laws_of_joint(at, tries=tries, fits=fits, name=name):
            problem, fit = problems[at], fits[at]
            unit = problem.scales.unit(name)
            out = []
            for steps, shift in tries:
                joint_law = step_law(problem.servo, problem.scales, fit.law, fit.free, steps[at])
                law = joint_law._replace(**{name: getattr(fit.law, name) + shift * unit})
                out.append(clip_law(problem.servo, problem.scales, law, (*fit.free, name)))
            return out

        laws = [laws_of_joint(at) for at in range(len(problems))]

        def loss(row):
            problem, fit, weight, joint_laws = row
            sums = squared(errors(problem, joint_laws)) @ weight
            return sums + [pull_loss(problem, fit.of(z)) for z in joint_laws]

        rows = list(zip(problems, fits, weights_of_joints, laws, strict=True))
        losses = np.sum(parallel_map(loss, rows), 0)
        best = int(np.argmin(losses))
        if not losses[best] < before:
            break
        fits = tuple(f.of(joint_laws[best]) for f, joint_laws in zip(fits, laws, strict=True))
        if losses[best] > before * (1.0 - 1e-3):
            break
    return fits


def _normal(problem: JointProblem, fit: LawFit, weight: np.ndarray, name: str):
    """Normal equations with the shared number last, and the loss."""
    lin = linearise(problem, LawFit(fit.law, (*fit.free, name)), weight)
    hess, slope = lin.normal()
    return hess, slope, float(weight @ squared(lin.error)) + pull_loss(problem, fit)


def _schur_step(equations: Sequence[tuple], damping: float) -> tuple[list[np.ndarray], float]:
    """(steps by joint, step of the shared number): Schur's complement of all joints."""
    numerator, denominator, parts = 0.0, 0.0, []
    for hess, slope, _ in equations:
        hess = hess + damping * np.diag(np.diag(hess))
        k = len(slope) - 1
        x = solve(hess[:k, :k], np.column_stack([slope[:k], hess[:k, k:]]))
        numerator += slope[k] - hess[k, :k] @ x[:, 0]
        denominator += hess[k, k] - hess[k, :k] @ x[:, 1]
        parts.append(x)
    shift = float(np.clip(-numerator / max(denominator, 1e-300), -3.0, 3.0))
    return [np.clip(-x[:, 0] - shift * x[:, 1], -1.0, 1.0) for x in parts], shift


def late_targets(
    problems: Sequence[JointProblem], fits: Sequence[LawFit]
) -> tuple[tuple[LawFit, ...], list[Attempt]]:
    """Fits with one delay or one filter of all targets, begun anew; as they were where left-out
    pieces bear out neither.
    """
    information = [
        score(p, sum_squares(p, f.law)) - np.log(p.noise**2)
        for p, f in zip(problems, fits, strict=True)
    ]
    chosen = np.argsort(information)[::-1][:INFORMATIVE]
    tried: list[Attempt] = []
    for name in DELAY_NAMES:
        if not all(p.servo.allowed(name) for p in problems):
            continue
        fits_with_delay = parallel_map(
            lambda j, name=name: fit_from_grid(problems[j], fits[j].law, name), chosen
        )
        gain_by_joint = [
            score(problems[j], sum_squares(problems[j], fits[j].law))
            - score(problems[j], sum_squares(problems[j], f.law))
            for j, f in zip(chosen, fits_with_delay, strict=True)
        ]
        value = _weighted_median([getattr(f.law, name) for f in fits_with_delay], gain_by_joint)
        if value < CLOSED_LOOP.late:
            continue
        starts = [with_value(p, f, name, value) for p, f in zip(problems, fits, strict=True)]
        for j, f in zip(chosen, fits_with_delay, strict=True):
            starts[j] = with_value(problems[j], LawFit(f.law, fits[j].free), name, value)
        rows = list(zip(problems, starts, strict=True))
        starts = parallel_map(lambda row: fit_law(*row, rounds=6), rows)
        new = fit_shared(problems, starts, name, value)
        tried.append(make_attempt(problems, fits, name, new))
    passed = [a for a in tried if a.passes]
    if not passed:
        return tuple(fits), tried
    return max(passed, key=lambda a: a.gain).fits, tried


def _weighted_median(values: Sequence[float], weight: Sequence[float]) -> float:
    order = np.argsort(values)
    w = np.maximum(np.asarray(weight), 0.0)[order] + 1e-9
    return float(np.asarray(values)[order][np.searchsorted(np.cumsum(w), 0.5 * w.sum())])


def likely_shared(
    problems: Sequence[JointProblem], fits: Sequence[LawFit], names: Sequence[str]
) -> list[tuple[str, float]]:
    """Return the likeliest three of shared numbers, each with its step, by one step of all
    joints.
    """

    def joint_terms(row):
        problem, fit = row
        own = tuple(n for n in fit.free if n not in names)
        lin = linearise(problem, LawFit(fit.law, (*own, *names)))
        hess, slope = lin.normal()
        k, unit = len(own), np.array([problem.scales.unit(n) for n in names])
        x = solve(hess[:k, :k], np.column_stack([slope[:k], hess[:k, k:]]))
        numerator = (slope[k:] - hess[k:, :k] @ x[:, 0]) / unit
        denominator = np.diag(hess)[k:] - np.einsum("ki,ik->k", hess[k:, :k], x[:, 1:])
        return numerator, denominator / unit**2, float(lin.weight @ squared(lin.error))

    rows = parallel_map(joint_terms, list(zip(problems, fits, strict=True)))
    numerator, denominator, total = (sum(z[i] for z in rows) for i in range(3))
    denominator = np.maximum(denominator, 1e-300)
    gain, step = numerator**2 / denominator / total, -numerator / denominator
    order = np.argsort(gain)[::-1]
    return [(names[int(i)], float(step[i])) for i in order if gain[i] > 0.003][:3]


def one_more_shared(
    problems: Sequence[JointProblem], fits: Sequence[LawFit], names: Sequence[str]
) -> tuple[Attempt | None, list[Attempt]]:
    """The shared number that predicts left-out pieces best, None where none does; all that were
    tried.
    """
    tried = []
    for name, step in likely_shared(problems, fits, names):
        value = getattr(fits[0].law, name)
        if name in DELAY_NAMES and value == 0.0 and step < 0.0:
            continue
        own = [LawFit(f.law, tuple(n for n in f.free if n != name)) for f in fits]
        unit = 0.01 if name in DELAY_NAMES else 1.0
        begin = value + float(np.clip(0.5 * step, -50 * unit, 50 * unit))
        new = fit_shared(problems, own, name, begin)
        tried.append(make_attempt(problems, fits, name, new))
    passed = [a for a in tried if a.passes]
    if not passed:
        return None, tried
    return max(passed, key=lambda a: a.gain), tried
