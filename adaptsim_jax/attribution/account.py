"""The report on what was found of a machine, by whichever objective judged."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import CONFIRMATION
from adaptsim_jax.attribution.equation.rubbing import friction_notes
from adaptsim_jax.attribution.fitted import Selection
from adaptsim_jax.attribution.inquiry import Examined, Inquiry
from adaptsim_jax.attribution.measures import STRETCHES, TORQUE, predicts_nothing
from adaptsim_jax.attribution.report import account_of, evidence_of
from adaptsim_jax.attribution.torque_report import TorqueFound, by_torque, curves
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.report import Account, report_of, withhold_names
from adaptsim_jax.diagnosis.written import write_partial

NOTHING = (
    "This model predicts nothing: by no yardstick does it do better than what needs no model, and "
    "no effect is named."
)


def account(e: Examined) -> Account:
    """What the objective that judged contributes to the report, and what both say of the models."""
    q = e.inquiry
    made = account_of(q.machine, e.problem, e.found, q.criteria, q.horizon)
    if e.judge == TORQUE and e.by_torque is not None:
        assert q.factor is not None
        torques = TorqueFound(e.by_torque, e.before[TORQUE], e.after[TORQUE], q.factor)
        made = by_torque(made, e.problem, torques, q.criteria)
    measures: Table = {"judge": e.judge, "why": e.why}
    for name, each in (("declared", e.before), ("mended", e.after)):
        measures[name] = {k: m.as_dict() for k, m in each.items() if m is not None}
    if predicts_nothing(e.after):
        measures["predicts_nothing"] = True
    notes = [*made.more["notes"], *_disagreement(e), *friction_notes(e.problem)]
    return replace(made, more={**made.more, "yardsticks": measures, "notes": notes})


@np.errstate(over="ignore", invalid="ignore")  # of stretches that run away
def reported(
    e: Examined, change: Callable[[Account], Account] = lambda made: made
) -> tuple[Table, Table]:
    """The report, and the arrays behind its page. change: of the account, what a task says
    otherwise.
    """
    report = report_of(e.found, change(account(e)))
    if predicts_nothing(e.after):
        withhold_names(report, NOTHING, left=True)
    evidence = evidence_of(e.problem, e.found, report)
    if e.by_torque is not None:
        evidence |= curves(e.problem, e.by_torque, e.found.final.fit.vector)
    return report, evidence


def write_so_far(folder: Path, q: Inquiry, found: Selection) -> None:
    """Write the report on what a search has found until now."""

    def made() -> Table:
        return report_of(found, account_of(q.machine, q.problem, found, q.criteria, q.horizon))

    write_partial(folder, made)


def _disagreement(e: Examined) -> list[str]:
    """Where the two witnesses disagree, by numbers; and by which one it was judged."""
    notes = [f"Judged by {_WORDS[e.judge]}: {e.why}."]
    torque: tuple[Any, Any] = (e.before.get(TORQUE), e.after.get(TORQUE))
    other = e.before[STRETCHES], e.after[STRETCHES]
    if e.judge == TORQUE and e.found.named:
        skills = other[0].skill, other[1].skill
        if skills[1] < skills[0] - 0.05:
            notes.append(
                f"Simulated stretches disagree: skill against a straight line {skills[0]:.2f} "
                f"without and {skills[1]:.2f} with what is named; they tell little here."
            )
    elif e.found.named and torque[0] is not None and torque[1] is not None:
        shares = [float(np.mean(m.error / np.maximum(m.still, 1e-300))) for m in torque]
        if shares[1] > CONFIRMATION.contradicted * shares[0]:
            notes.append(
                f"The torque along the motion disagrees: {100 * shares[0]:.0f} % of it is missing "
                f"without and {100 * shares[1]:.0f} % with what is named."
            )
    return notes


_WORDS = {
    STRETCHES: "simulated stretches",
    "whole": "whole simulated trials",
    TORQUE: "the torque along the measured motion",
}
