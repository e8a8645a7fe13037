"""Phase 1 of the push in the MuJoCo scene at a reduced size: natively in processes of its own, and
in MJX within the program.

    python benchmarks/phase1_engines.py                 40 trajectories, both engines, one seed
    # trials a second of each engine by batch size (GPUs: up to 16,384)
    python benchmarks/phase1_engines.py --trials

Seconds with and without compile, trials and rewards of the last round. The engines step the same
scene with the same seed, so that rewards differ by float32 and by what chance makes of it.
"""

import argparse
import json
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import make_phase1, make_task
from adaptsim_jax.adaptation.training import preset, traced
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.config import PushingConfig
from adaptsim_jax.tasks.pushing.trial import make_simulator


def phase1(engine: str, trajectories: int = 40, seed: int = 0) -> dict:
    """Phase 1 as `preset("native-pushing")` but for its sizes: seconds and rewards."""
    config = preset("native-pushing")
    options = config.task | {"simulator": engine, "shared": {"contexts": 50, "trials": 32}}
    parallel = trajectories // 2
    reuse = replace(config.phase1.reuse, capacity=parallel, together=parallel)
    sizes = replace(
        config.phase1,
        trajectories=trajectories,
        parallel=parallel,
        updates=100,
        capacity=2 * parallel * 8,
        archive=2 * parallel * 8,
        reuse=reuse,
    )
    run = make_phase1(make_task("pushing", options), sizes)
    hyper, key = traced(config.hyper), jax.random.key(seed)
    begin = time.perf_counter()
    init = jax.jit(run.init).lower(key).compile()
    rounds = (
        jax.jit(run.run)
        .lower(jax.eval_shape(run.init, key), hyper, jnp.arange(sizes.rounds))
        .compile()
    )
    compiled = time.perf_counter()
    state = jax.block_until_ready(init(key))
    made = time.perf_counter()
    _, info = jax.block_until_ready(rounds(state, hyper, jnp.arange(sizes.rounds)))
    done = time.perf_counter()
    return {
        "engine": engine,
        "trajectories": trajectories,
        "compile_s": compiled - begin,
        "policy_s": made - compiled,
        "phase1_s": done - made,
        "s_a_trajectory": (done - made) / trajectories,
        "reward_by_round": np.asarray(info.reward).round(4).tolist(),
        "final_reward": round(float(info.final_reward[-1]), 4),
    }


def rates(engine: str, batches: list[int]) -> list[dict]:
    """Pushes a second of `make_simulator` by batch size, compiled, without the first call."""
    push = jax.jit(jax.vmap(make_simulator(PushingConfig(simulator=engine))))
    found = []
    for count in batches:
        params, actions, _ = model.draw(0, count)
        args = jnp.asarray(params, jnp.float32), jnp.asarray(actions, jnp.float32)
        jax.block_until_ready(push(*args))
        begin = time.perf_counter()
        jax.block_until_ready(push(*args))
        found.append(
            {
                "engine": engine,
                "batch": count,
                "trials_a_second": count / (time.perf_counter() - begin),
            }
        )
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", action="store_true")
    parser.add_argument("--trajectories", type=int, default=40, metavar="N")
    args = parser.parse_args()
    gpu = jax.default_backend() == "gpu"
    for name in ("native", "mjx"):
        for row in (
            rates(name, [64, 256] + gpu * [1024, 4096, 16384])
            if args.trials
            else [phase1(name, args.trajectories)]
        ):
            print(json.dumps(row), flush=True)
