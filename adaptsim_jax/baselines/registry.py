"""Baselines by name. Imports no JAX: commands list the names.

A baseline is a function `(MethodRun) -> Visits` (`arena.py`). Of a task whose policy is solved
exactly it gives the means of E that it visited; of one whose policies are learned, also of one
whose trials are episodes of many steps, what its policies earned too. Another package adds one by
an entry point of the group `adaptsim.baselines`, called `exact.NAME`, `learned.NAME` or
`steps.NAME`.
"""

from collections.abc import Callable

from adaptsim_jax.core.registry import Registry

HERE = "adaptsim_jax.baselines"
BOUNDS = ("udr", "best_in_omega")  # 0 and 1 of the exact scale, computed for every comparison
ORACLE = "oracle"  # what the best actions earn in the target itself, likewise


def _in(module: str, *names: str) -> dict[str, str]:
    """Where functions of these names stand."""
    return {name: f"{HERE}.{module}:{name}" for name in names}


EXACT: Registry[Callable] = Registry(
    "baselines",
    _in(
        "exact_methods",
        "adaptsim",
        "adaptsim_state",
        "adaptsim_analytic",
        "sysid_bayes",
        "sysid_bayes_state",
        "sysid_point",
        "sysid_point_state",
        "gradient",
    ),
    within="exact",
)
ADAPTING = _in("adapting", "adaptsim", "sysid_bayes", "sysid_point") | _in("bayesopt", "bayesopt")
LEARNED: Registry[Callable] = Registry(
    "baselines",
    ADAPTING | _in("direct", "udr", "udr_target", "learn_in_target"),
    within="learned",
)
STEPS: Registry[Callable] = Registry(
    "baselines",
    ADAPTING
    | _in("steps_search", "cma_es", "sbi", "gradient")
    | _in("steps_trained", "fine_tune", "nominal", "udr", "udr_wide", "best_in_omega", "oracle"),
    within="steps",
)
PROBLEMS: Registry[Callable] = Registry("problems", {"pendulum": f"{HERE}.bounds:pendulum_problem"})


def exact_methods() -> tuple[str, ...]:
    """Rows of a comparison on a task whose policy is solved exactly."""
    return (*EXACT, *BOUNDS)


def steps_methods() -> tuple[str, ...]:
    """Rows of a comparison of policies over many steps."""
    return tuple(STEPS)


def learned_methods() -> tuple[str, ...]:
    """Rows of a comparison on a task whose policies are learned."""
    return (*LEARNED, ORACLE)
