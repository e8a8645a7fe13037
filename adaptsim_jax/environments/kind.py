"""An environment's task as the registry holds it: `env.toml`, or the cart-pole where nothing is
said.
"""

from adaptsim_jax.environments.adapt import ADAPT
from adaptsim_jax.environments.config import EnvironmentConfig
from adaptsim_jax.environments.task import environment_setting, task_of
from adaptsim_jax.tasks.base import Task, TaskKind

# Phase 1 at a fifth of the pendulum's size: a trajectory costs eleven episodes, and eight more that
# scale its reward
TRAIN = {
    "every": 5,
    "phase1": {
        "trajectories": 1000,
        "parallel": 50,
        "horizon": 10,
        "updates": 400,
        "capacity": 10000,
        "archive": 2000,
        "hidden": [64, 64],
        "guided": 0.3,
    },
    "hyper": {"delta": 0.2, "shrink": 0.8, "gain": 2.0},
}


def make_environment(config: EnvironmentConfig) -> Task:
    """The task of `config`; its policy is trained by its `preparation`. BadInput names a field, a
    target or a key at fault.
    """
    return task_of(environment_setting(config))


TASK = TaskKind(EnvironmentConfig, make_environment, train=TRAIN, adapt=ADAPT)
