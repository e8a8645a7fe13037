"""Scooping as the registry holds it."""

from adaptsim_jax.tasks.base import TaskKind
from adaptsim_jax.tasks.scooping.adapt import ADAPT, SYMBOLS
from adaptsim_jax.tasks.scooping.engines import BACKENDS
from adaptsim_jax.tasks.scooping.engines.parity import PARITY
from adaptsim_jax.tasks.scooping.one_shot import make_scooping_one_shot
from adaptsim_jax.tasks.scooping.robot import ROBOT
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, make_scooping

TASK = TaskKind(
    ScoopingConfig,
    make_scooping,
    make_scooping_one_shot,
    adapt=ADAPT,
    robot=ROBOT,
    symbols=SYMBOLS,
    backends=BACKENDS,
    parity=PARITY,
)
