"""How an experiment leaves its result: a page in Markdown with the command that made it, its rows,
and its figures.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax import TrainConfig
from adaptsim_jax.adaptation.training import PRESETS, preset
from adaptsim_jax.baselines.results import normalised, plain, row
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.core.files import output_folder, write_bytes, write_json

RESULTS = Path("results")
START = time.monotonic()


def parser(doc: str | None, seeds: int = 20) -> argparse.ArgumentParser:
    """`--seeds`, `--out`, and for small sizes `--trajectories` of Phase 1 and `--simulations` of
    SysID.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=seeds)
    parser.add_argument(
        "--out", type=Path, default=RESULTS, help="folder of the page and its figures"
    )
    parser.add_argument(
        "--config", default="recommended", help=f"of AdaptSim: recommended, {', '.join(PRESETS)}"
    )
    parser.add_argument(
        "--trajectories", type=int, help="of Phase 1; default: the configuration's own"
    )
    parser.add_argument(
        "--simulations", type=int, help="of SysID, each iteration; default: its own"
    )
    return parser


def train_config(args: argparse.Namespace) -> TrainConfig:
    from dataclasses import replace

    config = TrainConfig() if args.config == "recommended" else preset(args.config)
    if args.trajectories:
        config = replace(config, phase1=replace(config.phase1, trajectories=args.trajectories))
    return config


def sysid_config(args: argparse.Namespace) -> SysIdConfig:
    return SysIdConfig(simulations=args.simulations) if args.simulations else SysIdConfig()


def scored_row(
    name: str, cost: np.ndarray, lower: float, upper: float, trials: int
) -> dict[str, Any]:
    """A row of results.json from costs `[S, N, I + 1]` in one target with normalisers `lower`,
    `upper`.
    """
    best = np.min(np.where(np.isfinite(cost), cost, np.inf), axis=1)
    curves = normalised(best[None], np.array([lower]), np.array([upper]))[0]
    failed = int(np.sum(~np.isfinite(cost)))
    return row(name, "", curves, oracle=None, target_trials=trials, failed=failed)


def rows_table(rows: Sequence[Mapping[str, Any]], first: str) -> str:
    """Rows with their spread over seeds; `first` heads the column of names."""
    lines = [
        f"| {first} | mean of best [95 %] | median of best [quartiles] | worst seed | last, mean "
        "| target rollouts | failed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        n = {
            k: "fails" if v is None else f"{v:.2f}"
            for k, v in r.items()
            if v is None or isinstance(v, float)
        }
        worst = "fails" if None in r["per_seed"] else f"{min(r['per_seed']):.2f}"
        lines.append(
            f"| {r['method']} | {n['mean']} [{n['low']}, {n['high']}] | {n['median']} [{n['q25']}, "
            f"{n['q75']}] | {worst} | {n['final_mean']} | {r['target_trials']} | {r['failed']} |"
        )
    return "\n".join(lines)


def write_page(
    out: Path, name: str, title: str, parts: Sequence[str], data: Any, figures: Sequence[str] = ()
) -> None:
    """`name.md` and `name.json` in `out`; `figures` are file names of PNG that lie there
    already.
    """
    out = output_folder(out)
    command = f"python {Path(sys.argv[0]).as_posix()} {' '.join(sys.argv[1:])}".strip()
    command = command[command.index("experiments/") :] if "experiments/" in command else command
    head = [
        f"# {title}",
        f"Made by `python {command.removeprefix('python ')}` in {time.monotonic() - START:.0f} s.",
    ]
    pictures = [f"![{title}]({figure})" for figure in figures]
    write_bytes(out / f"{name}.md", ("\n\n".join([*head, *pictures, *parts]) + "\n").encode())
    write_json(out / f"{name}.json", plain(data))
    print(f"written: {out / name}.md")
