"""Share of printed 90 % intervals that cover the truth, on fresh worlds.

    python -m experiments.calibration --out OUT                      coupled tanks, a minute
    python -m experiments.calibration --out OUT --kinds torque stretches --worlds 12

Worlds: two tanks of which one leaks (a simulator of one's own), and a pendulum with dry friction
whose file has another mass (torque along the motion, simulated stretches). Only numbers of names
that are right in kind count, and declared numbers that the report calls identifiable.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.diagnosis.simulated import diagnose_simulator
from examples.coupled_tanks import recorded
from experiments.closeloop_scores import wilson
from tests.attribution.pendulum import XML, record

LEVEL = 0.9  # of the intervals


class Number(NamedTuple):
    """A printed interval, and the truth."""

    name: str
    low: float
    high: float
    truth: float

    @property
    def covers(self) -> bool:
        return self.low <= self.truth <= self.high


def printed(report: dict[str, Any], truth: dict[str, float]) -> list[Number]:
    """Intervals of a report whose truth is known: `declared name`, `effect.parameter`."""
    rows = {k: v for k, v in report["declared"]["after"].items() if v["identifiable"]}
    for e in report["effects"]:
        rows |= {f"{e['name']}.{p}": v for p, v in e["parameters"].items()}
    ends = ((k, rows[k]["low"], rows[k]["high"]) for k in truth if k in rows)
    return [Number(k, low, high, truth[k]) for k, low, high in ends if None not in (low, high)]


def of_tanks(seed: int, folder: Path) -> list[Number]:
    """Tanks whose pump, drains and leak are drawn."""
    rng = np.random.default_rng([seed, 1])
    gain, one, two = (float(z) for z in (1.0, 0.3, 0.3) * rng.uniform(0.8, 1.2, 3))
    leak = float(rng.uniform(0.002, 0.008))
    hidden = {"gain": gain, "drain_1": one, "drain_2": two, "leak": leak}
    report = diagnose_simulator(recorded(hidden, seed))
    return printed(report, {k: v for k, v in hidden.items() if k != "leak"} | {"leak.leak": leak})


def of_a_pendulum(seed: int, folder: Path, yardstick: str) -> list[Number]:
    """A pendulum whose friction is drawn, and what its true file says of it."""
    level = float(np.random.default_rng([seed, 2]).uniform(0.05, 0.3))
    log = record(folder / f"{yardstick}_{seed}", level, seed=seed)
    model = mujoco.MjModel.from_xml_string(XML.format(damping=0.02, friction=level, mass=1.0))
    arm = model.body_ipos[1, 2]
    truth = {
        "coulomb.level": level,
        "damping of hinge": 0.02,
        "first moment z at hinge": float(model.body_mass[1] * arm),
        "inertia about hinge": float(model.body_inertia[1, 1] + model.body_mass[1] * arm**2),
    }
    return printed(diagnose(log, yardstick=yardstick), truth)


KINDS: dict[str, Callable[[int, Path], list[Number]]] = {
    "simulator": of_tanks,
    "torque": lambda seed, folder: of_a_pendulum(seed, folder, "torque"),
    "stretches": lambda seed, folder: of_a_pendulum(seed, folder, "stretches"),
}


def table(found: dict[str, list[Number]]) -> str:
    """Shares that cover, by kind of objective and number, with their 95 % Wilson intervals."""
    lines = ["| kind | number | cover | of | share |", "| --- | --- | --- | --- | --- |"]
    for kind, numbers in found.items():
        for name in ("all", *dict.fromkeys(n.name for n in numbers)):
            own = [n.covers for n in numbers if name in ("all", n.name)]
            hits, count = sum(own), len(own)
            low, high = wilson(hits, count)
            share = f"{hits / max(count, 1):.2f} ({low:.2f} to {high:.2f})"
            lines.append(f"| {kind} | {name} | {hits} | {count} | {share} |")
    return "\n".join(lines)


def main() -> None:
    """Draw worlds, diagnose them, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["simulator"])
    parser.add_argument("--worlds", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args()
    out, found = output_folder(args.out), {}
    for kind in args.kinds:
        seeds = range(args.seed, args.seed + args.worlds)
        found[kind] = [n for seed in seeds for n in KINDS[kind](seed, out)]
        write_json(
            out / "calibration.json", {k: [n._asdict() for n in v] for k, v in found.items()}
        )
    print(table(found))


if __name__ == "__main__":
    main()
