"""Real recordings: what is named, and the error on data that had no part in it.

    # every trial held out in turn
    python -m experiments.mechanism_rigs double_pendulum/rig_a --out rig_a.json
    # fitted on train, scored on validation
    python -m experiments.mechanism_rigs quadruped_legs --out quadruped.json

`experiments/rigs/rigs.toml` says what each is made of. Of a double pendulum everything (base
parameters, effects, which of them) is done without the trial that is scored; `declared` is the
declared model fitted to the other trials, `file` what is known beforehand. Errors are those of
`adaptsim replay`.
"""

import argparse
import json
import os
import shutil
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.account import reported
from adaptsim_jax.attribution.diagnose import HORIZON, diagnose
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.pendulum import declared_machine, in_the_plane
from adaptsim_jax.attribution.pendulum_diagnosis import first_parameters
from adaptsim_jax.attribution.replay import Replay, replay
from adaptsim_jax.diagnosis import read_pendulum
from adaptsim_jax.logs.quality.audit import audit, usable

RIGS = Path(__file__).parent / "rigs"


def data() -> Path:
    return Path(os.environ.get("ADAPTSIM_DATA", Path(__file__).parents[2] / "shared" / "data"))


def told(found: Replay) -> dict:
    return {
        "median": float(np.median(found.error)),
        "rms": float(np.sqrt(np.mean(found.error**2))),
        "joints": np.median(found.error, 0).tolist(),
        "ran_away": found.as_dict()["ran_away"],
    }


def names(report: dict) -> list[str]:
    return [
        f"{e['name']} at {e['where']} "
        + ", ".join(
            f"{k} {v['value']:.3g} [{v['low']:.3g}, {v['high']:.3g}]"
            for k, v in e["parameters"].items()
        )
        + (f" (or {', '.join(e['alternatives'])})" if e["alternatives"] else "")
        for e in report["effects"]
    ]


def left_out(rig: str, trial: str) -> dict:
    """Everything without one trial of a double pendulum, scored on that trial."""
    whole = read_pendulum(data() / "measured_double_pendulum" / rig)
    began = time.perf_counter()
    rest = whole.without([trial])
    rest = usable(rest, audit(rest))
    theta = first_parameters(rest)
    with tempfile.TemporaryDirectory() as folder:
        machine = declared_machine(rest, theta, Path(folder) / DECLARED)
        whole_run = examined(machine, narrow=in_the_plane)
        report, _ = reported(whole_run)
        found = whole_run.found
        one = whole.pick([trial])
        test = declared_machine(usable(one, audit(one)), theta, Path(folder) / "one.xml")
        scores = {
            key: told(replay(test, HORIZON, vector))
            for key, vector in (
                ("declared", found.null.fit.vector),
                ("after", found.final.fit.vector),
            )
        }
    seconds = time.perf_counter() - began
    return {
        "trial": trial,
        "verdict": report["verdict"],
        "named": names(report),
        "seconds": seconds,
        **scores,
    }


def trained(rig: str, horizon: float | None = None) -> dict:
    """Fitted on the train files and scored on the validation files."""
    given = tomllib.loads((RIGS / "rigs.toml").read_text())[rig]
    model = data() / given["model"] if "model" in given else RIGS / rig / "model.xml"
    horizon = given.get("horizon", HORIZON) if horizon is None else horizon
    with tempfile.TemporaryDirectory() as folder:
        parts = {}
        for part in ("train", "validation"):
            parts[part] = Path(folder) / part
            parts[part].mkdir()
            shutil.copy(model, parts[part] / "model.xml")
            text = 'task = "mechanism"\nmodel = "model.xml"\n' + given.get("meta", "")
            (parts[part] / "meta.toml").write_text(text)
            for pattern in given[part]:
                for file in sorted((data() / given["folder"]).glob(pattern)):
                    (parts[part] / file.name).symlink_to(file.resolve())
        began = time.perf_counter()
        report = diagnose(parts["train"], out=Path(folder) / "out")
        seconds = time.perf_counter() - began
        bare = diagnose(parts["train"], out=Path(folder) / "bare", effects=())
        on = parts["validation"]

        def error(m):
            return told(replay(load(on, m), horizon))

        scores = {
            "file": error(on / "model.xml"),
            "declared": error(Path(folder) / "bare" / "model.toml"),
            "after": error(Path(folder) / "out" / "model.toml"),
            "model_xml": error(Path(folder) / "out" / "model.xml"),
        }
    held = {k: report["error"][k] for k in ("before", "after")}
    return {
        "rig": rig,
        "verdict": report["verdict"],
        "named": names(report),
        "seconds": seconds,
        "horizon": horizon,
        "held_out_in_train": held,
        "bare": bare["verdict"],
        "validation": scores,
    }


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("rig")
    p.add_argument(
        "--out", type=Path, required=True, help="JSON file; trials that it has are not run again"
    )
    a = p.parse_args()
    if not a.rig.startswith("double_pendulum/"):
        result = trained(a.rig)
        a.out.write_text(json.dumps(result, indent=1))
        print(json.dumps(result, indent=1))
        return
    rig = a.rig.split("/")[1]
    rows = json.loads(a.out.read_text()) if a.out.exists() else []
    for trial in read_pendulum(data() / "measured_double_pendulum" / rig).trials:
        if trial.name not in {r["trial"] for r in rows}:
            rows.append(left_out(rig, trial.name))
            a.out.write_text(json.dumps(rows, indent=1))
            row = rows[-1]
            print(
                row["trial"],
                f"{row['declared']['median']:.4f} -> {row['after']['median']:.4f}",
                row["named"],
                f"{row['seconds']:.0f} s",
                flush=True,
            )
    ratio = np.array([r["after"]["median"] / r["declared"]["median"] for r in rows])
    pool = {k: np.median([r[k]["median"] for r in rows]) for k in ("declared", "after")}
    print(
        f"{rig}: median over trials {pool['declared']:.4f} -> {pool['after']:.4f} rad, ratio "
        f"{pool['after'] / pool['declared']:.2f}"
    )
    print(f"better in {(ratio < 1).sum()} of {len(ratio)} trials")


if __name__ == "__main__":
    main()
