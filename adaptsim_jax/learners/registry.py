"""Learners by name: modules with `init`, `act` and `update` (`bdq.py` is the pattern). Imports no JAX."""

from types import ModuleType

from adaptsim_jax.core.registry import Registry

LEARNERS: Registry[ModuleType] = Registry(
    "learners", {"bdq": "adaptsim_jax.learners.bdq", "naf": "adaptsim_jax.learners.naf"}
)
