"""Baselines by name. Imports no JAX: commands list the names.

Of a task whose policy is solved exactly, `(Run) -> Visits` (`methods.py`); of one whose policies
are learned, `(Bout) -> Trip` (`learned.py`), also of one whose trials are episodes of many steps.
Another package adds one by an entry point of the group `adaptsim.baselines`, called `exact.NAME`,
`learned.NAME` or `steps.NAME`.
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
        "adaptsim": f"{HERE}.methods:adaptsim",
        "adaptsim_state": f"{HERE}.methods:adaptsim_state",
        "adaptsim_analytic": f"{HERE}.methods:adaptsim_analytic",
        "sysid_bayes": f"{HERE}.methods:sysid_bayes",
        "sysid_bayes_state": f"{HERE}.methods:sysid_bayes_state",
        "sysid_point": f"{HERE}.methods:sysid_point",
        "sysid_point_state": f"{HERE}.methods:sysid_point_state",
        "gradient": f"{HERE}.methods:descend",
    },
    within="exact",
)
LEARNED: Registry[Callable[..., Any]] = Registry(
    "baselines",
    {
        "adaptsim": f"{HERE}.learned:adaptsim",
        "sysid_bayes": f"{HERE}.learned:sysid_bayes",
        "sysid_point": f"{HERE}.learned:sysid_point",
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
        "adaptsim": f"{HERE}.learned:adaptsim",
        "sysid_bayes": f"{HERE}.learned:sysid_bayes",
        "sysid_point": f"{HERE}.learned:sysid_point",
        "bayesopt": f"{HERE}.bayesopt:bayesopt",
        "cma_es": f"{HERE}.steps_methods:cma_es",
        "sbi": f"{HERE}.steps_sbi:sbi",
        "gradient": f"{HERE}.steps_gradient:gradient",
        "fine_tune": f"{HERE}.steps_methods:fine_tune",
        "nominal": f"{HERE}.steps_methods:nominal",
        "udr": f"{HERE}.steps_methods:udr",
        "udr_wide": f"{HERE}.steps_methods:udr_wide",
        "best_in_omega": f"{HERE}.steps_methods:best_in_omega",
        "oracle": f"{HERE}.steps_methods:oracle",
    },
    within="steps",
)
PROBLEMS: Registry[Callable[..., Any]] = Registry(
    "problems", {"pendulum": f"{HERE}.problem:pendulum_problem"}
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
