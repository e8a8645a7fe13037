"""The push on a real robot: which pushes to make, and a camera's record of them as the trajectory
the task observes.

A record has rows of (trial, time s, x m, y m): the number of the push, the time since the arm's
start, and the bottle's place in the arm's base frame. Whatever the task cannot take is refused with
the row.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks import camera_record as record
from adaptsim_jax.tasks.camera_record import Columns, RowName
from adaptsim_jax.tasks.one_shot import read_saved
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.corrections import PushRecord
from adaptsim_jax.tasks.pushing.frame import FRAME, KIND
from adaptsim_jax.tasks.pushing.model import PushOptions
from adaptsim_jax.tasks.pushing.one_shot import make_aims
from adaptsim_jax.tasks.pushing.task import PushingConfig, PushingPolicy, PushingTrajectory
from adaptsim_jax.tasks.robot_trials import AskedTrials, asked_trials, corrected_by
from adaptsim_jax.tasks.trial_record import asked_tracks

COLUMNS = ("trial", "time", "x", "y")
GAP = 0.1  # s; over it a sliding bottle strays some 3 mm from the line between two rows
LATE = 0.1  # s; the plate cannot touch the bottle before 0.2 s
ASIDE = 0.03  # m between where the bottle stood and where the task wants it
_SIMULATOR = (
    "simulator",
    "pretrain",
    "refine",
    "coefficients",
    "friction",
    "duration",
    "mu",
    "e",
    "mu_p",
    "y_p",
    "mended",
)  # options of it
_GOALS = 0x60A15  # tells the goals' keys from those that policies are trained with


def trials_to_make(
    key: jax.Array, turn: Any, policy: PushingPolicy, config: PushingConfig
) -> AskedTrials:
    """The pushes of adaptation iteration `turn` (from 0) of a session with `key`: always the same
    for the same session.
    """
    goals = make_aims(config)(jax.random.fold_in(jax.random.fold_in(key, _GOALS), turn), policy)
    return asked_trials(turn, goals, pushing.make_policy(config)(policy, goals))


def pushes_over_sector(policy: PushingPolicy, config: PushingConfig, count: int) -> AskedTrials:
    """What the policy does for `count` goals spread over the sector."""
    goals = pushing.goal_lattice(count)
    actions = jax.jit(pushing.make_policy(config))(policy, goals)
    return asked_trials(0, goals, actions)


def corrected(
    policy: PushingPolicy, config: PushingConfig, actions: Any, places: Any
) -> PushingPolicy:
    """The policy as it is deployed after pushes `actions [K, 2]` (m/s, rad) whose bottles ended at
    `places [K, 2]` m: corrected by them where the task does that (`correct`), else as it is.
    """
    bounds = (model.ACTION_LOW, model.ACTION_HIGH)
    return corrected_by(policy, config, PushRecord, bounds, actions, places)


def read_policy(path: str | Path) -> Callable[[Any], np.ndarray]:
    """`act(goal [2] or [N, 2] m) -> (speed m/s, angle rad)` from a `best.toml` or `policy.toml` of
    `adaptsim robot`.

    Raises BadInput where the file holds no policy of this task.
    """
    act = read_saved(
        path,
        PushingConfig,
        PushingPolicy,
        pushing.make_pushing_naf,
        pushing.make_policy,
        "the push",
    )
    table = configs.read(path)
    if "simulator" not in table:
        return act
    config = configs.from_table(
        PushingConfig, {**table["simulator"], "hidden": table["hidden"]}, f"{path}: simulator"
    )
    at, weights = table["policy"].get("at"), jnp.asarray(table["policy"]["weights"], jnp.float32)
    if not isinstance(at, list) or np.shape(at) != (pushing.pushing_space(config).dim,):
        raise BadInput(
            f"{path}: the mean of E, policy.at, is missing; write it again with 'adaptsim robot "
            "next'"
        )
    policy = PushingPolicy(weights, at=jnp.asarray(at, jnp.float32))
    if "told" in table:
        policy = corrected(
            policy, replace(config, correct=True), *_table_columns(table["told"], path)
        )
    choose = jax.jit(pushing.make_policy(config))
    return lambda goal: np.asarray(choose(policy, jnp.asarray(goal, jnp.float32)))


def _table_columns(table: Any, path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Actions and places `[K, 2]` of a policy file's table `told`."""
    given = [table.get(name) if isinstance(table, dict) else None for name in ("actions", "places")]
    try:
        actions, places = (np.asarray(column, float).reshape(-1, 2) for column in given)
    except (TypeError, ValueError):
        actions, places = np.zeros((1, 2)), np.zeros((0, 2))
    if actions.shape != places.shape or not np.isfinite([actions, places]).all():
        raise BadInput(
            f"{path}: told: actions and places must be pairs of numbers; write it again with "
            "'adaptsim robot next'"
        )
    return actions, places


