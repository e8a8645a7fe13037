"""NAF policies updated together against a PyTorch NAF looped over them, side by side in one run.

    python benchmarks/naf.py                                  256 policies of 64 x 64, batches of 64
    python benchmarks/naf.py --policies 64 --width 128 --peer-python /path/to/python

Ours and the peer take turns, `--turns` times, so that other load on the machine meets both; ratios
are of medians over turns. CPU seconds stand beside wall seconds. The peer needs torch (`pip install
-e .[bench]`); without it only ours is timed.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.learners.naf import NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.replay import Transition

ROUNDS = 100


def compiled(policies: int, batch: int, width: int):
    """`run() -> (updates/s by wall, by CPU)` of `ROUNDS` joint updates; and the seconds that
    compiling took.
    """
    naf = make_naf(NAFConfig(obs_dim=2, action_dim=2, hidden=(width, width)))
    state = jax.jit(jax.vmap(naf.init))(jax.random.split(jax.random.key(0), policies))
    rng = np.random.default_rng(0)
    shape = (ROUNDS, policies, batch)
    obs, action = rng.normal(size=(*shape, 2)), rng.uniform(-1.0, 1.0, (*shape, 2))
    rows = (obs, action, rng.uniform(size=shape), np.zeros((*shape, 0)), np.zeros(shape))
    batches = Transition(*(jnp.asarray(x, jnp.float32) for x in rows))
    together = jax.vmap(naf.update, in_axes=(0, 0, None))

    def all_rounds(state, batches, hyper):
        return jax.lax.scan(lambda s, b: together(s, b, hyper), state, batches)

    begin = time.perf_counter()
    hyper = jax.tree.map(jnp.float32, NAFHyper())
    program = jax.jit(all_rounds).lower(state, batches, hyper).compile()
    took = time.perf_counter() - begin

    def run():
        begin, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(program(state, batches, hyper))
        done = ROUNDS * policies
        return done / (time.perf_counter() - begin), done / (time.process_time() - cpu)

    run()
    return run, took


def peer(args) -> tuple[float, float] | None:
    script = Path(__file__).with_name("naf_torch.py")
    sizes = [
        "--policies",
        args.policies,
        "--batch",
        args.batch,
        "--width",
        args.width,
        "--threads",
        args.threads,
    ]
    command = [args.peer_python, str(script), *map(str, sizes)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"no peer: {done.stderr.strip().splitlines()[-1]}")
        return None
    wall, cpu = map(float, done.stdout.split())
    return wall, cpu


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in {
        "policies": 256,
        "batch": 64,
        "width": 64,
        "turns": 5,
        "threads": 1,
    }.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--peer-python", default=sys.executable, help="a Python that has torch")
    args = parser.parse_args()
    run, took = compiled(args.policies, args.batch, args.width)
    print(
        f"{args.policies} policies, {args.width} x {args.width}, batch {args.batch}; compiled in "
        f"{took:.1f} s"
    )
    ours, theirs = [], []
    for turn in range(args.turns):
        ours.append(run())
        theirs.append(peer(args))
        if theirs[-1] is None:
            break
        print(f"turn {turn + 1}: ours {ours[-1][0]:,.0f} updates/s, peer {theirs[-1][0]:,.0f}")
    wall, cpu = np.median(ours, axis=0)
    print(f"ours, together: {wall:,.0f} updates/s by wall, {cpu:,.0f} a CPU second")
    if theirs[-1] is not None:
        peer_wall, peer_cpu = np.median(np.asarray(theirs), axis=0)
        print(
            f"PyTorch, in a loop: {peer_wall:,.0f} updates/s by wall, {peer_cpu:,.0f} a CPU second"
        )
        print(f"ratio: {wall / peer_wall:.1f} by wall, {cpu / peer_cpu:.1f} by CPU time")


if __name__ == "__main__":
    main()
