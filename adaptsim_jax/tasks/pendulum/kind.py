"""The pendulum's task as the registry holds it, and what `adaptsim robot` says and reads: a gain or
a controller, and one trial a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.mend.pendulum_model import model_of
from adaptsim_jax.tasks.base import RobotFace, Task, TaskKind
from adaptsim_jax.tasks.one_shot import leaves_by_name
from adaptsim_jax.tasks.pendulum.augmented import make_mended_pendulum
from adaptsim_jax.tasks.pendulum.engines import BACKENDS, PARITY
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, make_pendulum

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession


def augmented(options: Table, where: str) -> Task:
    """The task on a mended model, whose table stands under `model`; `reward_gain` may stand beside
    it.
    """
    given, reward_gain = options.pop("model"), options.pop("reward_gain", 10.0)
    if options:
        raise BadInput(
            f"{where}: unknown key '{next(iter(options))}'; with a mended model there is: "
            "reward_gain"
        )
    if not isinstance(given, Mapping) or given.get("task") != "pendulum":
        raise BadInput(
            f"{where}: 'model' is no mended model of task 'pendulum'; use `adaptsim train pendulum "
            "--model FILE`"
        )
    gain = finite(reward_gain)
    if gain is None or gain <= 0:
        raise BadInput(
            f"{where}: reward_gain = {brief(reward_gain)} must be a positive number; leave it out "
            "for 10"
        )
    return make_mended_pendulum(model_of(given, f"{where}, model"), gain)


def of_model(table: Table, where: str) -> Table:
    """The option `model`: the checked file, less what is only for people."""
    model_of(table, where)
    return {
        "model": {
            key: value for key, value in table.items() if key not in ("covariance", "provenance")
        }
    }


HOW = (
    "let go hanging straight down (q1 = -pi, zero upright); for 2.5 s, {law}\n"
    "write a CSV with columns time, q1, q2, tau1, tau2 (v1, v2 where measured) in s, rad, N m"
)
GAIN = "torque = -gain @ [q1, q2, v1, v2];"
CONTROLLER = """every 5 ms, the torque that this policy's controller says (it is more than its gain):
  from adaptsim_jax.tasks.pendulum.controller import read_controller
  controller = read_controller({folder!r})
  torque = controller([q1, q2, v1, v2], t)   # rad with zero upright, rad/s, s since the start; N m"""  # noqa: E501


class PendulumRobot(RobotFace):
    """A gain or a controller, and one trial a file."""

    again = False

    def policy_file(self, session: RobotSession, policy: Any) -> Table:
        return {"policy": leaves_by_name(policy)}

    def show(self, session: RobotSession, tried: Any, policy: Any, history: list, done: bool):
        """Print the policy, and how to run it while trials are left. A mended model's controller
        needs the model beside it.
        """
        model = session.options.get("model")
        for name, value in leaves_by_name(policy).items():
            # a solver's code of 0 says nothing; the rest of a mended policy is for its controller,
            # not for people
            if name == "gain" or (model is None and value != 0):
                print(f"  {name} = {_digits(value)}")
        if done:
            return
        if model is None:
            print(HOW.format(law=GAIN))
        else:
            config.write(session.folder / "model.toml", model)
            print(HOW.format(law=CONTROLLER.format(folder=str(session.folder))))

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
        if session.options.get("model") is None and (
            trials := measured.check_policy(table.columns, tried.policy.gain)
        ):
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
    augmented=augmented,
    of_model=of_model,
    robot=PendulumRobot(),
    backends=BACKENDS,
    parity=PARITY,
)
