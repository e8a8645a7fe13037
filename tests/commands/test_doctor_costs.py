"""`adaptsim doctor --costs`: every engine has its row; the cheapest is measured."""

import pytest

from adaptsim_jax.commands.doctor import ENGINES, config_of, cost_line, costs


def test_every_engine_of_every_task_has_a_configuration_of_its_own():
    made = {
        (task, name): config_of(task, name).task for task, rows in ENGINES.items() for name in rows
    }
    assert (
        made["pushing", "mjx"]["simulator"] == "mjx"
        and made["scooping", "hydro"]["simulator"] == "hydro"
    )
    assert len({str(sorted(options.items())) for options in made.values()}) == len(made)


@pytest.mark.slow
def test_a_trajectory_of_the_pendulum_takes_milliseconds():
    (row,) = costs(("pendulum",))
    assert 1e-6 < row["s_a_trajectory"] < 1.0 and cost_line(row).startswith(
        "cost       pendulum in exact"
    )
