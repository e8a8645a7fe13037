"""`adaptsim init`: a meta.toml for recordings of a mechanism, with guesses marked as such."""

from __future__ import annotations

import argparse
import json
import shlex
from typing import Any

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim init logs --model robot.xml                      writes logs/meta.toml
  adaptsim init run.mcap --model robot.urdf --out rig       writes rig/meta.toml, which names the bag
  adaptsim init run.mcap --out rig --command-topic /arm/commands
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Writes the file and says how the data read with it."""
    from adaptsim_jax.commands.parser import next_step
    from adaptsim_jax.logs.begin import begin

    topics = {"state_topic": args.state_topic, "command_topic": args.command_topic}
    begun = begin(
        args.data, args.out, args.model, {key: name for key, name in topics.items() if name}
    )
    if args.json:
        print(json.dumps(_answer(begun), indent=1))
        return 0
    print(f"wrote {begun.path}")
    print(f"{len(_guesses(begun.text))} guesses in it: check each line marked 'guess'")
    if begun.unused:
        print(
            f"columns that are not used: {', '.join(begun.unused)}; name those that matter under "
            "[columns]"
        )
    if begun.log is None:
        print(f"to mend before it reads: {begun.to_mend}")
        return 0
    log = begun.log
    seconds = sum(float(trial.time[-1] - trial.time[0]) for trial in log.trials)
    print(
        f"reads as {len(log.trials)} trial(s), {seconds:.4g} s, joints "
        f"{', '.join(log.joint_names)}, input: {log.input_kind}"
    )
    for note in log.notes:
        print(f"  {note}")
    next_step(f"diagnose {shlex.quote(str(begun.path.parent))} --out out")
    return 0


def _guesses(text: str) -> list[str]:
    """Lines marked 'guess', beside the first, which explains the mark."""
    return [line for line in text.splitlines()[1:] if "guess" in line]


def _answer(begun: Any) -> Table:
    """The file, its lines that are guesses, and the log as it reads (None, and what is to be
    mended, where it does not).
    """
    log = begun.log
    if log is None:
        reads = None
    else:
        reads = {
            "trials": len(log.trials),
            "joints": list(log.joint_names),
            "input": log.input_kind,
            "notes": list(log.notes),
            "seconds": sum(float(trial.time[-1] - trial.time[0]) for trial in log.trials),
        }
    return {
        "written": str(begun.path),
        "guesses": _guesses(begun.text),
        "unused": list(begun.unused),
        "reads": reads,
        "to_mend": None if log else begun.to_mend,
    }
