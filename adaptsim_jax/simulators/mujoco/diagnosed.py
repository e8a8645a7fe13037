"""MuJoCo over a recording as a `Simulator` of the core: a model file that a tree of joints cannot
simulate, diagnosed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.run import Page
from adaptsim_jax.diagnosis.simulated import diagnose_simulator
from adaptsim_jax.diagnosis.simulator import DERIVATIVE_STEP, Channel, linearise
from adaptsim_jax.diagnosis.simulator import Stretches as Compared
from adaptsim_jax.diagnosis.starts import taken_up, without
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.quality.audit import audit
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.mujoco import rollouts
from adaptsim_jax.simulators.mujoco.acting import OUTSIDE, acting, as_read
from adaptsim_jax.simulators.mujoco.build import SteppedModel, make_stepped_model
from adaptsim_jax.simulators.mujoco.catalogue import DECLARED, noise_of, rows, sensor_rows
from adaptsim_jax.simulators.mujoco.contact import contact_rows
from adaptsim_jax.simulators.mujoco.criteria import REMARK, SIMULATION
from adaptsim_jax.simulators.mujoco.fields import ModelNumber, with_values
from adaptsim_jax.simulators.mujoco.mended import mended_mjcf
from adaptsim_jax.simulators.mujoco.sensed import prior_of
from adaptsim_jax.simulators.mujoco.starts import fit_stretch_starts
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, cut_stretches

LINEARISATION_STEPS = 5e5  # steps of one linearisation: bounds its time and memory
STRETCHES = (24, 100)  # at least, at most
FIRST_ROUNDS = (
    1,
    4,
)  # rounds of starts before all channels count as they should; where a base is only felt
SCALE_STEP = 0.1  # of a quantity's scale, by which its derivative is taken
RUNAWAY_SLOPE = 1e9  # noises a scale: a larger derivative is of a motion that runs away
SHORT = Criteria(rounds=4, glance=1, confidence=0.025, behind=0.3, matters=0.5)
"""Where a base moves a round is dear: fits are short; and what they leave of single contacts is not
to be named: a gain had friction of 1.03 times the file's beside it, for another number frees starts
that are caught.
"""
MENDED = "model.xml"
ONE_AT_A_TIME = Lock()  # MuJoCo's pool of threads is one for all


@dataclass(frozen=True)
class MujocoSimulator:
    """A model file over stretches of a recording. Orientations of a base are compared as three
    angles from the measured ones.
    """

    stepped_model: SteppedModel
    mujoco_stretches: MujocoStretches
    quantities: tuple[ModelNumber, ...]
    declared: tuple[str, ...]
    channels: tuple[Channel, ...]
    stretches: Compared
    candidates: tuple[Effect, ...]
    remarks: tuple[str, ...] = ()
    verify: Callable[[Path], Table] | None = None  # runs the files that were written

    def predict(self, values: np.ndarray, starts: np.ndarray, which: np.ndarray) -> np.ndarray:
        """See `diagnosis.simulator.Simulator`."""
        values = np.clip(values, *np.array([(f.low, f.high) for f in self.quantities]).T)
        inside = [i for i, f in enumerate(self.quantities) if f.field not in OUTSIDE]
        rows, kind = np.unique(values[:, inside], axis=0, return_inverse=True)
        models = [
            with_values(self.stepped_model.model, [self.quantities[i] for i in inside], row)
            for row in rows
        ]
        by = acting(self.stepped_model, self.quantities, values)
        with ONE_AT_A_TIME:
            path = rollouts.predict(
                self.stepped_model,
                self.mujoco_stretches,
                starts,
                which,
                [models[k] for k in kind.reshape(-1)],
                by,
            )
        read = self.stretches.measured[which] - rollouts.residual(
            self.stepped_model, self.mujoco_stretches, path, which
        )
        return as_read(self.quantities, values, read, self.stretches.time[which])

    def notes(self, values: Mapping[str, float]) -> list[str]:
        """See `diagnosis.simulator.Simulator`."""
        row = np.array([values[q.name] for q in self.quantities])
        return [*step_notes(self, row), *self.remarks]

    @property
    def mended(self) -> dict[str, Callable[[Mapping[str, float]], str]]:
        """The file with what was found in it. See `diagnosis.simulator.Simulator`."""
        return {MENDED: lambda values: mended_mjcf(self.stepped_model, self.quantities, values)}

    def linearise(
        self,
        values: np.ndarray,
        starts: np.ndarray,
        which: np.ndarray,
        basis: np.ndarray,
        starts_too: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `diagnosis.simulator.linearise`: forward differences in one batch, by steps wide
        enough to see past single contacts.
        """
        b, width = len(which), starts.shape[1] if starts_too else 0
        high = np.array([f.high for f in self.quantities])
        basis = SCALE_STEP * basis
        basis = np.where(np.any(values[0] + basis > high, 1)[:, None], -basis, basis)
        steps = DERIVATIVE_STEP * np.diag(self.stretches.scale)[:width]
        every_value = np.concatenate(
            [values, np.tile(values, (width, 1)), *(values + row for row in basis)]
        )
        every_start = np.concatenate(
            [starts, *(starts + row for row in steps), np.tile(starts, (len(basis), 1))]
        )
        read = self.predict(every_value, every_start, np.tile(which, 1 + width + len(basis)))
        read = read.reshape(1 + width + len(basis), b, -1)
        noise = np.tile([c.noise for c in self.channels], self.stretches.time.shape[1])
        mask = self.stretches.seen[which].reshape(b, -1) > 0
        sign = np.sign(basis.sum(1) if len(basis) else np.zeros(0))
        size = np.concatenate([np.full(width, DERIVATIVE_STEP), SCALE_STEP * sign])
        slope = np.where(mask, (read[1:] - read[0]) / noise / size[:, None, None], 0.0)
        both = np.moveaxis(np.clip(np.nan_to_num(slope), -RUNAWAY_SLOPE, RUNAWAY_SLOPE), 0, -1)
        return both[..., :width], both[..., width:]


