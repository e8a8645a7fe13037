"""A base that heaves, met by each trial at another phase: found among what shakes, from files."""

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.sysid.pipeline import diagnose
from tests.sysid.small_rig import GEOMETRY, TRUE, make_trials, written

FEW = tuple(e for e in catalogue("pendulum") if e.name in ("heave", "sway", "periodic_disturbance", "bias"))
SHARE, FREQUENCY = 0.06, 2.3  # of g; Hz


def heaving(phase):
    def force(t, q, v, u):
        lower = TRUE[3] * np.sin(q[0] + q[1])
        pull = -GEOMETRY["g"] * np.array([TRUE[2] * np.sin(q[0]) + lower, lower])
        return SHARE * np.sin(2.0 * np.pi * FREQUENCY * t + phase) * pull

    return force


@pytest.mark.slow
def test_a_base_that_heaves_is_named_with_its_frequency(tmp_path):
    phases = (0.4, 2.5, -1.3)
    trials = [make_trials(seed=30 + i, count=1, seconds=3.0, extra=heaving(x))[0] for i, x in enumerate(phases)]
    report = diagnose(written(tmp_path, trials), effects=FEW, follow_up=False)
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("heave", "base")]
    found = {name: p["value"] for name, p in report["effects"][0]["parameters"].items()}
    assert np.hypot(found["sine"], found["cosine"]) == pytest.approx(SHARE, rel=0.05)
    assert found["frequency"] == pytest.approx(FREQUENCY, rel=0.01)
    assert report["error"]["after"] < 1.15 * report["error"]["noise_floor"]
