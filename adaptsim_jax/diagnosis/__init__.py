"""What a machine does, from recordings, and what its model lacks.

`__all__` is what other programs may rely on. `adaptsim_jax.diagnose` is the whole of it, with the
page and the mended model.
"""

from typing import TYPE_CHECKING

from adaptsim_jax.core.lazy import lazily

if TYPE_CHECKING:
    from adaptsim_jax.diagnosis.criteria import Criteria as Criteria
    from adaptsim_jax.effects.base import Dry as Dry
    from adaptsim_jax.effects.base import Effect as Effect
    from adaptsim_jax.effects.base import Parameter as Parameter
    from adaptsim_jax.effects.base import Relaxation as Relaxation
    from adaptsim_jax.effects.registry import catalogue as catalogue
    from adaptsim_jax.effects.registry import effect_named as effect_named
    from adaptsim_jax.logs.recording import read_recording as read_recording
    from adaptsim_jax.logs.types import Recording as Recording
    from adaptsim_jax.mechanisms.plant import Plant as Plant
    from adaptsim_jax.mechanisms.registry import make_plant as make_plant
    from adaptsim_jax.mend.pendulum_model import ModelFile as ModelFile
    from adaptsim_jax.mend.pendulum_model import read_model as read_model
    from adaptsim_jax.mend.pendulum_model import write_model as write_model

__all__ = [
    "Criteria",
    "Dry",
    "Effect",
    "ModelFile",
    "Parameter",
    "Plant",
    "Recording",
    "Relaxation",
    "catalogue",
    "effect_named",
    "make_plant",
    "read_model",
    "read_recording",
    "write_model",
]

__getattr__ = lazily(
    __name__,
    {
        "Criteria": "diagnosis.criteria",
        "Dry": "effects.base",
        "Effect": "effects.base",
        "ModelFile": "mend.pendulum_model",
        "Parameter": "effects.base",
        "Plant": "mechanisms.plant",
        "Recording": "logs.types",
        "Relaxation": "effects.base",
        "catalogue": "effects.registry",
        "effect_named": "effects.registry",
        "make_plant": "mechanisms.registry",
        "read_model": "mend.pendulum_model",
        "read_recording": "logs.recording",
        "write_model": "mend.pendulum_model",
    },
)


def __dir__() -> list[str]:
    return sorted(__all__)
