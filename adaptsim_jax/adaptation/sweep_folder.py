"""A sweep on disk: what it is (`sweep.json`), who works on it (`lock`), finished batches
(`parts/`), and checkpoints (`work/`).
"""

import contextlib
import json
import os
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.adaptation import sweep_plan as plans
from adaptsim_jax.adaptation.sweep_plan import Batch, Plan
from adaptsim_jax.adaptation.sweep_spec import Sweep
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_errors, output_folder, write_json
from adaptsim_jax.core.store import SCHEMA, check_version

HEAD = "sweep.json"


class SweepFolder:
    """The folder of a sweep; made by `create` or `reopen`, read by `load`. head: what `sweep.json`
    holds.
    """

    def __init__(self, path: Path, head: dict[str, Any]):
        self.path, self.head = path, head
        self.plan: Plan = plans.from_table(head["plan"])

    @classmethod
    def create(cls, path: Path, sweep: Sweep, plan: Plan) -> "SweepFolder":
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
                f"same, or name another"
            )
        return folder

    def part(self, batch: Batch) -> Path:
        return self.path / "parts" / f"{batch.name}.json"

    def work(self, batch: Batch, members: list[Any]) -> Path:
        """Where the checkpoint of these members of a batch is kept."""
        return self.path / "work" / f"{batch.name}-{members[0].index}-{members[-1].index}"

    def left(self) -> list[Batch]:
        """Batches without a part."""
        return [batch for batch in self.plan.batches if not self.part(batch).exists()]

    def finish(self, batch: Batch, rows: list[dict[str, Any]]) -> None:
        """Keep the rows of a batch, whole or not at all; its checkpoints are of no use then."""
        write_json(self.part(batch), {"schema": SCHEMA, "rows": rows})
        self.clear(batch)

    def clear(self, batch: Batch) -> None:
        for old in (self.path / "work").glob(f"{batch.name}-*"):
            shutil.rmtree(old, ignore_errors=True)

    def rows(self) -> list[dict[str, Any]]:
        """Rows of all finished batches, by member."""
        found = []
        for batch in self.plan.batches:
            if self.part(batch).exists():
                found += json.loads(self.part(batch).read_bytes())["rows"]
        return sorted(found, key=lambda row: row["member"])


def described(sweep: Sweep) -> dict[str, Any]:
    """What is run, as plain data: the spec and, for each member, its values and the digest of its
    whole configuration.
    """
    return {
        "schema": SCHEMA,
        "version": __version__,
        "spec": {k: v for k, v in configs.to_table(sweep.spec).items() if v is not None},
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


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the folder; BadInput says who does if another process. The system lets go when a process
    ends, however it ends.
    """
    try:
        import fcntl
    except ImportError:  # Windows: one has to see to it oneself
        yield
        return
    with output_errors(path / "lock"), open(path / "lock", "a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().strip() or "another process"
            raise BadInput(
                f"{path}: is held by {holder}; wait for it, or name another folder"
            ) from None
        file.seek(0)
        file.truncate()
        file.write(
            f"process {os.getpid()} on {socket.gethostname()} since "
            f"{time.strftime('%Y-%m-%d %H:%M:%S')}\n"
        )
        file.flush()
        yield
