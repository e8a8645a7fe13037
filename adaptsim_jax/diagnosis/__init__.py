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
    from adaptsim_jax.effects.base import Quantity as Quantity
    from adaptsim_jax.effects.base import Traits as Traits
    from adaptsim_jax.effects.registry import catalogue as catalogue
    from adaptsim_jax.effects.registry import effect_named as effect_named
    from adaptsim_jax.logs.log import Log as Log
    from adaptsim_jax.logs.pendulum import read_pendulum as read_pendulum
    from adaptsim_jax.logs.read import read_log as read_log

__all__ = [
    "Criteria",
    "Dry",
    "Effect",
    "Log",
    "Quantity",
    "Traits",
    "catalogue",
    "effect_named",
    "read_log",
    "read_pendulum",
]

__getattr__ = lazily(
    __name__,
    {
        "Criteria": "diagnosis.criteria",
        "Dry": "effects.base",
        "Effect": "effects.base",
        "Quantity": "effects.base",
        "Log": "logs.log",
        "read_log": "logs.read",
        "Traits": "effects.base",
        "catalogue": "effects.registry",
        "effect_named": "effects.registry",
        "read_pendulum": "logs.pendulum",
    },
)


def __dir__() -> list[str]:
    return sorted(__all__)
