"""The pendulum's task as the registry holds it, and what `adaptsim robot` says and reads: a gain,
and one trial a file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.tasks.base import RobotFace, TaskKind
from adaptsim_jax.tasks.one_shot import leaves_by_name
from adaptsim_jax.tasks.pendulum.engines import BACKENDS, PARITY
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession


HOW = (
    "let go hanging straight down (q1 = -pi, zero upright); for 2.5 s, "
    "torque = -gain @ [q1, q2, v1, v2];\n"
    "write a CSV with columns time, q1, q2, tau1, tau2 (v1, v2 where measured) in s, rad, N m"
)


class PendulumRobot(RobotFace):
    """A gain, and one trial a file."""

    again = False

    def policy_file(self, session: RobotSession, policy: Any) -> Table:
        return {"policy": leaves_by_name(policy)}

    def show(self, session: RobotSession, tried: Any, policy: Any, history: list, done: bool):
        """Print the policy, and how to run it while trials are left."""
        for name, value in leaves_by_name(policy).items():
            if value != 0:  # a solver's code of 0 says nothing
                print(f"  {name} = {_digits(value)}")
        if not done:
            print(HOW)

    def read(self, session: RobotSession, tried: Any, path: Path) -> Any:
        """The trajectory of a measured trial."""
        from adaptsim_jax.tasks.pendulum import measured

        table = read_table(path, measured.COLUMNS)
        found = measured.measured_trajectory(
            table.columns,
            str(path),
            session.options.get("observation", "full"),
            lines=table.lines,
            row_word=table.row_word,
        )
        if not session.as_declared:
            measured.check_columns(table.columns, str(path))
        if trials := measured.check_policy(table.columns, tried.policy.gain):
            print(
                f"warning: {trials}: another gain, late, cut off, or angles that froze? if so: "
                "adaptsim robot undo"
            )
        return found


def _digits(value: Any) -> str:
    """Six digits for the eye; policy.toml has them all."""
    if isinstance(value, list):
        return f"[{', '.join(map(_digits, value))}]"
    return f"{value:.6g}"


TASK = TaskKind(
    PendulumConfig,
    make_pendulum,
    robot=PendulumRobot(),
    backends=BACKENDS,
    parity=PARITY,
)
