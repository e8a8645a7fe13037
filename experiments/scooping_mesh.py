"""Our scooping engine against Drake with finer meshes and smaller steps, and with finer points and
steps of ours.

    python experiments/scooping_mesh.py --out OUT                        low dissipation
    python experiments/scooping_mesh.py --out OUT --relaxation 0.2       the chosen setting's

Outcomes of each engine are kept in OUT, a file each, so that a run that was stopped goes on;
`--drake` chooses Drake's settings.
"""

from __future__ import annotations

import argparse
import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.tasks.scooping import engines as backend
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.engines import LOW_RELAXATION
from adaptsim_jax.tasks.scooping.engines.drake import ScoopContact
from adaptsim_jax.tasks.scooping.model import Numerics

POINTS = ((8, 3), (10, 3), (2, 3), (4, 2))


def own_engines(relaxation: float) -> dict[str, tuple[str, dict]]:
    """Ours as it is, with more points and with half the step, by name."""
    ours = replace(Numerics(), relaxation=relaxation)
    numerics = {
        "ours": ours,
        "ours, more points": replace(ours, grid=POINTS),
        "ours, 1.25 ms": replace(ours, dt=0.00125),
    }
    return {name: ("hydro", {"numerics": n}) for name, n in numerics.items()}


def drake_engine(text: str, relaxation: float) -> tuple[str, tuple[str, dict]]:
    """`MM` or `MM@MS` of Drake's mesh and step, as a name and what makes it."""
    mesh, _, step = text.partition("@")
    contact = ScoopContact(float(step or 2.5) / 1e3, relaxation, float(mesh) / 1e3)
    return f"Drake {mesh} mm" + (f", {step} ms" if step else ""), ("drake", {"contact": contact})


def outcomes(
    out: Path, name: str, made: tuple[str, dict], samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Success `[B]` and code `[B]` of the trials of seed 0, simulated or read from `out`."""
    path = out / f"{name.replace(' ', '_').replace(',', '')}-{samples}.npz"
    if not path.exists():
        params, actions = model.draw(0, samples)
        begin = time.process_time()
        found = backend.make_backend(made[0], **made[1]).simulate(
            params, actions, np.zeros((samples, 2))
        )
        cpu = time.process_time() - begin
        np.savez(path, success=model.outcome(found.state)[0], code=found.code, cpu=cpu)
        print(f"{name}: {cpu:.0f} s of CPU time", flush=True)
    kept = np.load(path)
    return kept["success"], kept["code"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--drake", nargs="*", default=["10", "3", "2", "3@1.25"], metavar="MM[@MS]")
    parser.add_argument(
        "--relaxation", type=float, default=LOW_RELAXATION, help="s, of all engines"
    )
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    out = output_folder(Path(args.out))
    engines = own_engines(args.relaxation) | dict(
        drake_engine(text, args.relaxation) for text in args.drake
    )
    found = {name: outcomes(out, name, made, args.samples) for name, made in engines.items()}
    rows = []
    for a, b in itertools.combinations(found, 2):
        good = (found[a][1] == model.FINE) & (found[b][1] == model.FINE)
        alike, count = int((found[a][0] == found[b][0])[good].sum()), int(good.sum())
        low, high = binomtest(alike, count).proportion_ci(method="wilson")
        rows.append(
            {"pair": [a, b], "alike": alike / count, "low": low, "high": high, "compared": count}
        )
        print(f"{a:20} {b:20} {alike / count:.3f} ({low:.3f} - {high:.3f}) of {count}")
    write_json(out / "mesh.json", {"samples": args.samples, "pairs": rows})


if __name__ == "__main__":
    main()
