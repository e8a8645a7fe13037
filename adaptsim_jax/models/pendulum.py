"""Double pendulum: the linearized model of the paper's task, and the full rigid-body model."""

from adaptsim_jax.models.pendulum_linear import (
    LATE_SNAPSHOTS,
    SNAPSHOTS,
    LinearRollout,
    linear_rollout,
    linear_trajectory,
    linearized,
    optimal_gain,
    rollout,
    rollout_message,
)

__all__ = [
    "LATE_SNAPSHOTS",
    "SNAPSHOTS",
    "LinearRollout",
    "linear_rollout",
    "linear_trajectory",
    "linearized",
    "optimal_gain",
    "rollout",
    "rollout_message",
]
