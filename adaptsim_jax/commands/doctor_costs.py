"""What an adaptation trajectory of Phase 1 costs on this machine in each engine that a task can be
simulated in.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

VISITS = 16  # at once; a GPU does more in the same time


def engines() -> dict[str, dict[str, Callable[[], Any]]]:
    """For each task its engines, each with the configuration that Phase 1 would be run with."""
    from adaptsim_jax.adaptation.presets import PRESETS, default_config

    return {
        "pendulum": {"exact": lambda: default_config("pendulum")},
        "pushing": {
            "planar": lambda: default_config("pushing"),
            "native": PRESETS["native-pushing"],
            "mjx": PRESETS["mjx-pushing"],
        },
        "scooping": {
            "bank": lambda: default_config("scooping"),
            "hydro": PRESETS["hydro-scooping"],
            "mjx": PRESETS["mjx-scooping"],
        },
    }


def costs(wanted: tuple[str, ...] = ()) -> Iterator[dict[str, Any]]:
    """A row for each task and engine (of the tasks `wanted`, by default all), as it is measured:
    seconds a trajectory, the visits alone, without what is learned from them and the training of
    task policies; and seconds to compile a visit.
    """
    for task, rows in engines().items():
        for engine, config in rows.items() if not wanted or task in wanted else ():
            yield {"task": task, "engine": engine} | measure(task, config())


def measure(task: str, config: Any) -> dict[str, Any]:
    """`VISITS` visits of Phase 1 as `config` has them, of untrained policies at random means of E
    in random targets.
    """
    import jax

    from adaptsim_jax.space import gaussian
    from adaptsim_jax.tasks.registry import make_task

    made = make_task(task, config.task, "doctor")

    def visit(key):
        policy_key, mean_key, target_key, run_key = jax.random.split(key, 4)
        policy = made.init_policy(policy_key)
        if task == "pendulum":  # whose policies are solved for and not learned
            policy = made.train(
                policy_key, gaussian(made.space, made.space.sample(mean_key)), policy
            )
        target = made.targets.physical(made.targets.sample(target_key))
        seen = (made.rehearse or made.rollout)(run_key, policy, target)
        return made.observe(seen), made.reward(seen, made.reference(target))

    keys = jax.random.split(jax.random.key(0), VISITS)
    begin = time.perf_counter()
    program = jax.jit(jax.vmap(visit)).lower(keys).compile()
    compiled = time.perf_counter()
    jax.block_until_ready(program(keys))  # the first call starts what serves it
    again = time.perf_counter()
    jax.block_until_ready(program(keys))
    each = (time.perf_counter() - again) / VISITS
    return {"s_a_trajectory": each * (config.phase1.horizon + 1), "compile_s": compiled - begin}


def line(row: dict[str, Any]) -> str:
    """A row for a person."""
    name = f"{row['task']} in {row['engine']}"
    return (
        f"cost       {name:20} {1e3 * row['s_a_trajectory']:9.2f} ms a trajectory (compiled in "
        f"{row['compile_s']:.0f} s)"
    )
