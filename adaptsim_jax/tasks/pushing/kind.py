"""The push as the registry holds it."""

from adaptsim_jax.tasks.base import TaskKind
from adaptsim_jax.tasks.pushing.adapt import ADAPT, SYMBOLS
from adaptsim_jax.tasks.pushing.engines import BACKENDS
from adaptsim_jax.tasks.pushing.engines.parity import PARITY
from adaptsim_jax.tasks.pushing.mended import of_model
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.robot import ROBOT
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing

TASK = TaskKind(
    PushingConfig,
    make_pushing,
    make_pushing_one_shot,
    of_model=of_model,
    adapt=ADAPT,
    robot=ROBOT,
    symbols=SYMBOLS,
    backends=BACKENDS,
    parity=PARITY,
)