def simulator(source: Source, log: Log, horizon: float | None = None) -> MujocoSimulator:
    """Make the simulator of a model file over a recording. Raises BadInput as reading and cutting
    do.
    """
    stepped_model = make_stepped_model(source, log)
    first = len(log.joint_names) * (1 if log.trials[0].v is None else 2)
    effects = [
        *rows(stepped_model, log.joint_names),
        *contact_rows(stepped_model),
        *sensor_rows(stepped_model, first),
    ]
    declared = tuple(
        name for e in effects if e.name.startswith(f"{DECLARED} at ") for name in e.names
    )
    candidates = tuple(e for e in effects if e.names[0] not in declared)
    checked = audit(
        log, _slides(stepped_model.model, log), {} if log.input_kind == "command" else None
    )
    remarks = (
        "simulated by MuJoCo at the file's own step",
        *checked.warnings,
        *log.notes,
        *checked.limits,
        *source.notes,
        *stepped_model.notes,
    )
    fields: Any = tuple({f.name: f for e in effects for f in e.parameters}.values())
    without_candidates = simulated(stepped_model, log, fields, declared, horizon)
    return replace(without_candidates, candidates=candidates, remarks=remarks)


def simulated(
    stepped_model: SteppedModel,
    log: Log,
    fields: tuple[ModelNumber, ...],
    declared: tuple[str, ...],
    horizon: float | None = None,
) -> MujocoSimulator:
    """A model with these fields over a recording, without candidates."""
    horizon = horizon or (
        SIMULATION.horizon if stepped_model.free < 0 else SIMULATION.horizon_moving
    )
    cost = (
        (rollouts.start_size(stepped_model) + len(fields))
        * horizon
        / float(stepped_model.model.opt.timestep)
    )
    mujoco_stretches = cut_stretches(
        stepped_model, log, horizon, int(np.clip(LINEARISATION_STEPS / cost, *STRETCHES))
    )
    is_felt = stepped_model.free >= 0 > stepped_model.base
    channels, measured, is_measured = _channels(stepped_model, mujoco_stretches, log)
    starts = np.zeros((mujoco_stretches.count, rollouts.start_size(stepped_model)))
    if stepped_model.base < 0:  # a logged pose is nearer than what stiff contact lets a fit find
        starts, _ = fit_stretch_starts(
            stepped_model,
            mujoco_stretches,
            _first_weights(channels, stepped_model),
            FIRST_ROUNDS[is_felt],
        )
    nv, na = stepped_model.model.nv, stepped_model.model.na
    scale = np.repeat([SIMULATION.start_angle, SIMULATION.start_speed], [nv, nv + na])
    prior = prior_of(stepped_model.model, stepped_model.free) if is_felt else None
    compared = Compared(
        mujoco_stretches.trial,
        mujoco_stretches.names,
        mujoco_stretches.time,
        measured,
        is_measured.astype(float),
        starts,
        scale,
        prior,
    )
    return MujocoSimulator(
        stepped_model, mujoco_stretches, fields, declared, channels, compared, ()
    )


def _first_weights(channels: Sequence[Channel], stepped_model: SteppedModel) -> np.ndarray:
    """[C] weights of channels for first guesses of starts."""
    accelerometers = {r.name for r in stepped_model.sensors if r.kind == "accelerometer"}
    return np.array(
        [
            1.0 / (c.noise * (SIMULATION.accelerometer_noises if c.name in accelerometers else 1.0))
            for c in channels
        ]
    )


