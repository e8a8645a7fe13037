"""Parameters that AdaptSim and SysID-Bayes end with in OOD-1, on the map of the reward (paper,
figure 5).

Reads what `table1_pendulum.py` or `adaptsim compare pendulum` left; run one of them first.

python experiments/parameter_map.py --results results/results.json
"""

import json
from pathlib import Path

import numpy as np
from page import parser, write_page

from adaptsim_jax.baselines.bounds import pendulum_problem, reward_map
from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw
from adaptsim_jax.tasks.pendulum.task import PendulumConfig, pendulum_space


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument(
        "--results",
        type=Path,
        help="results.json of a comparison; default: OUT/table1_pendulum.json",
    )
    args = arguments.parse_args()
    source = args.results or args.out / "table1_pendulum.json"
    if not source.is_file():
        raise SystemExit(
            f"{source}: no such file; run `adaptsim compare pendulum --out DIR` and give "
            "DIR/results.json"
        )
    results = json.loads(source.read_text())
    args.out.mkdir(parents=True, exist_ok=True)
    setting = results["settings"]["ood-1"]
    # A box that reaches down to the target, to show what Omega does not offer.
    space = pendulum_space(PendulumConfig(b1=(1.0, 2.0)))
    found = reward_map(
        pendulum_problem(space),
        np.array(setting["params"]),
        (setting["udr_cost"], setting["best_cost"]),
        limits=((0.9, 2.1), (0.2, 2.1)),
        points=41,
    )
    rows = {
        r["method"]: r
        for r in results["rows"]
        if r["setting"] == "ood-1" and r["method"] in ("adaptsim", "sysid_bayes", "sysid_point")
    }
    points = {name: np.array(r["best_params"])[:, :2] for name, r in rows.items()}
    look.save(
        draw.parameter_map(found, setting["params"][:2], points), args.out / "parameter_map.png"
    )
    write_page(
        args.out,
        "parameter_map",
        "Parameters found in OOD-1",
        [text(results, rows, setting)],
        {},
        ["parameter_map.png"],
    )


def text(results, rows, setting) -> str:
    target = np.array(setting["params"])
    lines = [
        f"{results['seeds']} seeds; marks are the parameters of each seed's best policy, colours "
        "the largest reward over the dampings of Omega. The white box is Omega.",
        "",
        "| method | distance to the target (m1, m2), kg, median | dynamics discrepancy, rad, "
        "median | reward, mean |",
        "| --- | --- | --- | --- |",
    ]
    for name, r in rows.items():
        away = np.linalg.norm(np.array(r["best_params"])[:, :2] - target[:2], axis=1)
        lines.append(
            f"| {look.label(name)} | {np.median(away):.2f} | {r['discrepancy']['median']:.1f} | "
            f"{r['mean']:.2f} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
