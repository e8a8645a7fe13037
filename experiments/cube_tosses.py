"""The measured cube tosses: fitted on tosses 0 to 29, scored on 30 to 59.

    python experiments/cube_tosses.py ../shared/data/measured_cube_tosses --out cube

Writes the two halves as folders that `adaptsim diagnose` reads, diagnoses the first (or takes the
report that is there already), and scores the second by the published body, the declared one as
fitted, the mended one, and by frictions that the first half's slides alone say.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from adaptsim_jax.report.diagnosis import write_diagnosis
from adaptsim_jax.tasks.toss.diagnose import diagnose
from adaptsim_jax.tasks.toss.flight import (
    Span,
    free_flight,
    predicted,
    values_of,
    whole_tosses,
    words,
)
from adaptsim_jax.tasks.toss.read import Tossed, read
from adaptsim_jax.tasks.toss.windows import MIN_ROWS, slide

HALVES = {"fitted": range(30), "scored": range(30, 60)}
MASS, SIDE, FRICTION, RESTITUTION, INERTIA = (
    0.37,
    0.1048,
    0.18,
    0.125,
    8.1e-4,
)  # as published with the data
GRID = np.arange(0.16, 0.2401, 0.005)
STEP, CONTACT_TIME = 0.002, 0.004  # s, ours
XML = """<mujoco>
  <option timestep="{step}" cone="elliptic" impratio="10" gravity="0 0 -9.81"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="cube"><freejoint/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
      <geom type="box" size="{half} {half} {half}" friction="{friction} 0 0" solref="{time} {damping:.4f}"/>
    </body>
  </worldbody>
</mujoco>
"""  # noqa: E501


def cube() -> str:
    """The published cube; its restitution as the damping ratio of an impact that rebounds so."""
    log = np.log(RESTITUTION)
    damping = -log / np.hypot(np.pi, log)
    return XML.format(
        step=STEP,
        mass=MASS,
        inertia=INERTIA,
        half=SIDE / 2,
        friction=FRICTION,
        time=CONTACT_TIME,
        damping=damping,
    )


def written(data: Path, out: Path) -> dict[str, Path]:
    """Both halves as folders."""
    folders = {}
    for half, numbers in HALVES.items():
        folders[half] = out / half
        folders[half].mkdir(parents=True, exist_ok=True)
        (folders[half] / "meta.toml").write_text('task = "toss"\nmodel = "cube.xml"\n')
        (folders[half] / "cube.xml").write_text(cube())
        for k in numbers:
            rows = [
                line.split(",")[:8]
                for line in (data / f"toss_{k:03d}.csv").read_text().splitlines()
            ]
            (folders[half] / f"toss_{k:03d}.csv").write_text(
                "\n".join([",".join(row) for row in rows] + [""])
            )
    return folders


def models(report: dict) -> dict[str, dict[str, float]]:
    """Values by name of each model that is scored."""
    fitted = {}
    for when in ("before", "after"):
        rows = {k: v["value"] for k, v in report["declared"][when].items()}
        fitted[when] = {
            "friction": rows["friction"],
            "log_time": float(np.log10(rows["contact_time"])),
            "damping": rows["damping"],
        }
    added = {q: row["value"] for e in report["effects"] for q, row in e["parameters"].items()}
    return {
        "no friction": {"friction": 0.0},
        "published": {},
        "declared, fitted": fitted["before"],
        "mended": fitted["after"] | added,
    }


def slides(tossed: Tossed) -> tuple[list[Span], list[int]]:
    """The last slide of each toss on a face (`windows.slide`) up to the last row, and the rows that
    its start is fitted to.
    """
    rows = zip(tossed.time, tossed.place, tossed.turn, strict=True)
    begins = [(t, slide(*z), len(z[0])) for t, z in enumerate(rows)]
    spans = [(t, a, b) for t, a, b in begins if a is not None]
    return spans, [MIN_ROWS] * len(spans)


def slide_ends(tossed: Tossed, values: np.ndarray) -> np.ndarray:
    """Distance `[S]` m at the end of each slide; values `[P]`."""
    spans, rows = slides(tossed)
    if not spans:
        return np.zeros(0)
    off = predicted(tossed, np.tile(values, (len(spans), 1)), spans, rows)
    return np.array([np.linalg.norm(z[-1, :2]) for z in off])


def by_slides(fitted, given: dict[str, float]) -> dict[str, float]:
    """`given` with the friction of a grid by which the slides of the fitted half end nearest to
    where they did.
    """
    tried = [given | {"friction": float(f)} for f in GRID]
    return min(tried, key=lambda g: slide_ends(fitted, values_of(fitted, g)).mean())


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    folders = written(args.data, args.out)
    kept = args.out / "diagnosis" / "report.json"
    if not kept.exists():
        diagnose(
            folders["fitted"],
            out=kept.parent,
            page=write_diagnosis,
            progress=lambda d, t, note: print(f"{d:.2f} {note}"),
        )
    report = json.loads(kept.read_text())
    print(report["verdict"], report["message"])
    scored = read(folders["scored"])
    print("scored half:", words(free_flight(scored)))
    scores = models(report)
    for name in ("published", "mended"):
        scores[f"{name}, friction by slides"] = by_slides(read(folders["fitted"]), scores[name])
    for name, given in scores.items():
        values = values_of(scored, given)
        ends = 1e3 * slide_ends(scored, values)
        whole = 1e3 * whole_tosses(scored, np.tile(values, (len(scored.names), 1)))
        print(
            f"{name:30s} friction {values[0]:.3f}, slide ends ({len(ends)}): mean "
            f"{ends.mean():.1f}, median {np.median(ends):.1f} mm; whole tosses ({len(whole)}): "
            f"mean {whole.mean():.1f}, median {np.median(whole):.1f} mm",
            flush=True,
        )


if __name__ == "__main__":
    main()
