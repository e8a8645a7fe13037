"""How far trainings of the same policy lie apart: returns at points of Omega of the policy that is
deployed, for each way and seed.

    python experiments/training_luck.py --task cartpole --seeds 100,101,102 --set \\
        hyper.entropy=0.001

Ways: `udr` is told nothing, `knows` E from the start, `blind` E from the middle of training on (as
`adaptsim train` does), `nominal` is trained at the file's own values. Seeds below 10 are the
benchmark's, and choose nothing.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.core import config as configs
from adaptsim_jax.environments.course import TrainingPlan, trained_in
from adaptsim_jax.environments.episodes import visit
from adaptsim_jax.environments.policies import Tuned, everywhere, network_acting
from adaptsim_jax.environments.setting import BLIND, EnvironmentConfig, Setting
from adaptsim_jax.environments.task import environment_setting
from adaptsim_jax.environments.trainer import Worlds
from experiments.return_against_trials import options_of

POINTS, NOMINAL = 64, 16


def scorer(setting: Setting, own: jax.Array):
    """`(actor, known) -> [POINTS + NOMINAL]` returns without exploration: at points of Omega, then
    at `own`, the file's values.
    """
    D, acting = setting.space.dim, network_acting(setting)
    spread = jnp.asarray(qmc.Sobol(D, rng=5).random(POINTS), jnp.float32)
    u = jnp.concatenate([spread, jnp.broadcast_to(own, (NOMINAL, D))])

    def one(key, u, actor, known):
        policy = Tuned(jnp.where(known > 0, u, 0.5), actor)
        return visit(key, setting.play, acting, policy, setting.space.physical(u), 1).score

    keys = jax.random.split(jax.random.key(777), len(u))
    return jax.jit(lambda actor, known: jax.vmap(one, (0, 0, None, None))(keys, u, actor, known))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="cartpole")
    parser.add_argument("--ways", default="udr,knows,blind")
    parser.add_argument("--seeds", default="100,101,102")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="of [training]"
    )
    args = parser.parse_args()
    config = configs.from_table(EnvironmentConfig, options_of(args.task, small=True), args.task)
    setting = environment_setting(
        configs.with_settings(config, [f"training.{word}" for word in args.set])
    )
    nominal = jnp.asarray([f.nominal for f in setting.fields[: setting.space.dim]], jnp.float32)
    own = setting.space.unit(nominal)
    score = scorer(setting, own)
    ways = {
        "udr": (everywhere(setting, known=False), 0.0),
        "knows": (everywhere(setting), 0.0),
        "blind": (everywhere(setting), BLIND),
        "nominal": (Worlds(own, own, jnp.zeros(()), jnp.zeros(0)), 0.0),
    }
    print("way      seed  over Omega  worst tenth  at the file's values  processor time")
    for way in args.ways.split(","):
        worlds, blind = ways[configs.pick("way", way, ways)]
        for seed in map(int, args.seeds.split(",")):
            begin = time.process_time()
            init_key, key = jax.random.split(jax.random.key(seed))
            learned = trained_in(
                setting.trainer,
                key,
                setting.trainer.init(init_key),
                worlds,
                TrainingPlan(setting.config.training.rounds, blind),
            )
            found = np.asarray(score(setting.trainer.policy(learned), worlds.known))
            omega, at = np.sort(found[:POINTS]), found[POINTS:]
            spent, lost = time.process_time() - begin, int(np.isnan(omega).sum())
            print(
                f"{way:8} {seed:4} {np.nanmean(omega):11.1f} {omega[: POINTS // 10].mean():12.1f} "
                f"{at.mean():21.1f} {spent:13.0f} s"
                + (f"  ({lost} of {POINTS} worlds blow up)" if lost else ""),
                flush=True,
            )


if __name__ == "__main__":
    main()
