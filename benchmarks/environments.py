"""Environment steps a second: the bare environment under `lax.scan`, Phase 1's episodes, PPO, and
targets in MuJoCo C.

    python benchmarks/environments.py                                        our cart-pole
    python benchmarks/environments.py --env playground:CartpoleSwingup --field body:pole_1.mass

Processor time stands beside wall time, because on a busy machine only it can be compared;
compilation is not counted.
"""

import argparse
import time

import jax
import jax.numpy as jnp

from adaptsim_jax.environments.episodes import Play, visit
from adaptsim_jax.environments.peers import load
from adaptsim_jax.environments.policies import Law, acting_of, everywhere
from adaptsim_jax.environments.setting import EnvironmentConfig, setting_of
from adaptsim_jax.environments.task import play_in


def timed(name: str, function, *args, steps: int) -> None:
    """One line: microseconds a step of one environment, after a first call that compiles."""
    begin = time.perf_counter()
    jax.block_until_ready(function(*args))
    first = time.perf_counter() - begin
    wall, cpu = time.perf_counter(), time.process_time()
    jax.block_until_ready(function(*args))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(
        f"{name:34} {1e6 * cpu / steps:8.2f} us cpu {1e6 * wall / steps:8.2f} us wall    first "
        f"call {first:.1f} s",
        flush=True,
    )


def bare(play: Play, steps: int):
    """`(keys [B], values [B, F])`: steps with one action, nothing else."""

    def run(key, values):
        world = play.world(values)

        def step(live, _):
            live = play.step(world, live, jnp.full(play.sim.action_dim, 0.3))
            return live, live.reward

        return jax.lax.scan(step, play.reset(world, key), None, steps)[1].sum()

    return jax.jit(jax.vmap(run))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--env", default="cartpole")
    parser.add_argument(
        "--field", default="", help="a field, moved by a tenth; default: those of the environment"
    )
    parser.add_argument("--together", type=int, default=256)
    args = parser.parse_args()
    env = load(args.env)
    fields = {args.field: [0.05, 0.15]} if args.field else {}
    setting = setting_of(env, EnvironmentConfig(env=args.env, fields=fields, targets={"c": {}}))
    B, T, D = args.together, setting.sim.length, setting.space.dim
    keys = jax.random.split(jax.random.key(0), B)
    u = setting.space.sample(jax.random.key(1), (B,))
    values = setting.space.physical(u)
    timed("bare, under lax.scan", bare(setting.play, T), keys, values, steps=B * T)
    learned = setting.trainer.init(jax.random.key(0))
    acting = acting_of(setting, learned)
    episodes = jax.jit(jax.vmap(lambda k, m, v: visit(k, setting.play, acting, Law(m), v, 1).score))
    timed("episodes as Phase 1 makes them", episodes, keys, u, values, steps=B * T)
    state = setting.trainer.begin(jax.random.key(0), learned)
    rounds = max(1, T // setting.config.training.unroll)

    def train():
        return setting.trainer.train(jax.random.key(1), state, everywhere(setting), rounds)

    size = rounds * setting.config.training.parallel * setting.config.training.unroll
    timed("PPO, updates included", train, steps=size)
    play, own = play_in(setting, setting.targets["c"])
    for count in (8, 64):
        many = jnp.broadcast_to(own[:D], (count, D))
        timed(f"MuJoCo C, {count} at once", bare(play, T), keys[:count], many, steps=count * T)


if __name__ == "__main__":
    main()
