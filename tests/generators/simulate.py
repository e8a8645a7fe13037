"""The clock of the worlds: rows of a recording, a controller that sees the sensors, and RK4 between
the rows.

A command holds from its row to the next. All lanes march row by row together, each with its own
times; the layout is `[rows, 2, L]`, so that one NumPy call serves both joints of all trials of all
data sets.
"""

from dataclasses import dataclass

import numpy as np

from tests.generators import forces
from tests.generators.effects import Table
from tests.generators.worlds import Lanes, acceleration, mass_matrix


@dataclass
class Drive:
    """What is done to the rigs: `command = feedforward + gain (reference - measured)`, clipped at
    `limit`.
    """

    times: np.ndarray  # [K, L] s; padded by repeating the last
    feedforward: np.ndarray  # [K, 2, L] N m
    gain: np.ndarray  # [2, 4, L]
    reference: np.ndarray  # [K, 4, L]
    limit: np.ndarray  # [2, L] N m
    start: np.ndarray  # [4, L]
    noise: np.ndarray  # [K, 4, L] sensor noise
    quantum: np.ndarray  # [2, L] encoder step [rad], 0 for none
    disturbance: np.ndarray  # [K, 2, L] N m, an unknown torque held over each row
    free_phase: np.ndarray  # [L] rad

    def pick(self, lanes: np.ndarray) -> "Drive":
        """The same for a choice of lanes (repeats allowed)."""
        return Drive(**{k: np.ascontiguousarray(v[..., lanes]) for k, v in vars(self).items()})

    def quiet(self) -> "Drive":
        """Without sensor noise, quantisation and disturbance."""
        zero = {k: np.zeros_like(getattr(self, k)) for k in ("noise", "quantum", "disturbance")}
        return Drive(**{**vars(self), **zero})


@dataclass
class Run:
    """What happened: `measured` is what a file holds, `clean` the same sensors without noise."""

    times: np.ndarray  # [K, L]
    state: np.ndarray  # [K, 4, L] true
    measured: np.ndarray  # [K, 4, L]
    clean: np.ndarray  # [K, 4, L]
    smooth: (
        np.ndarray
    )  # [K, 4, L] as clean, but with velocities free of the jumps of backlash: for sizing
    command: np.ndarray  # [K, 2, L]


class Delay:
    """Commands that arrive late, averaged over each inner step so that the delay is not rounded to
    steps.
    """

    def __init__(self, lag: np.ndarray, times: np.ndarray, commands: np.ndarray):
        self.lag, self.commands = lag, commands
        never, end = np.full((1, times.shape[1]), -1e9), np.full((2, times.shape[1]), 1e9)
        self.edges = np.concatenate([never, times, end])  # row k starts at edges[k + 1]
        self.row = np.zeros(lag.shape, int)
        self.lane = np.arange(times.shape[1])[None]
        self.joint = np.arange(2)[:, None]

    def _edge(self, row):
        return self.edges[row, self.lane]

    def _value(self, row):
        k = np.minimum(row, len(self.commands)) - 1
        return np.where(row > 0, self.commands[np.maximum(k, 0), self.joint, self.lane], 0.0)

    def __call__(self, t: np.ndarray, h: np.ndarray) -> np.ndarray:
        at = t - self.lag + 1e-12
        while np.any(late := self._edge(self.row + 1) <= at):
            self.row = self.row + late
        share = np.clip((self._edge(self.row + 1) - at) / np.maximum(h, 1e-12), 0.0, 1.0)
        return share * self._value(self.row) + (1 - share) * self._value(self.row + 1)


def play(q: np.ndarray, z: np.ndarray, width: np.ndarray) -> np.ndarray:
    """The play operator: z follows q at a distance of at most half the width."""
    return np.clip(z, q - width / 2, q + width / 2)


