"""`adaptsim sweep`."""

from __future__ import annotations

import argparse
import os
import shlex
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim sweep SPEC.toml --out sweeps/a
  adaptsim sweep SPEC.toml --out sweeps/a --resume       go on after a kill, to the same bits
  adaptsim sweep SPEC.toml --estimate                    members, programs and memory; nothing is run
  adaptsim sweep show sweeps/a                           table, figures and page of what is done so far
  adaptsim sweep SPEC.toml --out sweeps/a --ray          members shared out by Ray, here or on its cluster
  srun adaptsim sweep SPEC.toml --out sweeps/a --hosts slurm
SPEC.toml, for instance:
  task = "pendulum"
  preset = "paper-pendulum"
  seeds = 16
  targets = ["wd", "ood-1"]
  [set]
  phase1.trajectories = 2000
  [grid]
  hyper.delta = [0.1, 0.15]
  hyper.learner.learning_rate = [3e-4, 1e-3]
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Run, resume or show a sweep."""
    from adaptsim_jax.core.errors import BadInput

    if args.words[0] == "show":
        if len(args.words) != 2:
            raise BadInput("show: write `adaptsim sweep show DIR`")
        from adaptsim_jax.adaptation.sweep_folder import SweepFolder

        return _finish(SweepFolder.load(Path(args.words[1])), args.json)
    if len(args.words) != 1:
        raise BadInput(
            f"'{args.words[1]}': one SPEC.toml at a time; or write `adaptsim sweep show DIR`"
        )
    if not args.out and not args.estimate:
        raise BadInput(
            "--out is missing; name the folder to write, or add --estimate to run nothing"
        )
    _set_up_devices(args)
    return _sweep(args)


def _set_up_devices(args: argparse.Namespace) -> None:
    """Before JAX is there: a device for each core of a CPU, which members of a batch run on without
    waiting for each other.
    """
    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.parallel import cores

    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_force_host_platform_device_count" not in flags:
        os.environ["XLA_FLAGS"] = (
            f"{flags} --xla_force_host_platform_device_count={args.devices or cores()}".strip()
        )
    if args.hosts and args.ray is not None:
        raise BadInput(
            "--hosts and --ray: one program over hosts, or members shared out; leave one out"
        )
    if args.hosts in (None, "slurm"):
        if args.processes is not None or args.process is not None:
            raise BadInput("--processes, --process: go with --hosts HOST:PORT; add it")
        return
    if args.processes is None or args.process is None or not 0 <= args.process < args.processes:
        raise BadInput(f"--hosts {args.hosts}: give --processes N and --process I, from 0 to N - 1")


def _sweep(args: argparse.Namespace) -> int:
    import jax

    from adaptsim_jax.adaptation import sweep_plan
    from adaptsim_jax.adaptation.sweep_folder import locked
    from adaptsim_jax.adaptation.sweep_read import read_sweep
    from adaptsim_jax.commands.parser import output

    spec = args.words[0]
    sweep = read_sweep(spec)
    if args.hosts:
        where = None if args.hosts == "slurm" else args.hosts
        sweep_plan.join(where, args.processes, args.process)
    first = sweep_plan.first()
    devices, at_once = len(jax.devices()), args.at_once
    if args.ray is not None:  # a batch goes to a worker, which has a device of its own
        devices, at_once = 1, at_once or sweep_plan.PER_CORE
    plan = sweep_plan.make_plan(sweep, devices=devices, at_once=at_once)
    if first and not args.json:
        if sweep.spec.targets:
            targets = f", each in {', '.join(sweep.spec.targets)}"
        else:
            targets = ""
        print(f"{len(sweep.members)} members of {sweep.spec.task}{targets}")
        print("\n".join(sweep_plan.described(plan)), flush=True)
    if args.estimate:
        return 0
    args.resume_hint = (
        f"go on with: adaptsim sweep {shlex.quote(spec)} --out {shlex.quote(args.out)} --resume"
    )
    if not first:
        return _work(args, sweep, plan, Path(args.out))
    with output(args.out) as out, locked(out):
        return _work(args, sweep, plan, out)


def _work(args: argparse.Namespace, sweep: Any, plan: Any, out: Path) -> int:
    from adaptsim_jax.adaptation import sweep_plan
    from adaptsim_jax.adaptation.sweep_run import run_sweep
    from adaptsim_jax.core.progress import progress

    folder = _folder(args, sweep, plan, out)
    with progress("sweep") as report:
        if args.ray is not None:
            from adaptsim_jax.adaptation.sweep_run import run_on_ray

            run_on_ray(sweep, folder, args.ray or None, progress=report, save_after=args.save_every)
        else:
            run_sweep(sweep, folder, progress=report, save_after=args.save_every)
    if sweep_plan.first():
        return _finish(folder, args.json)
    return 0


def _folder(args: argparse.Namespace, sweep: Any, plan: Any, out: Path) -> Any:
    from adaptsim_jax.adaptation.sweep_folder import HEAD, SweepFolder
    from adaptsim_jax.adaptation.sweep_plan import agreed, first
    from adaptsim_jax.core.errors import BadInput

    there = first() and (out / HEAD).exists()
    if there and not args.resume:
        raise BadInput(f"{out}: holds a sweep already; add --resume, or name another folder")
    if first() and not there:
        SweepFolder.create(out, sweep, plan)
    agreed(True)  # the first program has written it when the others read
    return SweepFolder.reopen(out, sweep)


def _finish(folder: Any, as_json: bool) -> int:
    from adaptsim_jax.adaptation.sweep_folder import write_results
    from adaptsim_jax.commands.parser import next_step, print_file
    from adaptsim_jax.report.sweep_page import write_sweep_page

    found = write_results(folder)
    page = write_sweep_page(found, folder.path)
    if as_json:
        print_file(folder.path / "results.json")
        return 0
    _print(found)
    print(f"written: {folder.path / 'results.csv'}, results.json, and {page}")
    next_step(
        f"sweep show {shlex.quote(str(folder.path))}    at any time, also beside a sweep that runs"
    )
    return 0


def _print(found: Table) -> None:
    left = found["members"] - found["done"] - found["failed"]
    print(f"{found['done']} members done, {found['failed']} failed, {left} left")
    for row in [r for r in found["rows"] if r["status"] == "failed"][:5]:
        print(f"  failed: member {row['member']}, seed {row['seed']}: {row['reason']}")
    for line in found["summary"]:
        if line["mean"] is not None:
            if line["key"]:
                name = f"{line['key']} = {line['value']}"
            else:
                name = "all"
            if line["half"] is not None:
                half = f" +- {line['half']:.3f}"
            else:
                half = ""
            print(f"  {name}, {line['reward']}: {line['mean']:.3f}{half} ({line['count']})")
