"""`adaptsim excite`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptsim_jax.attribution.excitation import Excitation
    from adaptsim_jax.mechanisms.allowed import Allowed

EXAMPLES = """
  adaptsim excite robot.xml                         a motion of 16 s, and what it would show
  adaptsim excite robot.urdf --out next --speed 0.3    slower: three tenths of the speed limits
  adaptsim excite robot.xml --after out --out next     on the model that a diagnosis found, by its noise
  adaptsim excite robot.xml --seconds 30 --rate 200    longer, 200 rows a second
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Draw motions, keep the one that shows most, write it and its table."""
    from dataclasses import replace

    from adaptsim_jax.attribution.draws import BLEND
    from adaptsim_jax.attribution.excitation import Search, excited, read_after
    from adaptsim_jax.commands.parser import next_step, output
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import write_bytes, write_json
    from adaptsim_jax.core.progress import progress
    from adaptsim_jax.mechanisms.allowed import MARGINS, allowed
    from adaptsim_jax.report.motion import save_motion

    if not 0.0 < args.speed <= 1.0:
        raise BadInput(f"--speed {args.speed:g}: is no share of the speed limits; give 0.7")
    if not 4.0 * BLEND <= args.seconds <= 300.0:
        raise BadInput(f"--seconds {args.seconds:g}: give 6 to 300; 16 is usual")
    if not 50.0 <= args.rate <= 1000.0:
        raise BadInput(f"--rate {args.rate:g}: give 50 to 1000 Hz")
    after = None if args.after is None else read_after(args.after)
    may = allowed(args.model, replace(MARGINS, speed=args.speed))
    search = Search(args.seconds, args.rate, args.draws, seed=args.seed)
    with output(args.out) as out:
        with progress("excite") as report:
            found = excited(may, search, after, report)
        write_bytes(out / "motion.csv", csv_of(may, found).encode())
        write_json(out / "trajectory.json", trajectory_of(may, found))
        written = {"schema": 1, "model": args.model, "after": args.after, "notes": may.notes}
        write_json(out / "shown.json", written | {"shown": found.rows})
        save_motion(may, found, out / "motion.png")
    for line in may.notes:
        print(f"note: {line}")
    _print(found.rows)
    print(f"written: {out}/motion.csv, trajectory.json, shown.json, motion.png")
    next_step(f"diagnose LOG --model {args.model}    once it is recorded, with the joints' torques")
    return 0


def csv_of(may: Allowed, found: Excitation) -> str:
    """Time in s, then angles [rad, m] and speeds of each joint; readable by `diagnose` as they
    are.
    """
    names = may.mechanism.tree.joint_names
    head = ["time", *(f"q_{n}" for n in names), *(f"v_{n}" for n in names)]
    rows = [[t, *q, *v] for t, q, v in zip(found.time, found.q, found.v, strict=True)]
    lines = [",".join(head), *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


def trajectory_of(may: Allowed, found: Excitation) -> dict[str, Any]:
    """A ROS trajectory_msgs/JointTrajectory."""
    points = []
    for t, q, v, a in zip(found.time, found.q, found.v, found.a, strict=True):
        second, rest = divmod(round(1e9 * t), 10**9)
        point = {"positions": q.tolist(), "velocities": v.tolist(), "accelerations": a.tolist()}
        points.append(point | {"time_from_start": {"sec": second, "nanosec": rest}})
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    names = list(may.mechanism.tree.joint_names)
    return {"header": header, "joint_names": names, "points": points}


def _print(rows: Sequence[Mapping[str, Any]]) -> None:
    print("what a recording of this motion, with torques, would show (power 0.8):")
    line = "  {:20}{:>10} {:15}{:>10}  {:30}{}"
    so_far = "so far" if "so_far" in rows[0] else ""
    print(line.format("effect", "named from", "", "alone from", "or else", so_far))
    where = ""
    for row in sorted(rows, key=itemgetter("where")):
        if row["where"] != where:
            where = row["where"]
            print(where)
        name, rival = row["name"].replace("_", " "), row["rival"] or ""
        sizes = [_size(row.get(key)) for key in ("size", "alone", "so_far")]
        print(line.format(name, sizes[0], row["unit"], sizes[1], rival, sizes[2] if so_far else ""))


def _size(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"
