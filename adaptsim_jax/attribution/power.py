"""What could have been found at the joints of a machine: the size from which an effect would pass
the score test.
"""

from collections.abc import Sequence
from typing import Any

from scipy import stats

from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import CandidateScore
from adaptsim_jax.attribution.sentences import place
from adaptsim_jax.diagnosis.criteria import Criteria

SURE = 0.8  # share of recordings like this one in which the size that is told would be found


def power_rows(
    problem: TreeProblem, scores: Sequence[CandidateScore], criteria: Criteria
) -> list[dict[str, Any]]:
    """Rows of `power` of candidates that act linearly through one number: the size that `SURE` of
    recordings like this one would show.

    Args:
        problem: the recording as it was fitted.
        scores: of candidates about the final model, with `scatter`, the cluster-robust standard
                error of an amplitude.
        criteria: its level is corrected for the number of candidates, as in the score test.

    Returns:
        `{name, where, size, unit, power}`, sizes in the unit of the amplitude, the best seen first.
    """
    level = criteria.alpha / max(len(scores), 1)
    times = float(stats.norm.isf(level / 2) + stats.norm.isf(1.0 - SURE))
    rows = [
        {
            "name": s.candidate.effect,
            "where": place(problem, s.candidate),
            "size": times * s.scatter,
            "unit": s.candidate.entries[0].unit,
            "power": SURE,
        }
        for s in scores
        if s.scatter > 0.0 and not problem.effect(s.candidate.effect).jump
    ]
    return sorted(rows, key=lambda row: (row["name"], row["where"]))
