"""An adaptation method of another package is one file and one entry point: it is run, scored,
counted and listed as ours are.
"""

import sys

import numpy as np
import pytest

from adaptsim_jax.baselines.compare import compared
from adaptsim_jax.baselines.compare_learned import LearnedComparison
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.registry import EXACT, LEARNED, STEPS, learned_methods
from adaptsim_jax.core.errors import BadInput
from tests.baselines import one_shot_probe as probes

METHOD = '''
"""The middle of Omega, again and again."""

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import MethodRun, Visits
from adaptsim_jax.baselines.arena import lanes, two_keys
from adaptsim_jax.space import gaussian


def still(run: MethodRun) -> Visits:
    """Means `[T, S, 1, I + 1, D]` that never move."""
    arena, visits = run.arena, run.config.iterations + 1
    space, batch = arena.one.task.space, lanes(len(run.targets), run.seeds, 1, label=99)
    mean = jnp.full((len(batch.where), space.dim), 0.5)
    dists, rewards = jax.vmap(lambda m: gaussian(space, m))(mean), []
    for i in range(visits):
        train_keys, visit_keys = two_keys(batch.at(i))
        policies = arena.train(train_keys, dists, arena.untrained(train_keys))
        arena.visit(visit_keys, batch.where, policies)
        rewards.append(arena.score(batch.where, policies))
        run.report(i + 1, visits)
    means = np.repeat(np.asarray(mean)[:, None], visits, 1)
    spent = arena.one.trials * np.arange(1, visits + 1)
    return Visits(batch.grid(means), spent, batch.grid(np.stack(rewards, -1)))
'''


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A package with the method, as pip leaves it."""
    (tmp_path / "still_method.py").write_text(METHOD)
    info = tmp_path / "still_method-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: still-method\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[adaptsim.baselines]\nlearned.still = still_method:still\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for registry in (EXACT, LEARNED, STEPS):
        registry.__dict__.pop("others", None)
    yield
    sys.modules.pop("still_method", None)
    for registry in (EXACT, LEARNED, STEPS):
        registry.__dict__.pop("others", None)


def test_it_is_listed_run_scored_and_counted(installed):
    assert len(METHOD.strip().splitlines()) <= 40 and "still" in learned_methods()
    assert "still" not in EXACT and "still" not in STEPS
    config = CompareConfig(methods=("still", "oracle"), seeds=2, iterations=2)
    rows, about = compared(LearnedComparison(probes.probe(), ["wd", "ood-1"], config))
    assert [(r["method"], r["setting"]) for r in rows][:2] == [("still", "wd"), ("still", "ood-1")]
    own = rows[0]
    assert own["trials"] == [2, 4, 6] and own["target_trials"] == 6 and own["made"] > 0
    # gain 1.5 and bias 0 are believed, 1.4 and 0.1 are true
    wrong = np.abs(probes.TESTS * (1.4 / 1.5 - 1.0) + 0.1).mean()
    assert own["mean"] == pytest.approx(1.0 - wrong, abs=1e-5)
    np.testing.assert_allclose(own["best_params"], [[1.5, 0.0]] * 2, atol=1e-6)
    assert about["settings"].keys() == {"wd", "ood-1"}


def test_without_the_package_its_name_is_unknown():
    with pytest.raises(BadInput, match="still"):
        CompareConfig(methods=("still",))