class Plant:
    """Everything between a command and a sensor: the joint dynamics with the effects of one
    table.
    """

    def __init__(self, p: Lanes, table: Table, drive: Drive, step: float):
        self.p, self.table, self.rotor = p, table, 0.0
        self.tilt = 0.0
        if "rotor_inertia" in table:
            self.rotor = table["rotor_inertia"]["size"]
        if "tilt" in table:
            self.tilt = (table["tilt"]["size"] * table["tilt"]["sign"])[0]
        m11, m12, m22 = mass_matrix(p, np.zeros((2, table.lanes)))
        det = m11 * m22 - m12**2
        self.terms = forces.force_terms(
            table, np.stack([det / m22, det / m11]), step, drive.free_phase
        )
        self.lag = table["actuator_lag"]["size"] if "actuator_lag" in table else None
        self.filter = table["sensor_lag"]["size"] if "sensor_lag" in table else None
        self.bristle = table["presliding"] if "presliding" in table else None

    def rate(self, y: np.ndarray, t: np.ndarray, u: np.ndarray, disturbance: np.ndarray):
        """Time derivative of the stacked state `[n, 2, L]`: q, v, actuator, bristle, sensor
        filter.
        """
        q, v = y[0], y[1]
        out = np.zeros_like(y)
        applied = u if self.lag is None else np.where(self.lag > 0, y[2], u)
        torque = applied + disturbance - self.p.b * v
        for term in self.terms:
            torque = torque + term(q, v, t, applied)
        if self.bristle is not None:
            out[3] = forces.bristle_rate(self.bristle, y[3], v)
            torque = torque + forces.bristle_force(self.bristle, y[3], out[3])
        out[0] = v
        out[1] = acceleration(self.p, q, v, torque, self.tilt, self.rotor)
        if self.lag is not None:
            out[2] = np.where(self.lag > 0, (u - y[2]) / np.maximum(self.lag, 1e-6), 0.0)
        if self.filter is not None:
            out[4] = np.where(self.filter > 0, (q - y[4]) / np.maximum(self.filter, 1e-6), 0.0)
        return out

    def sense(self, y: np.ndarray, slack: np.ndarray):
        """Clean sensor readings, and the same without the velocity jumps of backlash: two of `[4,
        L]`.
        """
        q, v = y[0], y[1]
        if self.filter is not None:
            f, on = np.maximum(self.filter, 1e-6), self.filter > 0
            q, v = np.where(on, y[4], q), np.where(on, (y[0] - y[4]) / f, v)
        smooth = v
        if "backlash" in self.table:
            width = self.table["backlash"]["size"]
            moving = (np.abs(slack - y[0]) >= width / 2 * 0.999) & ((y[0] - slack) * y[1] >= 0)
            q = np.where(width > 0, slack, q)
            v = np.where((width > 0) & ~moving, 0.0, v)
        if "encoder_offset" in self.table:
            e = self.table["encoder_offset"]
            q = q + e["size"] * e["sign"]
        return np.concatenate([q, v]), np.concatenate([q, smooth])


def simulate(p: Lanes, table: Table, drive: Drive, step: float) -> Run:
    """March all lanes through their rows; `step` is the longest inner RK4 step [s]."""
    rows, lanes = drive.times.shape
    plant = Plant(p, table, drive, step)
    y = np.zeros((5 if plant.filter is not None or plant.bristle is not None else 3, 2, lanes))
    y[0], y[1] = drive.start[:2], drive.start[2:]
    if plant.filter is not None:
        y[4] = y[0]
        y[4] -= plant.filter * y[1]
    slack = y[0].copy()
    run = Run(drive.times, *(np.zeros((rows, n, lanes)) for n in (4, 4, 4, 4, 2)))
    delay = Delay(table["delay"]["size"], drive.times, run.command) if "delay" in table else None
    gaps = np.diff(drive.times, axis=0, append=drive.times[-1:])
    for k in range(rows):
        run.state[k] = y[:2].reshape(4, lanes)
        clean, run.smooth[k] = plant.sense(y, slack)
        command = _command(drive, k, clean, run)
        t, h = drive.times[k], gaps[k]
        pieces = max(1, int(np.ceil(h.max() / step - 1e-9)))
        h = h / pieces
        for i in range(pieces):
            u = forces.static_command(table, command if delay is None else delay(t + i * h, h))
            y = _rk4(plant, y, t + i * h, h, u, drive.disturbance[k])
            if "backlash" in table:
                slack = play(y[0], slack, table["backlash"]["size"])
    return run


def _command(drive: Drive, k: int, clean: np.ndarray, run: Run) -> np.ndarray:
    """Read the sensors at row k, decide the command, write both down."""
    measured = clean + drive.noise[k]
    steps = drive.quantum
    measured[:2] = np.where(
        steps > 0, np.round(measured[:2] / np.maximum(steps, 1e-12)) * steps, measured[:2]
    )
    error = drive.reference[k] - measured
    command = drive.feedforward[k] + (drive.gain * error).sum(1)
    command = np.clip(command, -drive.limit, drive.limit)
    run.clean[k], run.measured[k], run.command[k] = clean, measured, command
    return command


def _rk4(plant: Plant, y, t, h, u, d):
    """One classical Runge-Kutta step with u and d held."""
    k1 = plant.rate(y, t, u, d)
    k2 = plant.rate(y + 0.5 * h * k1, t + 0.5 * h, u, d)
    k3 = plant.rate(y + 0.5 * h * k2, t + 0.5 * h, u, d)
    k4 = plant.rate(y + h * k3, t + h, u, d)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