def _channels(
    stepped_model: SteppedModel, mujoco_stretches: MujocoStretches, log: Log
) -> tuple[tuple[Channel, ...], np.ndarray, np.ndarray]:
    """Channels, and what was measured and seen of them; of a base three angles from the measured
    orientation.
    """
    slides = _slides(stepped_model.model, log)
    units = {n: "m" if n in slides else "rad" for n in log.joint_names}
    names_and_units = [(f"q_{n}", units[n]) for n in log.joint_names]
    if rollouts.has_speeds(stepped_model, mujoco_stretches):
        names_and_units += [(f"v_{n}", f"{units[n]}/s") for n in log.joint_names]
    measured, is_measured = mujoco_stretches.measured, mujoco_stretches.is_measured
    names_and_units += [(r.name, r.unit) for r in stepped_model.sensors]
    noise = noise_of(measured, is_measured)
    if stepped_model.base >= 0:
        names_and_units += [
            *((f"base_{c}", "m") for c in "xyz"),
            *((f"base_turn_{c}", "rad") for c in "xyz"),
        ]
        turn = 2.0 * float(np.mean(noise[-4:]))
        noise = np.append(noise[:-4], [turn] * 3)
        measured = np.concatenate([measured[..., :-4], np.zeros((*measured.shape[:2], 3))], -1)
        is_measured = np.concatenate([is_measured[..., :-4], is_measured[..., -3:]], -1)
    if stepped_model.free >= 0:  # contact makes accelerations jump, from which no start is found
        spread = np.nanstd(np.where(is_measured, measured, np.nan), axis=(0, 1))
        first = len(names_and_units) - len(stepped_model.sensors)
        accelerometers = [
            first + k
            for k, r in enumerate(stepped_model.sensors)
            if r.kind == "accelerometer" and stepped_model.base < 0
        ]
        noise[accelerometers] = np.maximum(
            noise[accelerometers], SIMULATION.accelerometer_spread * spread[accelerometers]
        )
    noise = np.maximum(noise, SIMULATION.min_noise)
    return (
        tuple(Channel(n, u, float(z)) for (n, u), z in zip(names_and_units, noise, strict=True)),
        measured,
        is_measured,
    )


def _slides(model: mujoco.MjModel, log: Log) -> set[str]:
    """Joints of a log that slide."""
    kinds = {n: model.jnt_type[model.joint(n).id] for n in log.joint_names}
    return {n for n, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_SLIDE}


def diagnose(
    simulator: MujocoSimulator,
    *,
    out: str | Path | None = None,
    exclude: Sequence[str] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
    command: str | None = None,
) -> Table:
    """Which numbers of a model file hold out on left-out trials of a recording that MuJoCo
    simulates; the report. command: what gives the same answer, for the report.
    """
    return diagnose_simulator(
        simulator,
        out=out,
        criteria=None if simulator.stepped_model.free < 0 else SHORT,
        exclude=exclude,
        progress=progress,
        page=page,
        name=Path(simulator.stepped_model.path).name,
        command=command,
    )


def with_half_step(simulator: MujocoSimulator) -> MujocoSimulator:
    """Return a copy that is stepped twice as often; each command acts as long as before."""
    model = simulator.stepped_model.model.__copy__()
    model.opt.timestep *= 0.5
    stretches = simulator.mujoco_stretches
    twice = {k: np.repeat(getattr(stretches, k), 2, 1) for k in ("control", "past")}
    return replace(
        simulator,
        stepped_model=simulator.stepped_model.with_model(model),
        mujoco_stretches=replace(stretches, row_steps=2.0 * stretches.row_steps, **twice),
    )


def change(simulator: MujocoSimulator, values: np.ndarray) -> float:
    """RMS change of predictions over the noise by half the step, with values [P], less what starts
    would take up. The median of a few stretches.
    """
    s = simulator.stretches
    which = np.unique(np.linspace(0, s.count - 1, REMARK.step_stretches).round().astype(int))
    rows, starts = np.tile(values, (len(which), 1)), s.start[which]
    noise = np.array([c.noise for c in simulator.channels])
    difference = with_half_step(simulator).predict(rows, starts, which) - simulator.predict(
        rows, starts, which
    )
    difference = np.where(s.seen[which] > 0, np.nan_to_num(difference / noise), 0.0).reshape(
        len(which), -1
    )
    by_start = linearise(simulator, rows, starts, which, np.zeros((0, len(values))))[0]
    residual = without(taken_up(by_start), difference[..., None])[..., 0]
    counts = (s.seen[which] > 0).reshape(len(which), -1).sum(1)
    return float(np.median(np.sqrt(np.square(residual).sum(1) / np.maximum(counts, 1))))


def step_notes(simulator: MujocoSimulator, values: np.ndarray) -> list[str]:
    """One line where the step is coarse, none where it is fine enough."""
    size, step = change(simulator, values), 1e3 * float(simulator.stepped_model.model.opt.timestep)
    if size < REMARK.step_noises:
        return []
    return [
        f"The file's step of {step:g} ms is coarse for this log: half of it changes what is "
        f"predicted by {size:.2g} times the noise. What is named may be the step's; try a smaller "
        "timestep."
    ]
