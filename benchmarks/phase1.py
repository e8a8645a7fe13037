"""Speed of Phase 1 on the pendulum, side by side in one run; each part alone with its option.

    # 10,000 trajectories of 10 steps, compile included, beside NumPy + PyTorch
    python benchmarks/phase1.py --speed
    # time per seed: one seed, then all of them by lax.map and by vmap
    python benchmarks/phase1.py --seeds 20
    # so many seeds in one program by vmap (for a GPU)
    python benchmarks/phase1.py --together 1 64 512
    # the block-written ring beside flashbax's item buffer, 20 seeds at once
    python benchmarks/phase1.py --replay

CPU seconds stand beside wall seconds, because on a busy machine only they can be compared.
`--speed` needs torch for the peer (`pip install -e .[bench]`); without it only our side is timed.
The persistent compile cache is off, so that compile times are those of a first run.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

BEGIN = time.perf_counter()
os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from adaptsim_jax import make_phase1, make_task  # noqa: E402
from adaptsim_jax.adaptation.training import preset, traced  # noqa: E402
from adaptsim_jax.learners import replay  # noqa: E402

# The release's ratio: 12 updates of batch 64 on 128x128 for every 10 trajectories of 10 steps.
PAPER = preset("paper-pendulum")
SIZES = PAPER.phase1


def timed(function, *args):
    begin, cpu = time.perf_counter(), time.process_time()
    out = jax.block_until_ready(function(*args))
    return time.perf_counter() - begin, time.process_time() - cpu, out


def speed(peer_python: str) -> None:
    phase1 = make_phase1(make_task("pendulum", PAPER.task), SIZES)
    hyper = traced(PAPER.hyper)
    rounds = jnp.arange(SIZES.rounds)
    program = jax.jit(lambda k, h: phase1.run(phase1.init(k), h, rounds)[1])
    jax.block_until_ready(program(jax.random.key(0), hyper))
    whole, whole_cpu = time.perf_counter() - BEGIN, time.process_time()
    warm, cpu, info = timed(program, jax.random.key(1), hyper)
    steps = SIZES.trajectories * SIZES.horizon
    print(f"ours, imports, compile and run: {whole:.1f} s wall, {whole_cpu:.1f} s CPU")
    print(
        f"ours, run again: {warm:.2f} s wall, {cpu:.2f} s CPU, {steps / warm:,.0f} steps/s, "
        f"{steps / cpu:,.0f} a CPU second"
    )
    print(f"  mean reward of the last 10 rounds {float(info.reward[-10:].mean()):.2f}")
    peer = Path(__file__).with_name("phase1_torch.py")
    done = subprocess.run([peer_python, str(peer)], capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"no peer: {done.stderr.strip().splitlines()[-1]}")
        return
    rate, per_cpu = map(float, done.stdout.split())
    print(f"NumPy/SciPy + PyTorch loop: {rate:,.0f} steps/s, {per_cpu:,.0f} a CPU second")
    print(
        f"ratio compiled: {steps / warm / rate:.0f} by wall, {steps / cpu / per_cpu:.0f} by CPU "
        "time"
    )
    print(
        f"ratio with imports and compile: {steps / whole / rate:.0f} by wall, "
        f"{steps / whole_cpu / per_cpu:.0f} by CPU time"
    )


def seeds(count: int) -> None:
    phase1 = make_phase1(make_task("pendulum", PAPER.task), SIZES)
    hyper, rounds = traced(PAPER.hyper), jnp.arange(SIZES.rounds)

    def one(key):
        return phase1.run(phase1.init(key), hyper, rounds)[1].reward.mean()

    keys = jax.random.split(jax.random.key(0), count)
    for name, program, args in [
        ("1 seed", one, keys[0]),
        (f"{count} by lax.map", lambda k: jax.lax.map(one, k), keys),
        (f"{count} by vmap", jax.vmap(one), keys),
    ]:
        program = jax.jit(program).lower(args).compile()
        seconds, cpu, _ = timed(program, args)
        runs = max(args.size, 1)
        print(
            f"{name}: {seconds:.2f} s, {seconds / runs:.2f} s a seed; CPU {cpu / runs:.2f} s a seed"
        )


def together(counts: list[int]) -> None:
    """So many seeds in one program: seconds of compilation and a seed, adaptation steps a second,
    mean reward of the last rounds.
    """
    phase1 = make_phase1(make_task("pendulum", PAPER.task), SIZES)
    hyper, rounds = traced(PAPER.hyper), jnp.arange(SIZES.rounds)

    def one(key):
        return phase1.run(phase1.init(key), hyper, rounds)[1].reward[-10:].mean()

    for count in counts:
        keys = jax.random.split(jax.random.key(0), count)
        begin = time.perf_counter()
        program = jax.jit(jax.vmap(one)).lower(keys).compile()
        compiled = time.perf_counter() - begin
        jax.block_until_ready(program(keys))
        seconds, _, reward = timed(program, keys)
        rate = count * SIZES.trajectories * SIZES.horizon / seconds
        print(
            f"{count} seeds on the {jax.default_backend()}: compiled in {compiled:.1f} s, "
            f"{seconds / count:.4f} s a seed, {rate:,.0f} steps/s, reward "
            f"{float(reward.mean()):.3f}",
            flush=True,
        )


def replays(count: int = 20, rounds: int = 200) -> None:
    """Add a block of 500 transitions and draw 60 batches of 64, `rounds` times."""
    import flashbax

    block = replay.Transition(
        jnp.ones((500, 28)),
        jnp.ones((500, 4), jnp.int32),
        jnp.ones(500),
        jnp.ones((500, 28)),
        jnp.ones(500),
    )
    item = jax.tree.map(lambda x: x[0], block)
    buffer = flashbax.make_item_buffer(10_000, 64, 64, add_batches=True)

    def ours(key):
        def one(ring, n):
            ring = replay.write(ring, block, n)
            drawn = replay.sample(
                jax.random.fold_in(key, n), ring, jnp.minimum((n + 1) * 500, 10_000), (60, 64)
            )
            return ring, drawn.reward.sum()

        return jax.lax.scan(one, replay.empty(item, 10_000), jnp.arange(rounds))[1].sum()

    def flash(key):
        def one(state, n):
            state = buffer.add(state, block)
            draw = jax.random.split(jax.random.fold_in(key, n), 60)
            return state, jax.vmap(lambda k: buffer.sample(state, k).experience.reward.sum())(
                draw
            ).sum()

        return jax.lax.scan(one, buffer.init(item), jnp.arange(rounds))[1].sum()

    keys = jax.random.split(jax.random.key(0), count)
    for name, function in [("block ring", ours), ("flashbax item buffer", flash)]:
        program = jax.jit(jax.vmap(function)).lower(keys).compile()
        seconds, cpu, total = timed(program, keys)
        print(
            f"{name}: {seconds:.2f} s wall, {cpu:.2f} s CPU for {rounds} rounds of {count} seeds "
            f"(check sum {float(total.sum()):.0f})"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--seeds", type=int, metavar="N")
    parser.add_argument("--together", type=int, nargs="+", metavar="N")
    parser.add_argument("--replay", action="store_true")
    parser.add_argument("--peer-python", default=sys.executable, help="a Python that has torch")
    args = parser.parse_args()
    if args.speed:
        speed(args.peer_python)
    if args.seeds:
        seeds(args.seeds)
    if args.together:
        together(args.together)
    if args.replay:
        replays()