def policy_table(policy: PushingPolicy, config: PushingConfig) -> Table:
    """What a file holds of a policy for `read_policy`: its network and, where its actions are
    refined, the simulator at E and the pushes that correct it (m/s, rad, m).
    """
    table: Table = {
        "hidden": list(config.hidden),
        "policy": {"weights": policy.weights.tolist()},
    }
    if config.refine == 0 or policy.at is None:
        return table
    table["policy"]["at"] = policy.at.tolist()
    if policy.told is not None:
        actions = np.asarray(pushing.physical_action(policy.told.actions))
        table["told"] = {"actions": actions.tolist(), "places": policy.told.places.tolist()}
    whole = configs.to_table(config)
    return table | {"simulator": {name: whole[name] for name in _SIMULATOR}}


def measured_trajectory(
    columns: Columns,
    at: RowName,
    where: str,
    pushes: AskedTrials,
    config: PushingConfig,
) -> PushingTrajectory:
    """The trajectory of `pushes` as the task observes and rewards it, from `columns` trial, time,
    x, y of `[T]` each.

    `at(i)` names row i in a message, `where` the file. The bottle's place is interpolated at the
    task's times, the last of them the end of the trial (1.3 s by default), by which the reward
    goes. Raises BadInput.
    """
    needed = (COLUMNS, "s and m")
    trials = asked_tracks(columns, (where, at), pushes.numbers, KIND, needed, 50 * config.duration)
    places = []
    for _, time, track, reported in trials:
        _check_time(time, reported, config)
        _check_track(time, track, reported, config)
        places.append(_resampled(time, track, config))
    return pushing.measured(
        jnp.asarray(pushes.contexts), jnp.asarray(np.stack(places), jnp.float32)
    )


def _resampled(time: np.ndarray, track: np.ndarray, config: PushingConfig) -> np.ndarray:
    """`[T, 2]`: the track at the times of a simulated one."""
    options = PushOptions(duration=config.duration)
    grid = options.row * np.arange(1, model.rows(options) + 1)
    return np.stack([np.interp(grid, time, track[:, k]) for k in range(2)], 1)


def _check_time(time: np.ndarray, reported: RowName, config: PushingConfig) -> None:
    """From the arm's start to the end of the trial, in s."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    last = config.duration - min(1.5 * step, GAP / 2) - 1e-6
    if time[-1] < last:
        raise BadInput(
            f"{reported(-1)}: ends at {time[-1]:.4g} s; record it for {config.duration:g} s from "
            "the arm's start"
        )
    if config.observation == "final":  # one row at the end serves
        if not np.any((time >= last) & (time <= config.duration + GAP)):
            raise BadInput(
                f"{reported(-1)}: no row at {config.duration:g} s; give where the bottle was then"
            )
        return
    if time[0] > LATE:
        start = "the arm's start as time 0"
        raise BadInput(
            f"{reported(0)}: begins at {time[0]:.9g} s; record from {start}, or subtract that time"
        )
    record.check_gaps(time, GAP, config.duration, reported, "make that push again")


def _check_track(
    time: np.ndarray, track: np.ndarray, reported: RowName, config: PushingConfig
) -> None:
    """A bottle that stood where it should, then moved, and never jumped."""
    if config.observation == "final" and time[0] > LATE:
        return
    aside = float(np.linalg.norm(track[0] - np.array(model.START)))
    if aside > ASIDE:
        x, y = track[0]
        raise BadInput(
            f"{reported(0)}: the bottle stands at ({x:.3g}, {y:.3g}) m, {100 * aside:.0f} cm from "
            f"{model.START}, where the task starts: mend the frame (the arm's base), the unit, or "
            "the start"
        )
    record.check_leaps(time, track, reported, KIND.body, KIND.fastest, KIND.slip)
    if np.linalg.norm(track - track[0], axis=1).max() < FRAME.still:
        raise BadInput(
            f"{reported(-1)}: the bottle never moved; make that push again, or mend the tracking"
        )
