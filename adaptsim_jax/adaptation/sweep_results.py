"""The table of a sweep: `results.csv` and `results.json`, and means with intervals by each swept
value.
"""

import csv
import io
import json
from typing import Any

import numpy as np

from adaptsim_jax.adaptation.sweep_folder import SCHEMA, SweepFolder
from adaptsim_jax.core.files import write_bytes, write_json
from adaptsim_jax.report.sweep_explore import TRAINING, earned, interval


def write_results(folder: SweepFolder) -> dict[str, Any]:
    """Write both files from the parts that are there; the same parts give the same bytes."""
    rows = folder.rows()
    found = {
        "schema": SCHEMA,
        "version": folder.head["version"],
        "spec": folder.head["spec"],
        "swept": folder.head["swept"],
        "members": len(folder.head["members"]),
        "done": sum(row["status"] == "done" for row in rows),
        "failed": sum(row["status"] == "failed" for row in rows),
        "summary": summary(rows, folder.head["swept"], folder.head["spec"]["targets"]),
        "rows": rows,
    }
    write_json(folder.path / "results.json", found)
    write_bytes(folder.path / "results.csv", _csv(found).encode())
    return found


def _csv(found: dict[str, Any]) -> str:
    out, targets = io.StringIO(), found["spec"]["targets"]
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        [
            "member",
            "seed",
            *found["swept"],
            "status",
            "reason",
            "train_reward",
            *[f"reward_{t}" for t in targets],
        ]
    )
    for row in found["rows"]:
        values = [_cell(row["values"].get(key)) for key in found["swept"]]
        rewards = [_cell(row.get("targets", {}).get(t, {}).get("reward")) for t in targets]
        train = _cell(row.get("train_reward"))
        writer.writerow(
            [row["member"], row["seed"], *values, row["status"], row["reason"], train, *rewards]
        )
    return out.getvalue()


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, list | dict | bool):
        return json.dumps(value)
    return value


def summary(
    rows: list[dict[str, Any]], swept: list[str], targets: list[str]
) -> list[dict[str, Any]]:
    """For each swept key, each of its values and each reward: the mean over the members that are
    done, with the half width of its 95 % interval (Student's) and what it is an interval over:
    seeds, each averaged over the other swept values first, since members of one seed go alike;
    members where all are of one seed; half is None where there is but one.
    """
    done = [row for row in rows if row["status"] == "done"]
    found = []
    for key in swept or [""]:
        levels: dict[str, list[dict[str, Any]]] = {}
        for row in done:
            levels.setdefault(json.dumps(row["values"].get(key)), []).append(row)
        for level, some in levels.items():
            for name in (TRAINING, *targets):
                found.append(
                    {"key": key, "value": json.loads(level), "reward": name}
                    | _over_seeds(some, name)
                )
    return found


def _over_seeds(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    pairs = [(row["seed"], earned(row, name)) for row in rows]
    by_seed: dict[int, list[float]] = {}
    for seed, reward in pairs:
        if reward is not None:
            by_seed.setdefault(seed, []).append(reward)
    rewards = [r for some in by_seed.values() for r in some]
    if len(by_seed) < 2:
        return interval(rewards) | {"over": "members", "members": len(rewards)}
    return interval([float(np.mean(some)) for some in by_seed.values()]) | {
        "over": "seeds",
        "members": len(rewards),
    }
