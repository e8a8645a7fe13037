"""A mechanism with its recording: tracks of joints, and the law of the actuator at each joint."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.attribution.criteria import CHOICE, RANGE, STRETCH
from adaptsim_jax.attribution.problem import TreeProblem, beyond_range, prepare
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import ACTUATOR_LAG, DELAY
from adaptsim_jax.logs.log import Log, check_excluded
from adaptsim_jax.mechanisms.mjcf import Mechanism
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.mechanisms.transmission import Actuator
from adaptsim_jax.mechanisms.tree import Tree


@dataclass(frozen=True)
class Machine:
    """A mechanism with its recording.

    Args:
        actuator: [6, n] gain, bias, per angle, per speed, lowest and highest force; gear [n].
        ties: [n, n] gears by which a joint's actuator pulls others (None: none does).
        gain_unknown: The input is a voltage or a current, whose torque is to be found.
        beyond: What of the file a tree of joints has not and the recording may feel, a sentence
            each.
    """

    mechanism: Mechanism
    log: Log
    tracks: tuple[JointTrack, ...]
    actuator: np.ndarray
    gear: np.ndarray
    gain_unknown: bool
    declared: dict[tuple[str, str], np.ndarray] = field(
        default_factory=dict
    )  # delay and lag [n] of the file's actuators
    ties: np.ndarray | None = None
    beyond: tuple[str, ...] = ()
    gain_estimated: bool = False  # whether weight and inertia of the file's bodies gave it
    gives: bool = False  # whether dry friction gives as the file has it (`equation/rubbing.py`)
    source: Source | None = None  # the model file, where MuJoCo steps it as well

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of how the model was read and of what is left out, a sentence
        each.
        """
        if self.beyond:
            left_out = f"not simulated by the tree of joints: {'; '.join(self.beyond)}"
        else:
            left_out = ""
        if self.log.meta.simulator == "mujoco":
            asked = "diagnosed by a tree of joints: the simulator mujoco replays and fits"
        else:
            asked = ""
        return (*self.mechanism.notes, *(line for line in (left_out, asked) if line))

    @property
    def tree(self) -> Tree:
        return self.mechanism.tree

    def problem(
        self,
        effects: Sequence[Effect],
        horizon: float = CHOICE.horizon,
        most: int = STRETCH.max_count,
        look_back: float = 0.0,
    ) -> TreeProblem:
        """The recording in stretches.

        Args:
            effects: that may be fitted.
            horizon: length of a stretch, s; most: stretches at most.
            look_back: s from each stretch's start whose readings do not count.
        """
        made = prepare(
            self.tree,
            self.tracks,
            effects,
            self.actuator,
            self.gear,
            horizon,
            most,
            self.declared,
            look_back,
            self.ties,
        )
        meta, names = self.log.meta, made.joint_names
        least = np.concatenate([meta.least_noise(stem, names) for stem in ("q", "v")])
        return replace(made, floor=np.maximum(made.floor, least))

    def without(self, names: Sequence[str]) -> "Machine":
        """Without these trials. Raises BadInput where one is not there, or none is left."""
        check_excluded(self.log.path, sorted(t.name for t in self.tracks), names)
        return replace(self, tracks=tuple(t for t in self.tracks if t.name not in set(names)))


def machine(mechanism: Mechanism, log: Log) -> Machine:
    """The two joined."""
    n = mechanism.tree.n
    commanded = log.input_kind == "command"
    if commanded:
        drives = _drives(mechanism, log)
    else:
        drives = _torques(mechanism, log)
    tracks = tuple(
        JointTrack(trial.name, trial.time, trial.q, trial.v, drives.input(trial.u))
        for trial in log.trials
    )
    law, gear = drives.law, drives.gear
    unknown = log.input_kind in ("voltage", "current")
    # torque over input is what the file's motors say; a gear of 1 says nothing, so a guess to begin
    # with
    if unknown:
        first = _gain(mechanism.tree, tracks)
        gains = {a.joint: a.gear * a.gain for a in mechanism.actuators}
        law[0] = [first if gains.get(j, 1.0) == 1.0 else gains[j] for j in range(n)]
        for a in mechanism.actuators:
            low, high = (a.gear * z for z in a.forcerange)
            law[4:, a.joint] = -np.inf if np.isnan(low) else low, np.inf if np.isnan(high) else high
    delays, lags = np.zeros(n), np.zeros(n)
    if commanded:
        for a in mechanism.actuators:
            delays[a.joint], lags[a.joint] = a.delay, a.lag
    declared = {(DELAY.name, "delay"): delays, (ACTUATOR_LAG.name, "lag"): lags}
    beyond = (
        mechanism.unsupported
        + (mechanism.unsupported_drives if commanded else ())
        + drives.beyond
        + _out_of_range(mechanism.tree, tracks)
    )
    return Machine(
        mechanism, log, tracks, law, gear, unknown, declared, ties=drives.ties, beyond=beyond
    )


@dataclass(frozen=True)
class _Drives:
    """Actuators by joint: law [6, n], gear [n], ties [n, n] or None as of `Machine`; share [m, n]
    of the log's inputs, within limits [m, 2], in each joint's; beyond: what is not as in the file.
    """

    law: np.ndarray
    gear: np.ndarray
    ties: np.ndarray | None
    share: np.ndarray
    limits: np.ndarray
    beyond: tuple[str, ...] = ()

    def input(self, u: np.ndarray) -> np.ndarray:
        """[T, n] of the log's [T, m]."""
        out = np.zeros((len(u), self.share.shape[1]))
        for k, j in np.argwhere(self.share):
            out[:, j] += self.share[k, j] * np.clip(u[:, k], *self.limits[k])
        return out


