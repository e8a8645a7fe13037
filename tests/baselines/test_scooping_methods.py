"""BayesOpt in scooping: each visit's last scoop is a probe, its return is that of the others, and
what is deployed is corrected.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines.arena import Arena, MethodRun
from adaptsim_jax.baselines.bayesopt import BayesOptConfig, bayesopt
from adaptsim_jax.baselines.config import default_comparison
from adaptsim_jax.tasks.one_shot import TargetWorld
from adaptsim_jax.tasks.registry import make_one_shot

OPTIONS = {
    "correct": True,
    "tests": 2,
    "trials": 40,
    "hidden": [16],
    "training": {"block": 20, "updates": 2, "batch": 16, "capacity": 40, "candidates": 4},
}
CONFIG = replace(default_comparison("scooping"), bayesopt=BayesOptConfig(initial=2, points=3))


def stand_in(params, contexts, actions):
    """A world that lifts what is scooped at a low pitch, in place of an engine that is slow to
    compile.
    """
    outcomes = np.zeros((len(actions), 9, 2), np.float32)
    outcomes[:, :-1, 0] = np.linspace(0.0, 0.1, 8)
    outcomes[:, -1, 0] = actions[:, 0] < -0.5
    return outcomes, np.zeros(len(actions), int)


class Recorder(Arena):
    """Keeps policies and trials of each visit."""

    def visit(self, keys, where, policies):
        seen = super().visit(keys, where, policies)
        self.kept.append((policies, seen))
        return seen


@pytest.mark.long
def test_visits_probe_and_deployed_scoops_learn_of_it():
    one = make_one_shot("scooping", OPTIONS)
    arena = Recorder(
        one, TargetWorld("stand-in", stand_in, {0: "fine"}), np.array([[0.3, 5e4, 1.0, 0.02]])
    )
    arena.kept = []
    trip = bayesopt(MethodRun(CONFIG, arena, np.array([0])))
    for policies, seen in arena.kept:
        own = jax.vmap(one.act)(policies._replace(probe=None), jnp.asarray(seen.trials.contexts))
        np.testing.assert_allclose(seen.trials.actions[:, 0], own[:, 0], atol=1e-5)
        np.testing.assert_allclose(seen.trials.actions[:, 1], policies.probe, atol=1e-6)
        assert policies.told is None and seen.score == (seen.trials.actions[:, 0, 0] < -0.5)
    assert trip.rewards.shape == (1, 1, 1, 3) and trip.spent.tolist() == [2, 4, 6]
    assert set(trip.rewards[0, 0, 0, 1:]) <= {
        0.0,
        1.0,
    }  # corrected, it is one scoop for all contexts
