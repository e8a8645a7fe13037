"""Scooping on a real robot: which scoops to make, and a camera's record of them as the trajectory
the task observes.

A record has rows of (trial, time s, x m, y m, on): the number of the scoop, the time since the
arm's start, and the piece's place on the table with x along the spatula's way. The last number is
1 where it lies on the spatula, else 0. It counts in a trial's last row. Whatever the task cannot
take is refused with the row.
"""

from collections.abc import Callable
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
from adaptsim_jax.tasks.robot_trials import AskedTrials, asked_trials, corrected_by
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.config import ScoopingConfig, ScoopingPolicy, ScoopingTrajectory
from adaptsim_jax.tasks.scooping.corrections import ScoopRecord
from adaptsim_jax.tasks.scooping.motion import KIND
from adaptsim_jax.tasks.trial_record import asked_tracks

COLUMNS = ("trial", "time", "x", "y", "on")
GAP = 0.1  # s without a row that can be filled
LATE = 0.2  # s; the spatula cannot touch the piece before
_PLACES = 0x5C00  # tells the places' keys from those that policies are trained with


def trials_to_make(
    key: jax.Array, turn: Any, policy: ScoopingPolicy, config: ScoopingConfig
) -> AskedTrials:
    """The scoops of adaptation iteration `turn` (from 0) of a session with `key`: always the same
    for the same session.
    """
    keys = jax.random.split(
        jax.random.fold_in(jax.random.fold_in(key, _PLACES), turn), config.trajectories
    )
    places = jax.vmap(scooping.draw_context)(keys)[:, :2]
    return asked_trials(turn, places, scooping.make_policy(config)(policy, places))


def corrected(
    policy: ScoopingPolicy, config: ScoopingConfig, actions: Any, won: Any
) -> ScoopingPolicy:
    """The policy as it is deployed after scoops `actions [K, 3]` (rad, rad/s, m) of which `won [K]`
    (1 or 0) succeeded: corrected by them where the task does that (`correct`), else as it is.
    """
    bounds = (model.ACTION_LOW, model.ACTION_HIGH)
    return corrected_by(policy, config, ScoopRecord, bounds, actions, won)


def policy_table(policy: ScoopingPolicy, config: ScoopingConfig) -> Table:
    """What a file holds of a policy for `read_policy`: its network and, where it is corrected, the
    scoop that it makes wherever the piece lies (rad, rad/s, m).
    """
    table: Table = {
        "hidden": list(config.hidden),
        "policy": {"weights": policy.weights.tolist()},
    }
    if policy.told is not None:
        table["policy"]["corrected"] = scoop_in_the_middle(policy, config).astype(float).tolist()
    return table


def scoop_in_the_middle(policy: ScoopingPolicy, config: ScoopingConfig) -> np.ndarray:
    """`[3]` rad, rad/s, m: what the policy does for a piece in the middle of the box of places."""
    return np.asarray(jax.jit(scooping.make_policy(config))(policy, jnp.zeros(2)))


def read_policy(path: str | Path) -> Callable[[Any], np.ndarray]:
    """`act(place [2] or [N, 2] m) -> (pitch rad, rate rad/s, distance m)` from a `best.toml` or
    `policy.toml` of `adaptsim robot`.

    Raises BadInput where the file holds no policy of this task.
    """
    act = read_saved(
        path,
        ScoopingConfig,
        ScoopingPolicy,
        scooping.make_scooping_naf,
        scooping.make_policy,
        "scooping",
    )
    action = configs.read(path)["policy"].get("corrected")
    if action is None:
        return act
    if not isinstance(action, list) or np.shape(action) != (3,) or not np.all(np.isfinite(action)):
        raise BadInput(
            f"{path}: policy.corrected must be three numbers; write it again with 'adaptsim robot "
            "next'"
        )
    return lambda place: np.broadcast_to(
        np.asarray(action, np.float32), (*np.shape(place)[:-1], 3)
    ).copy()


def measured_trajectory(
    columns: Columns,
    at: RowName,
    where: str,
    scoops: AskedTrials,
) -> ScoopingTrajectory:
    """The trajectory of `scoops` as the task observes and rewards it, from `columns` trial, time,
    x, y, on of `[T]` each.

    `at(i)` names row i in a message, `where` the file. Places are interpolated at the task's eight
    times and counted from where the piece lay. Raises BadInput.
    """
    needed = (COLUMNS, "s, m, 0 or 1")
    trials = asked_tracks(columns, (where, at), scoops.numbers, KIND, needed, 50 * model.SECONDS)
    for i in np.flatnonzero(~np.isin(columns["on"], (0.0, 1.0)))[:1]:
        raise BadInput(
            f"{at(i)}: on = {columns['on'][i]:g}; write 1 where the piece lies on the spatula, "
            "else 0"
        )
    points, lies = [], []
    for rows, time, track, given in trials:
        _check_track(time, track, given)
        places = np.stack([np.interp(model.OBSERVED_AT, time, track[:, k]) for k in range(2)], 1)
        points.append(places - track[0])
        lies.append(columns["on"][rows[-1]])
    success = jnp.asarray(lies, jnp.float32)
    return ScoopingTrajectory(jnp.asarray(np.stack(points), jnp.float32), success, success.mean())


def _check_track(time: np.ndarray, track: np.ndarray, given: RowName) -> None:
    """A piece seen from the arm's start to the end of the trial, that never jumped."""
    if time[0] > LATE:
        raise BadInput(
            f"{given(0)}: begins at {time[0]:.4g} s; record from the arm's start as time 0, or "
            "subtract that time"
        )
    if time[-1] < model.SECONDS - GAP / 2:
        raise BadInput(
            f"{given(-1)}: ends at {time[-1]:.4g} s; record it for {model.SECONDS:g} s from the "
            "arm's start"
        )
    record.check_gaps(time, GAP, model.SECONDS, given, "make that scoop again")
    record.check_leaps(time, track, given, KIND.body, KIND.fastest, KIND.slip)
