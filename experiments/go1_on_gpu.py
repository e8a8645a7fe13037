"""4,096 environments of Playground's Go1 joystick on one GPU: steps a second, and a policy that
knows E, in ten minutes.

    # a GPU; extra [environments]
    python experiments/go1_on_gpu.py --out runs/go1
    # anywhere
    python experiments/go1_on_gpu.py --out runs/try --env cartpole --parallel 16 --minutes 0.2 \\
        --unroll 10

Fields: the floor's friction, a payload on the trunk, kp of all twelve servos, and a delay. Written:
`result.json`, anew after every few updates, so that a run that is cut off has left what it
measured. Playground fetches
Go1's meshes when it is first loaded.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.core.process import enable_cache
from adaptsim_jax.environments.episodes import visit
from adaptsim_jax.environments.peers import load
from adaptsim_jax.environments.policies import Law, acting_of, everywhere
from adaptsim_jax.environments.setting import EnvironmentConfig, Setting, setting_of
from adaptsim_jax.environments.trainer import PPOTraining
from adaptsim_jax.learners.ppo import PPOHyper

GO1 = "playground:Go1JoystickFlatTerrain"
FIELDS = {
    "geom:floor.friction[0]": [0.3, 1.2],
    "body:trunk.mass": [4.0, 9.0],
    "actuator:*.gain": [25.0, 45.0],
    "delay": [0.0, 0.04],
}
TOLD = 5  # updates between two lines


def setting_for(args: argparse.Namespace) -> Setting:
    hidden = (512, 256, 128) if args.env == GO1 else (64, 64)
    training = PPOTraining(
        steps=args.steps,
        parallel=args.parallel,
        unroll=args.unroll,
        hidden=hidden,
        activation="silu",
        minibatches=16,
        hyper=PPOHyper(learning_rate=3e-4, discount=0.97, entropy=1e-2),
    )
    fields = FIELDS if args.env == GO1 else {}
    return setting_of(
        load(args.env),
        EnvironmentConfig(env=args.env, fields=fields, training=training),
        where=args.env,
    )


def bare(setting: Setting, parallel: int, steps: int) -> float:
    """Steps a second of the environments alone, random fields, one action; compilation not
    counted.
    """
    play, space = setting.play, setting.space

    @jax.jit
    @jax.vmap
    def run(key, values):
        world = play.world(values)

        def step(live, _):
            return (play.step(world, live, jnp.zeros(play.sim.action_dim)), None)

        return jax.lax.scan(step, play.reset(world, key), None, steps)[0].reward

    values = space.physical(space.sample(jax.random.key(1), (parallel,)))
    keys = jax.random.split(jax.random.key(0), parallel)
    jax.block_until_ready(run(keys, values))
    begin = time.perf_counter()
    jax.block_until_ready(run(keys, values))
    return parallel * steps / (time.perf_counter() - begin)


def evaluated(setting: Setting, learned: Any, count: int) -> dict[str, float]:
    """Mean return over Omega of the policy that is told E's mean rightly, and told the middle of
    Omega.
    """
    acting = acting_of(setting, learned)
    u = jnp.asarray(qmc.Sobol(setting.space.dim, rng=0).random(count), jnp.float32)

    @jax.jit
    @jax.vmap
    def run(key, mean, u):
        return visit(key, setting.play, acting, Law(mean), setting.space.physical(u), 1).score

    keys = jax.random.split(jax.random.key(7), count)
    every = {"told": u, "not_told": jnp.full_like(u, 0.5)}
    return {name: float(np.nanmean(run(keys, mean, u))) for name, mean in every.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--env", default=GO1)
    parser.add_argument("--parallel", type=int, default=4096)
    parser.add_argument("--unroll", type=int, default=20)
    parser.add_argument("--steps", type=int, default=100_000_000, help="of PPO in all")
    parser.add_argument(
        "--minutes", type=float, default=6.0, help="of PPO, compilation not counted; it ends there"
    )
    parser.add_argument("--tests", type=int, default=256, help="episodes that score the policy")
    args = parser.parse_args()
    enable_cache()
    output_folder(args.out)
    setting = setting_for(args)
    found: dict[str, Any] = {
        "env": args.env,
        "device": jax.devices()[0].device_kind,
        "parallel": args.parallel,
    }
    found["bare_steps_per_second"] = bare(setting, args.parallel, args.unroll)
    print(
        f"{found['device']}: {found['bare_steps_per_second']:.3g} steps/s of {args.parallel} "
        "environments",
        flush=True,
    )
    trainer, worlds = setting.trainer, everywhere(setting)
    state = trainer.begin(jax.random.key(1), trainer.init(jax.random.key(0)))
    jax.block_until_ready(trainer.train(jax.random.key(2), state, worlds, TOLD)[0])  # compiles
    begin, done, rows = time.perf_counter(), 0, []
    while done < setting.config.training.rounds and time.perf_counter() - begin < 60 * args.minutes:
        state, info = trainer.train(jax.random.key(2), state, worlds, TOLD)
        jax.block_until_ready(state)
        done += TOLD
        spent, steps = time.perf_counter() - begin, done * args.parallel * args.unroll
        episodes = np.asarray(info.episode)
        rows.append(
            [steps, spent, float(np.nanmean(episodes)) if np.isfinite(episodes).any() else None]
        )
        found |= {"ppo_steps_per_second": steps / spent, "steps_seconds_return": rows}
        write_json(args.out / "result.json", found)
        print(
            f"{steps:>12,} steps  {spent:7.1f} s  {steps / spent:.3g} steps/s  return "
            f"{rows[-1][2]}",
            flush=True,
        )
    found["return"] = evaluated(setting, trainer.learned(state), args.tests)
    write_json(args.out / "result.json", found)
    print(
        f"return over Omega: told E {found['return']['told']:.4g}, not told "
        f"{found['return']['not_told']:.4g}"
    )
    print(f"written: {args.out / 'result.json'}")


if __name__ == "__main__":
    main()
