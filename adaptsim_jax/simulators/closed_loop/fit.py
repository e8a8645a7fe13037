"""The numbers of a joint's servo fitted to its pieces: Gauss and Newton's steps by differences,
where fits begin, and how a law predicts pieces that were left out.

Pieces are weighted by 1 / (their own mean square + the median one). A weak pull holds the scale at
the file's where the data do not tell it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from scipy.optimize import lsq_linear

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.imposed import JointProblem
from adaptsim_jax.simulators.closed_loop.law import LOGARITHMIC, OPEN, ServoLaw, step_law
from adaptsim_jax.simulators.closed_loop.stepping import errors, squared

STEP = {"scale": 1e-3, "damping": 1e-3, "limit": 1e-3, "rub": 5e-3, "delay": 0.02, "lag": 0.02}
"""Of differences, by coordinate; others `OTHER_STEP`."""
OTHER_STEP = 2e-3
DAMPING = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Times the damping before, that a round tries, each whole and at `SHORT`."""
SHORT = 0.3


@dataclass(frozen=True)
class LawFit:
    """A law of a joint and the coordinates that were fitted of it."""

    law: ServoLaw
    free: tuple[str, ...]

    def of(self, law: ServoLaw) -> "LawFit":
        """Return the fit with other numbers."""
        return LawFit(law, self.free)

    def and_free(self, name: str) -> "LawFit":
        """Return the fit with one more coordinate."""
        return self if name in self.free else LawFit(self.law, (*self.free, name))


