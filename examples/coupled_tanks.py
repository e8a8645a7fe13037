"""Two coupled tanks, which are no machine of ours: which effect does their model lack? `python
examples/coupled_tanks.py`

The model: a pump fills tank 1, it drains into tank 2, that drains away, as Torricelli says. The
plant, simulated here in place of a recording, leaks from tank 1 besides. A simulator of one's own
is `predict` and four tables. From the command line, over recordings in CSV:

    adaptsim diagnose logs/tanks --out out --simulator coupled_tanks.py:of_folder
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptsim_jax import Channel, Effect, Quantity, Stretches, diagnose_simulator

DT, ROWS, NOISE = 2.0, 30, 0.5  # s, rows of a stretch, mm of level
QUANTITIES = (  # name, unit, bounds, default, width of a weak prior, a size that matters
    Quantity("gain", "mm/(s V)", 0.1, 5.0, 1.0, prior=10.0, scale=0.02),
    Quantity("drain_1", "mm^.5/s", 0.01, 2.0, 0.30, prior=10.0, scale=0.005),
    Quantity("drain_2", "mm^.5/s", 0.01, 2.0, 0.30, prior=10.0, scale=0.005),
    Quantity("leak", "1/s", 0.0, 0.1, prior=1.0, scale=1e-4),
    Quantity("dead_voltage", "V", 0.0, 2.0, prior=10.0, scale=0.02),
    Quantity("sensor_offset", "mm", -50.0, 50.0, prior=100.0, scale=1.0),
)
LEAK, DEAD_VOLTAGE, SENSOR_OFFSET = QUANTITIES[3:]
CANDIDATES = (
    Effect(
        "leak",
        "tank 1",
        (LEAK,),
        physics="water lost in proportion to the level",
        excitation="high and low levels",
    ),
    Effect(
        "dead_voltage",
        "pump",
        (DEAD_VOLTAGE,),
        physics="voltage below which the pump gives nothing",
        excitation="low voltages",
    ),
    Effect(
        "sensor_offset",
        "tank 2",
        (SENSOR_OFFSET,),
        physics="a level read too high",
        excitation="high and low levels",
    ),
)


def levels(values, start, volts):
    """Levels [B, R, 2] mm under voltages [B, R], by Euler's steps of `DT`."""
    gain, drain_1, drain_2, leak, dead, offset = values.T
    h, out = np.maximum(start, 0.0), []
    for k in range(volts.shape[1]):
        out.append(h + np.stack([0.0 * offset, offset], 1))
        out_1, out_2 = drain_1 * np.sqrt(h[:, 0]), drain_2 * np.sqrt(h[:, 1])
        rate = np.stack(
            [gain * np.maximum(volts[:, k] - dead, 0.0) - out_1 - leak * h[:, 0], out_1 - out_2], 1
        )
        h = np.maximum(h + DT * rate, 0.0)
    return np.stack(out, 1)


@dataclass(frozen=True)
class Tanks:
    stretches: Stretches
    volts: np.ndarray  # [W, R]
    quantities = QUANTITIES
    declared = ("gain", "drain_1", "drain_2")
    channels = (Channel("level_1", "mm", NOISE), Channel("level_2", "mm", NOISE))
    candidates = CANDIDATES

    def predict(self, values, starts, which):
        return levels(values, starts, self.volts[which])


def recorded(hidden: dict[str, float], seed: int = 0, trials: int = 6) -> Tanks:
    """`trials` recordings of four stretches each, of a plant that has `hidden` besides."""
    rng = np.random.default_rng(seed)
    true = np.array([[hidden.get(q.name, q.default) for q in QUANTITIES]])
    volts = np.repeat(rng.uniform(0.5, 6.0, (trials, 4 * ROWS // 10)), 10, 1)
    seen = levels(np.repeat(true, trials, 0), rng.uniform(50, 250, (trials, 2)), volts)
    seen = seen + NOISE * rng.standard_normal(seen.shape)

    return tanks(tuple(f"{k:02d}" for k in range(trials)), volts, seen)


def tanks(names: tuple[str, ...], volts: np.ndarray, seen: np.ndarray) -> Tanks:
    """Recordings `volts [T, N]` and `seen [T, N, 2]`, cut into stretches of `ROWS`."""
    trials, each = len(names), volts.shape[1] // ROWS

    def cut(z):
        return z[:, : each * ROWS].reshape(trials * each, ROWS, *z.shape[2:])

    y, time = cut(seen), cut(np.tile(DT * np.arange(volts.shape[1]), (trials, 1)))
    trial, guess = np.repeat(np.arange(trials), each), y[:, 0]
    return Tanks(
        Stretches(trial, names, time, y, np.ones_like(y), guess, np.array([5.0, 5.0])), cut(volts)
    )


def of_folder(folder: Path) -> Tanks:
    """The recordings of a folder: a CSV a trial, with columns volts, level_1 and level_2 every
    `DT`.
    """
    files = sorted(folder.glob("*.csv"))
    rows = [np.loadtxt(file, delimiter=",", skiprows=1) for file in files]
    length = min(len(row) for row in rows)
    table = np.stack([row[:length] for row in rows])
    return tanks(tuple(file.stem for file in files), table[..., 0], table[..., 1:])


if __name__ == "__main__":
    report = diagnose_simulator(
        recorded({"gain": 1.1, "drain_1": 0.33, "leak": 0.004}), name="two coupled tanks"
    )
    print(report["message"], *((e["name"], e["parameters"]) for e in report["effects"]), sep="\n")
