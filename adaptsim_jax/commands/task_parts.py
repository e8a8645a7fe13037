"""What `adaptsim adapt` and `adaptsim robot` leave to a task: records of functions. What a task may
do without has a default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from adaptsim_jax.core.registry import Registry

HERE = "adaptsim_jax.commands"
ADAPT: Registry[AdaptPart] = Registry(
    "adapt_parts",
    {
        "pushing": f"{HERE}.adapt_pushing:PART",
        "scooping": f"{HERE}.adapt_scooping:PART",
        "environment": f"{HERE}.adapt_environment:PART",
    },
)
ROBOT: Registry[RobotPart] = Registry(
    "robot_parts",
    {
        "pendulum": f"{HERE}.robot_pendulum:PART",
        "pushing": f"{HERE}.robot_pushing:PART",
        "scooping": f"{HERE}.robot_scooping:PART",
    },
)


def _adapted(
    trained: Any, options: dict[str, Any], key: Any, target: Any, starts: int, iterations: int
) -> Any:
    from adaptsim_jax.adaptation.training import adapt_run

    return adapt_run(trained, key, target, starts=starts, iterations=iterations)


@dataclass(frozen=True)
class AdaptPart:
    """Of `adapt`. `options`: the run's, of the task.

    show: draws and films the trials; None where they cannot be looked at. adapt: Phase 2, the
    result's policies and rewards as they are deployed; E's own by default.
    """

    # (trained, options, found, result, out, video) -> lines
    show: Callable[[Any, dict[str, Any], dict[str, Any], Any, Any, bool], list[str]] | None = None
    # (trained, options, key, target [D] physical, starts, iterations) -> Phase2Result
    adapt: Callable[[Any, dict[str, Any], Any, Any, int, int], Any] = _adapted


@dataclass(frozen=True)
class RobotPart:
    """Of `robot`. turn: what one ask and tell is called. `history`: of the turns told so far, as
    `remember` made them.

    deployed: the policy as it is deployed now, mended by what was told; tried: as the coming turn
    makes its trials with it. Both are the policy itself by default. again: a turn that the robot
    could not finish is asked again; else its start is given up, since the policy asked of it would
    fail again.
    """

    turn: str
    opened: Callable[[Any, int], str]  # (session, turns) -> what a new session consists of
    policy_file: Callable[
        [Any, Any], dict[str, Any]
    ]  # (session, policy as deployed) -> what policy.toml holds of it
    show: Callable[
        [Any, Any, Any, list, bool], None
    ]  # (session, state as tried, policy as deployed, history, done)
    read: Callable[[Any, Any, Any], Any]  # (session, state as tried, path) -> trajectory
    # (session, state as tried, trajectory) -> entry of the history beside the score
    remember: Callable[[Any, Any, Any], dict[str, Any]] = lambda session, tried, trajectory: {}
    # (session, state as tried, state after, trajectory, done): what is said beside the return
    told: Callable[[Any, Any, Any, Any, bool], None] = lambda *told: None
    deployed: Callable[[Any, Any, list], Any] = lambda session, policy, history: policy
    tried: Callable[[Any, Any, list], Any] = lambda session, policy, history: policy
    again: bool = True


def adapt_part(task: str) -> AdaptPart:
    """What `adapt` knows of the task called `task`."""
    if task in ADAPT:
        return ADAPT[task]
    return AdaptPart()