def _torques(mechanism: Mechanism, log: Log) -> _Drives:
    """What was measured at the joints."""
    n, m = mechanism.tree.n, len(log.input_names)
    law = np.stack([np.ones(n), *[np.zeros(n)] * 3, np.full(n, -np.inf), np.full(n, np.inf)])
    share = np.zeros((m, n))
    where = {name: j for j, name in enumerate(mechanism.tree.joint_names)}
    for k, name in enumerate(log.input_names):
        share[k, where[name]] = 1.0
    return _Drives(law, np.ones(n), None, share, np.tile([-np.inf, np.inf], (m, 1)))


def _drives(mechanism: Mechanism, log: Log) -> _Drives:
    """What actuators make of commands. Several at a joint add up to one law, whose command is in
    the units of the first servo's.
    """
    n, m = mechanism.tree.n, len(log.input_names)
    law = np.stack([*[np.zeros(n)] * 4, np.full(n, -np.inf), np.full(n, np.inf)])
    gear, ties, share = np.ones(n), np.zeros((n, n)), np.zeros((m, n))
    limits = np.tile([-np.inf, np.inf], (m, 1))
    by_joint: dict[int, list[tuple[int, Actuator]]] = {}
    for k, name in enumerate(log.input_names):
        a = actuator_of(mechanism, name)
        if a is not None:  # else of joints that are held, or on no joint of the tree, which is told
            limits[k] = _open(a.ctrlrange)
            by_joint.setdefault(a.joint, []).append((k, a))
    beyond: list[str] = []
    for j, some in by_joint.items():
        actuators = [a for _, a in some]
        lead = next((a for a in actuators if a.kp), actuators[0])
        parts = np.array([a.gear / lead.gear for a in actuators])
        gear[j], law[:, j] = lead.gear, _summed(lead, actuators, parts)
        for (k, a), part in zip(some, parts, strict=True):
            share[k, j] = part * a.gain / lead.gain if lead.gain else 0.0
        low, high = np.sort(np.array(_open(tuple(mechanism.force_limits[j]))) / gear[j])
        law[4:, j] = max(law[4, j], low), min(law[5, j], high)
        for other, g in lead.more:
            ties[j, other] = g
        beyond += _differing(mechanism.tree.joint_names[j], actuators)
    return _Drives(law, gear, ties if ties.any() else None, share, limits, tuple(beyond))


def _summed(lead: Actuator, actuators: Sequence[Actuator], parts: np.ndarray) -> np.ndarray:
    """Law [6] of all actuators of a joint, with the gear of `lead`; parts: the gear of each over
    it.
    """

    def of(name):
        return np.array([getattr(a, name) for a in actuators])

    bounds = [
        np.sort(p * np.array(_open(a.forcerange))) for p, a in zip(parts, actuators, strict=True)
    ]
    return np.array(
        [
            lead.gain,
            parts @ of("offset"),
            -(parts**2) @ of("kp"),
            -(parts**2) @ of("kv"),
            *np.sum(bounds, 0),
        ]
    )


def _differing(joint: str, actuators: Sequence[Actuator]) -> list[str]:
    """What is only nearly so where several actuators of a joint add up."""
    if len(actuators) == 1:
        return []
    out = []
    if any(np.isfinite(_open(a.forcerange)).any() for a in actuators):
        out.append(f"force ranges of each actuator of {joint} (their sum acts)")
    if len({(a.delay, a.lag) for a in actuators}) > 1:
        out.append(f"delays of each actuator of {joint} (that of the last acts)")
    if any(a.more for a in actuators):
        out.append(f"tendons that pull {joint} beside another actuator")
    return out


def actuator_of(mechanism: Mechanism, name: str) -> Actuator | None:
    """The actuator of this name, else that of the joint of this name."""
    by_name = {a.name: a for a in mechanism.actuators}
    return by_name.get(name) or next(
        (a for a in mechanism.actuators if mechanism.tree.joint_names[a.joint] == name), None
    )


def _open(limits: tuple[float, ...]) -> tuple[float, float]:
    """Limits with infinity where there is none."""
    low, high = limits
    return -np.inf if np.isnan(low) else low, np.inf if np.isnan(high) else high


def _out_of_range(tree: Tree, tracks: Sequence[JointTrack]) -> tuple[str, ...]:
    """Declared ranges that the motion goes far beyond, so that the machine cannot have them."""
    excess = beyond_range(tree, tracks)
    names = [
        f"{tree.joint_names[j]} (by {excess[j]:.2g} {tree.unit(int(j))})"
        for j in np.flatnonzero(excess > RANGE.beyond_stop)
    ]
    if names:
        return (f"the declared range of {', '.join(names)}, which the motion goes beyond",)
    return ()


def _gain(tree: Tree, tracks) -> float:
    """A first guess at torque over input: weight of what hangs over the size of the input."""
    inertial = np.asarray(tree.inertial)
    mass = inertial[:, 0]
    centre = np.linalg.norm(inertial[:, 1:4], axis=1) / np.maximum(mass, 1e-9)
    reach = sum(float(np.linalg.norm(p)) for p in np.asarray(tree.place))
    reach = reach + float(np.max(centre))
    weight = float(mass.sum() * np.linalg.norm(np.asarray(tree.gravity)) * max(reach, 1e-3))
    u = np.concatenate([np.abs(t.u) for t in tracks])
    return 0.5 * weight / max(float(np.quantile(u, 0.9)), 1e-9)
