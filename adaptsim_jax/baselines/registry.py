"""Baselines by name. Imports no JAX: commands list the names.

A baseline is a function `(MethodRun) -> Visits` (`arena.py`). Of a task whose policy is solved
exactly it gives the means of E that it visited; of one whose policies are learned, also of one
whose trials are episodes of many steps, what its policies earned too. Another package adds one by
an entry point of the group `adaptsim.baselines`, called `exact.NAME`, `learned.NAME` or
`steps.NAME`.
"""

from collections.abc import Callable
from typing import Any

from adaptsim_jax.core.registry import Registry

HERE = "adaptsim_jax.baselines"
BOUNDS = ("udr", "best_in_omega")  # 0 and 1 of the exact scale, computed for every comparison
ORACLE = "oracle"  # what the best actions earn in the target itself, likewise

EXACT: Registry[Callable[..., Any]] = Registry(
    "baselines",
    {
        "adaptsim": f"{HERE}.exact_methods:adaptsim",
        "adaptsim_state": f"{HERE}.exact_methods:adaptsim_state",
        "adaptsim_analytic": f"{HERE}.exact_methods:adaptsim_analytic",
        "sysid_bayes": f"{HERE}.exact_methods:sysid_bayes",
        "sysid_bayes_state": f"{HERE}.exact_methods:sysid_bayes_state",
        "sysid_point": f"{HERE}.exact_methods:sysid_point",
        "sysid_point_state": f"{HERE}.exact_methods:sysid_point_state",
        "gradient": f"{HERE}.exact_methods:gradient",
    },
    within="exact",
)
LEARNED: Registry[Callable[..., Any]] = Registry(
    "baselines",
    {
        "adaptsim": f"{HERE}.adapting:adaptsim",
        "sysid_bayes": f"{HERE}.adapting:sysid_bayes",
        "sysid_point": f"{HERE}.adapting:sysid_point",
        "bayesopt": f"{HERE}.bayesopt:bayesopt",
        "udr": f"{HERE}.direct:udr",
        "udr_target": f"{HERE}.direct:udr_target",
        "learn_in_target": f"{HERE}.direct:learn_in_target",
    },
    within="learned",
)
STEPS: Registry[Callable[..., Any]] = Registry(
    "baselines",
    {
        "adaptsim": f"{HERE}.adapting:adaptsim",
        "sysid_bayes": f"{HERE}.adapting:sysid_bayes",
        "sysid_point": f"{HERE}.adapting:sysid_point",
        "bayesopt": f"{HERE}.bayesopt:bayesopt",
        "cma_es": f"{HERE}.steps_search:cma_es",
        "sbi": f"{HERE}.steps_search:sbi",
        "gradient": f"{HERE}.steps_search:gradient",
        "fine_tune": f"{HERE}.steps_trained:fine_tune",
        "nominal": f"{HERE}.steps_trained:nominal",
        "udr": f"{HERE}.steps_trained:udr",
        "udr_wide": f"{HERE}.steps_trained:udr_wide",
        "best_in_omega": f"{HERE}.steps_trained:best_in_omega",
        "oracle": f"{HERE}.steps_trained:oracle",
    },
    within="steps",
)
PROBLEMS: Registry[Callable[..., Any]] = Registry(
    "problems", {"pendulum": f"{HERE}.bounds:pendulum_problem"}
)


def exact_methods() -> tuple[str, ...]:
    """Rows of a comparison on a task whose policy is solved exactly."""
    return (*EXACT, *BOUNDS)


def steps_methods() -> tuple[str, ...]:
    """Rows of a comparison of policies over many steps."""
    return tuple(STEPS)


def learned_methods() -> tuple[str, ...]:
    """Rows of a comparison on a task whose policies are learned."""
    return (*LEARNED, ORACLE)
