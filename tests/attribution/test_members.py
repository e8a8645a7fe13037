"""Joints of an effect that do not show it by themselves: they go together only where the rest
predicts as well.
"""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution import tree_objective
from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.parameters import Entry
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.rules import Reason
from adaptsim_jax.diagnosis.testing import Test as Paired

JOINTS = (0, 1, 2, 3)
ENTRIES = tuple(Entry("coulomb", "level", (j,), 0.0, 0.0, 0.0, 9.0, "N m", np.inf) for j in JOINTS)


@dataclass(frozen=True)
class Small:
    """A model as far as `members` looks at it."""

    added: tuple
    held: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(loss=0, paths=()))
    fit: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(weights=None))


@pytest.mark.parametrize(("most", "stay"), [(4, ()), (2, (2, 3)), (1, (1, 2, 3)), (0, JOINTS)])
def test_weak_joints_go_together_while_the_rest_predicts_as_well(most, stay, monkeypatch):
    """None shows by itself; without more than `most` of them the model predicts worse."""

    def gone(model):
        return len(JOINTS) - len(model.added[0].joints) if model.added else len(JOINTS)

    def trim(problem, model, keys, criteria):
        return replace(
            model,
            added=tuple(
                c.at(left)
                for c in model.added
                if (left := [e for e in c.entries if e.key not in keys])
            ),
        )

    def worse(n):
        return Paired(0.5 if n > most else 0.0, 1e-4 if n > most else 0.5, 6, 6, 60)

    monkeypatch.setattr(
        tree_objective,
        "without",
        lambda p, m, c, criteria: replace(m, held=SimpleNamespace(loss=c.joints[0])),
    )
    monkeypatch.setattr(tree_objective, "steadiness", lambda model, c: 9.0)
    monkeypatch.setattr(
        tree_objective, "refusal", lambda evidence, stages: Reason("not_confirmed", 0.5, "")
    )
    monkeypatch.setattr(
        tree_objective,
        "trimmed",
        lambda *a: replace(m := trim(*a), held=SimpleNamespace(loss=0, paths=gone(m))),
    )
    monkeypatch.setattr(tree_objective, "losses", lambda problem, paths, weights: (paths,))
    monkeypatch.setattr(tree_objective, "more", lambda large, small: 1)

    def alone(joint):
        return Paired(0.001 * (joint + 1), 0.5, 3, 6, 60)

    monkeypatch.setattr(
        tree_objective,
        "paired",
        lambda p, less, whole: worse(less[0]) if isinstance(less, tuple) else alone(less),
    )
    whole = Small((JointCandidate("coulomb", JOINTS, "all", ENTRIES),))
    problem: Any = SimpleNamespace(joint_names=("a", "b", "c", "d"))
    reach: Any = None
    judge = tree_objective.TreeObjective(problem, whole, reach, Criteria())
    left, trace = judge.members(whole)
    assert tuple(j for c in left.added for j in c.joints) == stay
    assert len(trace) == len(JOINTS) - len(stay)
