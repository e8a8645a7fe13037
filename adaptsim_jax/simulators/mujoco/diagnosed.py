"""MuJoCo over a recording as a `Simulator` of the core: a model file that a tree of joints cannot simulate, diagnosed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.diagnosis.problem import Candidate, Quantity
from adaptsim_jax.diagnosis.run import Page, plain
from adaptsim_jax.diagnosis.simulated import diagnose_simulator
from adaptsim_jax.diagnosis.simulator import STEP, Channel
from adaptsim_jax.diagnosis.simulator import Stretches as Compared
from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco import rollouts
from adaptsim_jax.simulators.mujoco.build import Stepped, stepped
from adaptsim_jax.simulators.mujoco.catalogue import DECLARED, candidates, noise_of
from adaptsim_jax.simulators.mujoco.fields import DELAY, Field, with_values
from adaptsim_jax.simulators.mujoco.starts import fitted
from adaptsim_jax.simulators.mujoco.stretches import Stretches, cut, delayed

HORIZON = 0.3  # s: contact makes longer stretches chaotic
BUDGET = 3e6  # steps of one linearisation
FLOOR = 1e-6  # rad, m: least noise, of a log without any
TURNED, SPED = 1e-2, 0.1  # rad (m) and rad/s (m/s) of a start
ONE_AT_A_TIME = Lock()  # MuJoCo's pool of threads is one for all


@dataclass(frozen=True)
class MujocoSimulator:
    """A model file over stretches of a recording. Orientations of a base are compared as three angles from the measured ones."""

    made: Stepped
    own: Stretches
    fields: tuple[Field, ...]
    quantities: tuple[Quantity, ...]
    declared: tuple[str, ...]
    channels: tuple[Channel, ...]
    stretches: Compared
    candidates: tuple[Candidate, ...]

    def predict(self, values: np.ndarray, starts: np.ndarray, which: np.ndarray) -> np.ndarray:
        """See `diagnosis.simulator.Simulator`."""
        values = np.clip(values, *np.array([(f.low, f.high) for f in self.fields]).T)
        rows, kind = np.unique(values, axis=0, return_inverse=True)
        late = [i for i, f in enumerate(self.fields) if f.name == DELAY]
        own = [i for i, f in enumerate(self.fields) if f.name != DELAY]
        models = [with_values(self.made.model, [self.fields[i] for i in own], row[own]) for row in rows]
        delays = rows[:, late[0]] if late else np.zeros(len(rows))
        out = np.empty((len(which), *self.stretches.measured.shape[1:]))
        with ONE_AT_A_TIME:
            for delay in np.unique(delays):
                lanes = np.flatnonzero(delays[kind.reshape(-1)] == delay)
                own_stretches = (
                    delayed(self.own, float(delay), float(self.made.model.opt.timestep)) if delay else self.own
                )
                some = [models[k] for k in kind.reshape(-1)[lanes]]
                path = rollouts.predict(self.made, own_stretches, starts[lanes], which[lanes], some)
                off = rollouts.residual(self.made, self.own, path, which[lanes])
                out[lanes] = self.stretches.measured[which[lanes]] - off
        return out

    def linearise(
        self, values: np.ndarray, starts: np.ndarray, which: np.ndarray, basis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `diagnosis.simulator.linearise`: all differences in one batch."""
        b, p, s = len(which), values.shape[1], starts.shape[1]
        ways = [(np.zeros(p), row) for row in np.diag(self.stretches.scale)] + [(row, np.zeros(s)) for row in basis]
        if not ways:
            return np.zeros((b, self.stretches.measured[0].size, 0)), np.zeros((b, self.stretches.measured[0].size, 0))
        sides = [(side * STEP * v, side * STEP * x) for v, x in ways for side in (1.0, -1.0)]
        every_value = np.concatenate([values + v for v, _ in sides])
        every_start = np.concatenate([starts + x for _, x in sides])
        noise = np.array([c.noise for c in self.channels])
        seen = self.stretches.seen[which] > 0
        read = self.predict(every_value, every_start, np.tile(which, len(sides))).reshape(
            len(ways), 2, b, *self.stretches.measured.shape[1:]
        )
        slope = np.where(seen, (read[:, 0] - read[:, 1]) / noise / (2.0 * STEP), 0.0)
        slope = np.clip(np.nan_to_num(slope), -1e12, 1e12).reshape(len(ways), b, -1)
        both = np.moveaxis(slope, 0, -1)
        return both[..., :s], both[..., s:]


def simulator(source: Source, log: Log, horizon: float = HORIZON) -> MujocoSimulator:
    """Of a model file over a recording. Raises BadInput as reading and cutting do."""
    made = stepped(source, log)
    joints = [name for name in log.joint_names if mujoco.mj_name2id(made.model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0]
    fields, quantities, wanted = candidates(made, joints)
    cost = 2 * (rollouts.start_size(made) + len(fields)) * horizon / float(made.model.opt.timestep)
    own = cut(made, log, horizon, max(24, int(BUDGET / cost)))
    starts, _ = fitted(made, own, _plain(made, own))
    names = [
        *(f"q_{n}" for n in log.joint_names),
        *((f"v_{n}" for n in log.joint_names) if rollouts.has_speeds(made, own) else ()),
    ]
    names += [f"base_{c}" for c in ("x", "y", "z", "turn_x", "turn_y", "turn_z")] if made.base >= 0 else []
    measured = (
        own.measured
        if made.base < 0
        else np.concatenate([own.measured[..., :-4], np.zeros((*own.measured.shape[:2], 3))], -1)
    )
    seen = own.seen if made.base < 0 else np.concatenate([own.seen[..., :-4], own.seen[..., -3:]], -1)
    noise = noise_of(measured, seen)
    if made.base >= 0:
        noise[-3:] = 2.0 * np.mean(noise_of(own.measured[..., -3:], own.seen[..., -3:]))
    noise = np.maximum(noise, FLOOR)
    nv, na = made.model.nv, made.model.na
    scale = np.concatenate([np.full(nv, TURNED), np.full(nv, SPED), np.full(na, SPED)])
    compared = Compared(own.trial, own.names, own.time, measured, seen.astype(float), starts, scale)
    channels = tuple(Channel(n, "rad", float(z)) for n, z in zip(names, noise, strict=True))
    damping = tuple(
        c.quantities[0] for c in wanted if c.name.startswith(DECLARED)
    )  # fitted whatever is named, as for a tree
    wanted = tuple(c for c in wanted if c.quantities[0] not in damping)
    return MujocoSimulator(made, own, fields, quantities, damping, channels, compared, wanted)


def _plain(made: Stepped, own: Stretches) -> np.ndarray:
    return np.ones(own.measured.shape[2] - (1 if made.base >= 0 else 0))


def diagnose(
    source: Source,
    log: Log,
    *,
    out: str | Path | None = None,
    horizon: float = HORIZON,
    exclude: Sequence[str] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
) -> dict[str, Any]:
    """Which numbers of a model file hold out on left-out trials of a recording that MuJoCo simulates; the report."""
    made = simulator(source, log, horizon)
    notes = ["simulated by MuJoCo at the file's own step", *log.notes, *source.notes, *made.made.notes]

    def told(folder: Path, report: dict[str, Any], evidence: dict[str, Any]) -> None:
        report["notes"] = [*report.get("notes", ()), *notes]
        (page or plain)(folder, report, evidence)

    name = Path(source.path).name
    report = diagnose_simulator(made, out=out, exclude=exclude, progress=progress, page=told, name=name)
    return report if out is not None else report | {"notes": [*report.get("notes", ()), *notes]}