@dataclass(frozen=True)
class LinearModel:
    """errors [P, R] of a law, slope [P, R, K] by its coordinates, weight [P]; the pull's own
    normal equations.
    """

    error: np.ndarray
    slope: np.ndarray
    weight: np.ndarray
    prior: tuple[np.ndarray, np.ndarray]

    def by_piece(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations [P, K, K], [P, K]."""
        weighted = self.slope * self.weight[:, None, None]
        hess = np.einsum("pra,prb->pab", weighted, self.slope)
        return hess, np.einsum("pra,pr->pa", weighted, self.error)

    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        """Sum the normal equations of all pieces, with the pull."""
        hess, slope = (z.sum(0) for z in self.by_piece())
        return hess + self.prior[0], slope + self.prior[1]


def sum_squares(problem: JointProblem, law: ServoLaw) -> np.ndarray:
    """Sum of squares [P] of a law."""
    return squared(errors(problem, [law]))[0]


def error_over_noise(problem: JointProblem, law: ServoLaw) -> float:
    """Error of all pieces over the noise."""
    return float(np.sqrt(sum_squares(problem, law).sum() / problem.rows.sum()) / problem.noise)


def weights(problem: JointProblem, sums: np.ndarray) -> np.ndarray:
    """[P] of sums of squares [P]."""
    mean = sums / problem.rows
    return 1.0 / (mean + np.median(mean) + problem.noise**2)


def pull_loss(problem: JointProblem, fit: LawFit) -> float:
    """What the pull adds to the loss."""
    return sum(CLOSED_LOOP.pull * np.log1p(2.0 * z * z) for _, z in _off_scale(problem, fit))


def _off_scale(problem: JointProblem, fit: LawFit) -> list[tuple[int, float]]:
    """Place and size of the logarithmic coordinates: how far they are from the file's."""
    file, law = problem.servo.law, fit.law
    stiff = "damping" if problem.servo.follows_speed else "kp"
    out = []
    for i, name in enumerate(fit.free):
        number = stiff if name == "scale" else name
        if name not in LOGARITHMIC or getattr(file, number) >= OPEN:
            continue
        base = getattr(file, number)
        if name == "damping":
            base = base / file.kp * law.kp
        if base > 0.0:
            out.append((i, float(np.log(max(getattr(law, number), 1e-300) / base))))
    return out


def prior_of(problem: JointProblem, fit: LawFit) -> tuple[np.ndarray, np.ndarray]:
    count = len(fit.free)
    hess, slope = np.zeros((count, count)), np.zeros(count)
    for i, z in _off_scale(problem, fit):
        if fit.free[i] != "scale":
            continue
        hess[i, i] += CLOSED_LOOP.pull / (0.5 + z * z)
        slope[i] += CLOSED_LOOP.pull * z / (0.5 + z * z)
    return hess, slope


def linearise(problem: JointProblem, fit: LawFit, weight: np.ndarray | None = None) -> LinearModel:
    """A law's errors and their derivatives, by differences."""
    step = np.array([STEP.get(name, OTHER_STEP) for name in fit.free])
    laws = [
        step_law(problem.servo, problem.scales, fit.law, fit.free, row) for row in np.diag(step)
    ]
    all_errors = errors(problem, [fit.law, *laws])
    slope = np.zeros((*all_errors[0].shape, len(fit.free)))
    for k, h in enumerate(step):
        slope[..., k] = (all_errors[k + 1] - all_errors[0]) / h
    if weight is None:
        weight = weights(problem, squared(all_errors[0]))
    slope = np.where(np.isfinite(slope), slope, 0.0)
    return LinearModel(all_errors[0], slope, weight, prior_of(problem, fit))


def solve(hess: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares by normal equations, scaled to a diagonal of 1 and a trace of ridge."""
    size = np.sqrt(np.maximum(np.diag(hess), 1e-300))
    scaled = hess / size[:, None] / size + 1e-9 * np.eye(len(size))
    answer = np.linalg.lstsq(scaled, (right.T / size).T, rcond=1e-12)[0]
    return (answer.T / size).T


def solve_within(
    hess: np.ndarray, right: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Step [K] of least squares by normal equations within [low, high]; scaled as `solve`."""
    if not len(right):
        return right
    size = np.sqrt(np.maximum(np.diag(hess), 1e-300))
    value, vector = np.linalg.eigh(hess / size[:, None] / size + 1e-9 * np.eye(len(size)))
    root = np.sqrt(np.maximum(value, 1e-12))
    rows, aim = root[:, None] * vector.T, -(vector.T @ (right / size)) / root
    step = lsq_linear(rows, aim, (low * size, high * size), method="bvls").x / size
    return np.clip(step, low, high)


def fit_law(problem: JointProblem, fit: LawFit, rounds: int = CLOSED_LOOP.rounds) -> LawFit:
    """Levenberg and Marquardt's fit from where `fit` is."""
    damping, weight = 1e-3, None
    for k in range(rounds):
        linear = linearise(problem, fit, weight)
        if k in (0, 3):
            linear = linearise(problem, fit) if k else linear
            weight = linear.weight
        hess, slope = linear.normal()
        before = float(linear.weight @ squared(linear.error)) + pull_loss(problem, fit)
        diagonal = np.diag(np.diag(hess) + 1e-12 * np.trace(hess) + 1e-300)
        sizes = damping * np.array(DAMPING)
        steps = [np.clip(-solve(hess + z * diagonal, slope), -1.5, 1.5) for z in sizes]
        tries = [
            fit.of(step_law(problem.servo, problem.scales, fit.law, fit.free, share * step))
            for share in (1.0, SHORT)
            for step in steps
        ]
        sums = squared(errors(problem, [t.law for t in tries])) @ linear.weight
        loss = sums + [pull_loss(problem, t) for t in tries]
        best = int(np.argmin(loss))
        if not loss[best] < before:
            break
        fit = tries[best]
        damping = float(np.clip(sizes[best % len(sizes)], 1e-8, 1e3))
        if loss[best] > before * (1.0 - 2e-4):
            break
    return fit


@dataclass(frozen=True)
class HeldOutPieces:
    """sums [P] of squares of pieces by numbers of the others; steps [F, K] to those numbers."""

    sums: np.ndarray
    steps: np.ndarray


def held_out_pieces(problem: JointProblem, fit: LawFit) -> HeldOutPieces:
    """Each group of pieces simulated by numbers that one step without it gives."""
    if not fit.free:
        return HeldOutPieces(sum_squares(problem, fit.law), np.zeros((len(problem.groups), 0)))
    linear = linearise(problem, fit)
    hess, slope = linear.normal()
    own_hess, own_slope = linear.by_piece()
    full_step = solve(hess, slope)
    steps = np.array(
        [
            full_step - solve(hess - own_hess[g].sum(0), slope - own_slope[g].sum(0))
            for g in problem.groups
        ]
    )
    laws = [
        step_law(problem.servo, problem.scales, fit.law, fit.free, np.clip(s, -0.7, 0.7))
        for s in steps
    ]
    all_sums = squared(errors(problem, laws))
    sums = np.zeros(len(problem.rows))
    for k, group in enumerate(problem.groups):
        sums[group] = all_sums[k][group]
    return HeldOutPieces(sums, steps)


def by_group(problem: JointProblem, sums: np.ndarray) -> np.ndarray:
    """[F] of sums of squares [P], with a part of the noise, below which nothing counts."""
    floor = 0.05 * problem.noise**2 * problem.rows
    return np.array([(sums + floor)[g].sum() for g in problem.groups])


def gains(problem: JointProblem, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Logarithms [F] of what is left before over after, each within 1."""
    return np.clip(np.log(by_group(problem, before) / by_group(problem, after)), -1.0, 1.0)


def paired_t(differences: np.ndarray) -> float:
    """One-sided p of a paired t-test; 1 of fewer than three."""
    if len(differences) < 3:
        return 1.0
    if differences.std() < 1e-9:
        return float(differences.mean() <= 1e-9)
    test: Any = stats.ttest_1samp(differences, 0.0, alternative="greater")
    return float(test.pvalue)


def score(problem: JointProblem, sums: np.ndarray) -> float:
    """Mean logarithm of what is left."""
    return float(np.log(by_group(problem, sums)).mean())


def most_moving(problem: JointProblem) -> JointProblem:
    """The pieces that move most, where a fit begins."""
    lane, max_pieces = problem.lanes, CLOSED_LOOP.start_pieces
    is_counted, measured = np.asarray(lane.counted) > 0, np.asarray(lane.measured)
    if len(is_counted) <= max_pieces:
        return problem
    ranges_of_motion = [
        np.ptp(m[c]) if c.any() else 0.0 for m, c in zip(measured, is_counted, strict=True)
    ]
    return problem.only(np.sort(np.argsort(ranges_of_motion)[-max_pieces:]))


def _grid(problem: JointProblem, law: ServoLaw) -> list[ServoLaw]:
    """Laws on a grid of kp and of the time in which damping stops, with and without friction."""
    servo, out = problem.servo, []
    if servo.follows_speed:
        for factor in 2.0 ** np.arange(-4, 3):
            for rub in (law.rub, 0.3 * factor * problem.scales.force):
                out.append(law._replace(damping=servo.law.damping * factor, rub=rub))
        return out
    for kp in servo.law.kp * 2.0 ** np.arange(-8, 2.5, 1.0):
        for time in (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2):
            for rub in (law.rub, 0.3 * kp * problem.scales.error):
                out.append(law._replace(kp=kp, damping=kp * time, rub=rub))
    for a in (0.5, 1.0, 2.0):
        for b in (0.1, 0.3, 1.0, 2.0):
            out.append(law._replace(kp=servo.law.kp * a, damping=servo.law.damping * b))
    return out


def _best_distinct(
    problem: JointProblem, laws: Sequence[ServoLaw], count: int
) -> tuple[list[ServoLaw], float]:
    """The best laws that differ from each other, and the score of the first."""
    sums = squared(errors(problem, list(laws)))
    value = np.log(sums / problem.rows + problem.noise**2).mean(1)
    chosen: list[ServoLaw] = []
    for k in np.argsort(value):
        law = laws[int(k)]
        is_near = [
            abs(np.log((law.kp + 1e-12) / (z.kp + 1e-12))) < 0.6
            and abs(np.log(law.damping / z.damping)) < 0.8
            for z in chosen
        ]
        if not any(is_near):
            chosen.append(law)
        if len(chosen) == count:
            break
    return chosen, float(value.min())


def fit_from_grid(problem: JointProblem, base: ServoLaw, delay_name: str | None = None) -> LawFit:
    """kp, damping and friction from a grid, the rest of the law as `base`; with `delay_name`,
    `delay` or `lag`, that number as well.
    """
    moving, free = most_moving(problem), problem.servo.free
    if delay_name is None:
        starts = [*_best_distinct(moving, _grid(problem, base), 3)[0], base]
    else:
        free = (*free, delay_name)
        candidates = [
            _best_distinct(moving, _grid(problem, base._replace(**{delay_name: z})), 2)
            for z in (0.012, 0.03, 0.06)
        ]
        starts = min(candidates, key=lambda f: f[1])[0]
    tries = [fit_law(moving, LawFit(law, free), 8) for law in starts]
    best = min(tries, key=lambda t: score(moving, sum_squares(moving, t.law)))
    return fit_law(problem, best)


def fit_with_limit(problem: JointProblem, fit: LawFit) -> LawFit:
    """The law with a limit, begun from the torque that the motion needs; before the damping from
    the highest speed that was measured, too, which is near the speed without load. The law as it
    was where left-out pieces refute that.
    """
    servo, moving = problem.servo, most_moving(problem)
    if servo.follows_speed or not servo.allowed("limit"):
        return fit
    laws = [*_limited_laws(problem, fit.law), *_laws_limited_before_damping(problem, fit.law)]
    sums = squared(errors(moving, laws))
    order = np.argsort(np.log(sums / moving.rows + moving.noise**2).mean(1))[:3]
    tries = [fit_law(moving, LawFit(laws[k], (*fit.free, "limit")), 8) for k in order]
    new = fit_law(problem, min(tries, key=lambda t: score(moving, sum_squares(moving, t.law))))
    rival = fit_law(problem, _friction_in_limit(servo.law, new))
    new = min((new, rival), key=lambda t: score(problem, sum_squares(problem, t.law)))
    if is_preferred(problem, fit, new):
        return new
    return fit


def _friction_in_limit(file: ServoLaw, fit: LawFit) -> LawFit:
    """The law with the file's friction, what it had beyond that taken off its limit: motion at the
    limit in one direction shows their difference alone.
    """
    law = fit.law
    limit = max(law.limit - law.rub + file.rub, 0.1 * law.limit)
    return fit.of(law._replace(rub=file.rub, limit=limit))


def _limited_laws(problem: JointProblem, law: ServoLaw) -> list[ServoLaw]:
    """Laws whose limit cuts the whole force."""
    kp = problem.servo.law.kp
    return [
        law._replace(kp=kp * a, damping=kp * a * time, limit=problem.needed * b, rub=r, inside=1.0)
        for a in (0.35, 0.7, 1.4)
        for time in (0.006, 0.02, 0.06)
        for b in (0.8, 1.1, 1.6)
        for r in (0.0, 0.1 * problem.needed)
    ]


def _laws_limited_before_damping(problem: JointProblem, law: ServoLaw) -> list[ServoLaw]:
    """Laws whose limit is before the damping."""
    file = problem.servo.law
    usual = file.limit if file.limit < OPEN else file.kp * problem.scales.error
    limits = [usual * b for b in (0.35, 0.7, 1.4)] + [problem.needed * b for b in (1.2, 2.0)]
    return [
        law._replace(
            kp=file.kp * 2.0**a,
            limit=limit,
            damping=limit / (f * problem.top_speed) + problem.servo.passive,
            rub=r * limit,
            inside=0.0,
        )
        for a in range(-4, 2)
        for limit in limits
        for f in (1.0, 1.5, 2.5)
        for r in (0.03, 0.15)
    ]


def is_preferred(
    problem: JointProblem, one: LawFit, other: LawFit, gain: float = CLOSED_LOOP.gain
) -> bool:
    """Whether left-out pieces are predicted better by the other, by `gain` and beyond chance."""
    before, after = (held_out_pieces(problem, fit).sums for fit in (one, other))
    gains_by_group = gains(problem, before, after)
    over_noise = [np.sqrt(sums / problem.rows) / problem.noise for sums in (before, after)]
    beyond_chance = paired_t(gains_by_group) < CLOSED_LOOP.level or explains(*over_noise)
    return bool(gains_by_group.mean() > gain and beyond_chance)


def explains(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether several pieces come from far beyond the noise to it, and none is left further beyond
    it: what acts now and then (a limit) helps few pieces, and these wholly.

    Args:
        before, after: [P] errors over the noise.
    """
    is_helped = (before > CLOSED_LOOP.far) & (after < CLOSED_LOOP.enough)
    is_harmed = after > np.maximum(CLOSED_LOOP.enough, CLOSED_LOOP.shown * before)
    return bool(is_helped.sum() >= CLOSED_LOOP.helped and not is_harmed.any())
