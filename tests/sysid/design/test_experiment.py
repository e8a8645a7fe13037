"""What the next experiment is said to be good for."""

import numpy as np
import pytest

from adaptsim_jax.sysid.design.experiment import Plan


@pytest.mark.parametrize(
    ("distance", "begins"), [(42.0, "Run next_experiment.csv"), (7.6e-10, "No command tried tells")]
)
def test_models_that_no_command_parts_are_not_said_to_come_apart(distance, begins):
    time = np.arange(3.0)
    plan = Plan(time, np.zeros((3, 2)), "a sweep", ("a rotor", "a spring"), distance, 0.0, True)
    message = plan.told()[0]["message"]
    assert message.startswith(begins)
    assert "a rotor" in message and "a spring" in message and "e-" not in message and "0.0000" not in message
