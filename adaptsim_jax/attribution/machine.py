"""A mechanism with its recording: tracks of joints, and the law of the actuator at each joint."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.attribution.stretches import Track
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.mjcf import Mechanism
from adaptsim_jax.mechanisms.tree import Tree


@dataclass(frozen=True)
class Machine:
    """A mechanism with its recording. actuator [6, n]: gain, bias, per angle, per speed, lowest and highest force; gear [n];
    gain_unknown: the input is a voltage or a current, whose torque is to be found."""

    mechanism: Mechanism
    log: Log
    tracks: tuple[Track, ...]
    actuator: np.ndarray
    gear: np.ndarray
    gain_unknown: bool
    declared: dict[tuple[str, str], np.ndarray] = field(
        default_factory=dict
    )  # delay and lag [n] of the file's actuators
    gain_guess: np.ndarray = field(
        default_factory=lambda: np.zeros(0)
    )  # [n] where the search for an unknown gain begins
    servo_times: dict[int, float] = field(default_factory=dict)  # of kp in the file, by joint, where it had to be found

    @property
    def tree(self) -> Tree:
        return self.mechanism.tree

    def without(self, names: Sequence[str]) -> "Machine":
        """Without these trials. Raises BadInput where one is not there, or none is left."""
        known = [t.name for t in self.tracks]
        if unknown := sorted(set(names) - set(known)):
            raise BadInput(
                f"{self.log.path}: no trial is named {unknown[0]!r}; --without takes of {', '.join(sorted(known))}"
            )
        if not set(known) - set(names):
            raise BadInput(f"{self.log.path}: --without leaves no trial; leave one out at a time")
        return replace(self, tracks=tuple(t for t in self.tracks if t.name not in set(names)))


def machine(mechanism: Mechanism, log: Log) -> Machine:
    """The two joined."""
    n = mechanism.tree.n
    where = {name: j for j, name in enumerate(mechanism.tree.joint_names)}
    law = np.stack([np.ones(n), *[np.zeros(n)] * 3, np.full(n, -np.inf), np.full(n, np.inf)])
    gear = np.ones(n)
    column = {}
    limits = np.tile([-np.inf, np.inf], (n, 1))
    if log.input_kind == "command":
        by_name = {a.name: a for a in mechanism.actuators}
        for k, name in enumerate(log.input_names):
            a = by_name.get(name) or next(
                (a for a in mechanism.actuators if mechanism.tree.joint_names[a.joint] == name), None
            )
            if a is None:
                raise BadInput(
                    f"{log.path}: a command for {name}, but {mechanism.path} has no such actuator; add it or rename the column"
                )
            if a.joint in column:
                raise BadInput(
                    f"{mechanism.path}: joint {mechanism.tree.joint_names[a.joint]} has several actuators; keep one of them"
                )
            column[a.joint], j = k, a.joint
            gear[j] = a.gear
            low, high = a.forcerange
            law[:, j] = (
                a.gain,
                a.offset,
                -a.kp,
                -a.kv,
                -np.inf if np.isnan(low) else low,
                np.inf if np.isnan(high) else high,
            )
            low, high = a.ctrlrange
            limits[j] = -np.inf if np.isnan(low) else low, np.inf if np.isnan(high) else high
        for j in set(range(n)) - set(column):
            law[0, j] = 0.0
    else:
        for k, name in enumerate(log.input_names):
            column[where[name]] = k
    tracks = []
    for trial in log.trials:
        u = np.zeros((len(trial.time), n))
        for j, k in column.items():
            u[:, j] = np.clip(trial.u[:, k], *limits[j])
        tracks.append(Track(trial.name, trial.time, trial.q, trial.v, u, trial.group))
    unknown = log.input_kind in ("voltage", "current")
    if unknown:  # torque over input is what the file's motors say; a gear of 1 says nothing, so a guess to begin with
        first = _gain(mechanism.tree, tracks)
        told = {a.joint: a.gear * a.gain for a in mechanism.actuators}
        law[0] = [first if told.get(j, 1.0) == 1.0 else told[j] for j in range(n)]
        for a in mechanism.actuators:
            low, high = (a.gear * z for z in a.forcerange)
            law[4:, a.joint] = -np.inf if np.isnan(low) else low, np.inf if np.isnan(high) else high
    declared = {("delay", "delay"): np.zeros(n), ("actuator_lag", "lag"): np.zeros(n)}
    if log.input_kind == "command":
        for a in mechanism.actuators:
            declared["delay", "delay"][a.joint], declared["actuator_lag", "lag"][a.joint] = a.delay, a.lag
    return Machine(mechanism, log, tuple(tracks), law, gear, unknown, declared)


def _gain(tree: Tree, tracks) -> float:
    """A first guess at torque over input: weight of what hangs over the size of the input."""
    reach = sum(float(np.linalg.norm(p)) for p in np.asarray(tree.place)) + float(
        np.max(
            np.linalg.norm(np.asarray(tree.inertial)[:, 1:4], axis=1)
            / np.maximum(np.asarray(tree.inertial)[:, 0], 1e-9)
        )
    )
    weight = float(np.asarray(tree.inertial)[:, 0].sum() * np.linalg.norm(np.asarray(tree.gravity)) * max(reach, 1e-3))
    u = np.concatenate([np.abs(t.u) for t in tracks])
    return 0.5 * weight / max(float(np.quantile(u, 0.9)), 1e-9)
