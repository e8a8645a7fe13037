"""A sweep on disk: what it is (`sweep.json`), who works on it (`lock`), finished batches (`parts/`),
checkpoints (`work/`), and its table: `results.csv` and `results.json`, with means and intervals by
each swept value.
"""  # noqa: E501

import contextlib
import csv
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax import __version__
from adaptsim_jax.adaptation import sweep_plan as plans
from adaptsim_jax.adaptation.sweep_plan import MemberBatch, SweepPlan
from adaptsim_jax.adaptation.sweep_spec import Sweep
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import one_writer, output_folder, write_bytes, write_json
from adaptsim_jax.core.store import SCHEMA, check_version
from adaptsim_jax.report.sweep_figures import TRAINING, earned, interval

HEAD = "sweep.json"


class SweepFolder:
    """The folder of a sweep; made by `create` or `reopen`, read by `load`. head: What `sweep.json`
    holds.
    """

    def __init__(self, path: Path, head: Table):
        self.path, self.head = path, head
        self.plan: SweepPlan = plans.from_table(head["plan"])

    @classmethod
    def create(cls, path: Path, sweep: Sweep, plan: SweepPlan) -> "SweepFolder":
        """A new sweep in an empty or new folder."""
        head = described(sweep) | {"plan": plans.to_table(plan)}
        for name in ("parts", "work"):
            output_folder(path / name)
        write_json(path / HEAD, head)
        return cls(path, head)

    @classmethod
    def load(cls, path: Path) -> "SweepFolder":
        """A sweep that is there, to read; BadInput where there is none or it is another
        version's.
        """
        try:
            head = json.loads((path / HEAD).read_bytes())
        except FileNotFoundError:
            raise BadInput(
                f"{path}: no sweep here (no {HEAD}); name the --out of `adaptsim sweep`"
            ) from None
        except (OSError, ValueError) as error:
            raise BadInput(
                f"{path / HEAD}: cannot be read ({error}); name another folder"
            ) from None
        if not isinstance(head, dict) or "plan" not in head:
            raise BadInput(f"{path / HEAD}: not a sweep; start it anew in another folder")
        check_version(path / HEAD, head)
        return cls(path, head)

    @classmethod
    def reopen(cls, path: Path, sweep: Sweep) -> "SweepFolder":
        """A sweep that is there, to go on with; BadInput names what SPEC.toml says otherwise
        now.
        """
        folder = cls.load(path)
        want = json.loads(json.dumps(described(sweep)))
        changed = configs.differences(folder.head["spec"], want["spec"])
        if not changed and folder.head["members"] != want["members"]:
            changed = ["members: the defaults of another version"]
        if changed:
            raise BadInput(
                f"{path}: this sweep was started otherwise ({'; '.join(changed)}); ask for the "
                "same, or name another"
            )
        return folder

    def part(self, batch: MemberBatch) -> Path:
        return self.path / "parts" / f"{batch.name}.json"

    def work(self, batch: MemberBatch, members: list[Any]) -> Path:
        """Where the checkpoint of these members of a batch is kept."""
        return self.path / "work" / f"{batch.name}-{members[0].index}-{members[-1].index}"

    def left(self) -> list[MemberBatch]:
        """Batches without a part."""
        return [batch for batch in self.plan.batches if not self.part(batch).exists()]

    def finish(self, batch: MemberBatch, rows: list[Table]) -> None:
        """Keep the rows of a batch, whole or not at all; its checkpoints are of no use then."""
        write_json(self.part(batch), {"schema": SCHEMA, "rows": rows})
        self.clear(batch)

    def clear(self, batch: MemberBatch) -> None:
        for old in (self.path / "work").glob(f"{batch.name}-*"):
            shutil.rmtree(old, ignore_errors=True)

    def rows(self) -> list[Table]:
        """Rows of all finished batches, by member."""
        found = []
        for batch in self.plan.batches:
            if self.part(batch).exists():
                found += json.loads(self.part(batch).read_bytes())["rows"]
        return sorted(found, key=lambda row: row["member"])


def described(sweep: Sweep) -> Table:
    """What is run, as plain data: the spec and, for each member, its values and the digest of its
    whole configuration.
    """
    spec = {k: v for k, v in configs.to_table(sweep.spec).items() if v is not None}
    return {
        "schema": SCHEMA,
        "version": __version__,
        "spec": spec,
        "swept": list(sweep.swept),
        "members": [
            {
                "values": m.values,
                "seed": m.config.seed,
                "config": configs.digest(configs.to_table(m.config)),
            }
            for m in sweep.members
        ],
    }


def locked(path: Path) -> contextlib.AbstractContextManager[None]:
    """Hold the folder; BadInput says who does if another process."""
    return one_writer(path, "lock", "is held by {holder}; wait for it, or name another folder")


def write_results(folder: SweepFolder) -> Table:
    """Write both files from the parts that are there; the same parts give the same bytes."""
    rows, head = folder.rows(), folder.head
    states = [row["status"] for row in rows]
    found = {
        "schema": SCHEMA,
        "version": head["version"],
        "spec": head["spec"],
        "swept": head["swept"],
        "members": len(head["members"]),
        "done": states.count("done"),
        "failed": states.count("failed"),
        "summary": summary(rows, head["swept"], head["spec"]["targets"]),
        "rows": rows,
    }
    write_json(folder.path / "results.json", found)
    write_bytes(folder.path / "results.csv", _csv(found).encode())
    return found


def _csv(found: Table) -> str:
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


def summary(rows: list[Table], swept: list[str], targets: list[str]) -> list[Table]:
    """For each swept key, each of its values and each reward, the mean over the members that are
    done. Beside it stands the half width of its 95 % interval (Student's), None of a single one.

    The interval is over seeds, each averaged over the other swept values first, since members of
    one seed go alike. Where all are of one seed it is over members.
    """
    done = [row for row in rows if row["status"] == "done"]
    found = []
    for key in swept or [""]:
        levels: dict[str, list[Table]] = {}
        for row in done:
            levels.setdefault(json.dumps(row["values"].get(key)), []).append(row)
        for level, some in levels.items():
            for name in (TRAINING, *targets):
                found.append(
                    {"key": key, "value": json.loads(level), "reward": name}
                    | _over_seeds(some, name)
                )
    return found


def _over_seeds(rows: list[Table], name: str) -> Table:
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
