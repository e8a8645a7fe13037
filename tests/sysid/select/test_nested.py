"""The finer shape of an effect that is found: fitted where the data show it, left alone where they do not."""

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import force_ratio
from adaptsim_jax.sysid.estimate.problem import prepare_within_reach
from adaptsim_jax.sysid.nuisance.null_model import declared
from adaptsim_jax.sysid.select.nested import elaborated
from tests.sysid.small_rig import make_trials, written

LIMIT, PLACE = 0.4, ("saturation", "joint1")
EFFECTS = tuple(e for e in catalogue() if e.name in ("saturation", "coulomb"))


def soft(u):
    """A limit with a round knee, in other words than the catalogue's: exponent 6."""
    return u / (1.0 + np.abs(u / LIMIT) ** 6) ** (1.0 / 6.0)


def sharp(u):
    return np.clip(u, -LIMIT, LIMIT)


def limited(limit):
    return lambda t, q, v, u: np.array([limit(u[0]) - u[0], 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("limit", [soft, sharp], ids=["soft", "sharp"])
def test_a_knee_is_fitted_where_there_is_one(tmp_path, limit):
    trials = make_trials(seed=8, count=3, noise=0.3, extra=limited(limit))
    recording = read_recording(written(tmp_path, trials))
    checked = audit(recording)
    recording = usable(recording, checked)
    problem, start = prepare_within_reach(recording, checked, noise_floor(recording, checked), EFFECTS)
    base, first = declared(problem, start)
    layout = problem.model.layout
    at = layout.instances[layout.index(*PLACE)].at
    eff = layout.off()
    eff[at] = [1.0 - LIMIT / problem.reach.peak[0], problem.reach.peak[0], 0.0]
    plain = fit(problem, base.start(active=(PLACE,), eff=eff), first.response)
    assert "softness" not in plain.candidate.parameters(*PLACE)  # late: not fitted in the search
    better = lambda new, old: new.total > old.total + 10.0 and force_ratio(new, old) < 0.9
    again, final = elaborated(problem, plain, base, first.response, better)
    if limit is soft:
        fine = final.candidate.parameters(*PLACE)
        assert again.elaborated == (PLACE,) and abs(fine["softness"][0] - 1 / 6) < 0.03
        assert np.abs((1.0 - fine["cut"][0]) * problem.reach.peak[0] - LIMIT) < 0.02 * LIMIT
        assert final.parts.force_std()[0] < 0.3 * plain.parts.force_std()[0]
    else:
        assert final is plain and again is problem
