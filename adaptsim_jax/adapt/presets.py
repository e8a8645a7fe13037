"""Configurations by name. The defaults of the config classes are the recommended ones; here are the others."""

from adaptsim_jax.adapt.phase1 import Phase1Config, Phase1Hyper
from adaptsim_jax.adapt.training import TrainConfig
from adaptsim_jax.learners.bdq import BDQHyper


def paper_pendulum() -> TrainConfig:
    """The pendulum as the paper trains it (tables A1 and A2, section A2) where it says, and as the release does elsewhere.

    Targets within Omega, sparse reward with threshold 0.95, horizon 10, discount 0.9, a return that ends at the horizon,
    observations as they are; 12 updates of batch 64 for every 10 trajectories, 10,000 trajectories (which is how the
    release reads K = 1e4), epsilon from 1 to 0.1.
    """
    return TrainConfig(
        task={"scaling": "paper", "reference": "optimum", "targets": "omega"},
        phase1=Phase1Config(trajectories=10_000, parallel=50, updates=60, capacity=10_000),
        hyper=Phase1Hyper(
            learner=BDQHyper(learning_rate=3e-4, discount=0.9, tau=0.01),
            threshold=0.95,
            gain=1.0,
            soft=0.0,
            epsilon_share=0.75,
            rate_end=1.0,
            independent=0.0,
            inside=1.0,
            terminal=1.0,
        ),
    )


PRESETS = {"paper-pendulum": paper_pendulum}
