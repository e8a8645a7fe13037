"""Task-driven simulation adaptation (AdaptSim) and closing the loop with measured data, in JAX.

`__all__` here and in `adaptsim_jax.diagnosis` is what other programs may rely on; all else may
change. A name is imported when it is asked for: importing the package loads neither JAX nor NumPy.
"""

from typing import TYPE_CHECKING

from adaptsim_jax.core.lazy import lazily

if TYPE_CHECKING:
    from adaptsim_jax.adaptation.asktell import Session as Session
    from adaptsim_jax.adaptation.host import HostSession as HostSession
    from adaptsim_jax.adaptation.host import HostSimulation as HostSimulation
    from adaptsim_jax.adaptation.host import train_host as train_host
    from adaptsim_jax.adaptation.phase1 import make_phase1 as make_phase1
    from adaptsim_jax.adaptation.phase1_config import Phase1Config as Phase1Config
    from adaptsim_jax.adaptation.phase1_config import Phase1Hyper as Phase1Hyper
    from adaptsim_jax.adaptation.sweep_run import sweep as sweep
    from adaptsim_jax.adaptation.training import TrainConfig as TrainConfig
    from adaptsim_jax.adaptation.training import Trained as Trained
    from adaptsim_jax.adaptation.training import adapt_run as adapt_run
    from adaptsim_jax.adaptation.training import default_config as default_config
    from adaptsim_jax.attribution.replay import replay_files as replay_files
    from adaptsim_jax.baselines.compare import compare as compare
    from adaptsim_jax.baselines.config import default_comparison as default_comparison
    from adaptsim_jax.commands.diagnose import diagnose as diagnose
    from adaptsim_jax.core.errors import BadInput as BadInput
    from adaptsim_jax.diagnosis.simulated import diagnose_simulator as diagnose_simulator
    from adaptsim_jax.diagnosis.simulator import Channel as Channel
    from adaptsim_jax.diagnosis.simulator import Simulator as Simulator
    from adaptsim_jax.diagnosis.simulator import Stretches as Stretches
    from adaptsim_jax.effects.base import Effect as Effect
    from adaptsim_jax.effects.base import Quantity as Quantity
    from adaptsim_jax.environments.task import environment_task as environment_task
    from adaptsim_jax.space import Gaussian as Gaussian
    from adaptsim_jax.space import Parameter as Parameter
    from adaptsim_jax.space import Space as Space
    from adaptsim_jax.space import gaussian as gaussian
    from adaptsim_jax.tasks.base import Task as Task
    from adaptsim_jax.tasks.base import TaskKind as TaskKind
    from adaptsim_jax.tasks.engine import EngineKind as EngineKind
    from adaptsim_jax.tasks.registry import make_backend as make_backend
    from adaptsim_jax.tasks.registry import make_one_shot as make_one_shot
    from adaptsim_jax.tasks.registry import make_task as make_task

__version__ = "0.3.0"
__all__ = [
    "BadInput",
    "Channel",
    "Effect",
    "EngineKind",
    "Gaussian",
    "HostSession",
    "HostSimulation",
    "Parameter",
    "Phase1Config",
    "Phase1Hyper",
    "Quantity",
    "Session",
    "Simulator",
    "Space",
    "Stretches",
    "Task",
    "TaskKind",
    "TrainConfig",
    "Trained",
    "adapt_run",
    "compare",
    "default_comparison",
    "default_config",
    "diagnose",
    "diagnose_simulator",
    "environment_task",
    "gaussian",
    "make_backend",
    "make_one_shot",
    "make_phase1",
    "make_task",
    "replay_files",
    "sweep",
    "train_host",
]

__getattr__ = lazily(
    __name__,
    {
        "BadInput": "core.errors",
        "Channel": "diagnosis.simulator",
        "Quantity": "effects.base",
        "Simulator": "diagnosis.simulator",
        "Stretches": "diagnosis.simulator",
        "diagnose_simulator": "diagnosis.simulated",
        "Effect": "effects.base",
        "EngineKind": "tasks.engine",
        "Gaussian": "space",
        "HostSession": "adaptation.host",
        "HostSimulation": "adaptation.host",
        "Parameter": "space",
        "Phase1Config": "adaptation.phase1_config",
        "Phase1Hyper": "adaptation.phase1_config",
        "Session": "adaptation.asktell",
        "Space": "space",
        "Task": "tasks.base",
        "TaskKind": "tasks.base",
        "TrainConfig": "adaptation.training",
        "Trained": "adaptation.training",
        "adapt_run": "adaptation.training",
        "compare": "baselines.compare",
        "default_comparison": "baselines.config",
        "default_config": "adaptation.training",
        "diagnose": "commands.diagnose",
        "environment_task": "environments.task",
        "gaussian": "space",
        "make_backend": "tasks.registry",
        "make_one_shot": "tasks.registry",
        "make_phase1": "adaptation.phase1",
        "make_task": "tasks.registry",
        "replay_files": "attribution.replay",
        "sweep": "adaptation.sweep_run",
        "train_host": "adaptation.host",
    },
)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
