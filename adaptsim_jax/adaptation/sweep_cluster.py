"""Batches of a sweep shared out by Ray (the extra `[cluster]`): on this machine, or on a cluster
that shares the sweep's folder.

A batch is one task of Ray's. Where its worker dies the task is run again, from the batch's last
checkpoint; only this process writes parts, each once, so that nothing is lost and nothing counts
twice.
"""

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from adaptsim_jax.adaptation.sweep_folder import SweepFolder
from adaptsim_jax.adaptation.sweep_spec import Sweep
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent

RETRIES = 5  # of a batch whose worker died


def run_on_ray(
    sweep: Sweep,
    folder: SweepFolder,
    address: str | None,
    *,
    progress: Callable = silent,
    save_after: float = 30.0,
    cpus: float = 1.0,
) -> None:
    """All batches that are left, `cpus` cores each; address: of a cluster that runs (`auto`: of
    this machine's), else one is started here for as long as this lasts. BadInput where Ray is
    absent or does not answer.
    """
    ray = _ray()
    gpus = 1.0 if _gpus(ray, address) else 0.0
    try:
        work = ray.remote(num_cpus=cpus, num_gpus=gpus, max_retries=RETRIES)(_batch)
        shared = ray.put((sweep, str(folder.path.resolve())))
        waiting = {work.remote(shared, batch.number, save_after): batch for batch in folder.left()}
        count = len(folder.plan.batches)
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1)
            batch = waiting.pop(ready[0])
            folder.finish(batch, _rows(ray, ready[0], sweep, folder, batch))
            progress(count - len(waiting), count, "")
    finally:
        ray.shutdown()


def _rows(
    ray: Any, task: Any, sweep: Sweep, folder: SweepFolder, batch: Any
) -> list[dict[str, Any]]:
    """What a task found; where its worker died again and again, its members are failed, with that
    reason.
    """
    from adaptsim_jax.adaptation.sweep_run import failed_row, members_of

    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError:
        raise  # bad input, or a fault of the program: the same anywhere
    except ray.exceptions.RayError as error:
        reason = f"the worker was lost {RETRIES + 1} times: {' '.join(str(error).split())[:200]}"
        return [failed_row(member, reason) for member in members_of(sweep, folder, batch)]


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise BadInput(
            "--ray: Ray is not installed; pip install 'adaptsim_jax[cluster]', or leave --ray out"
        ) from None


def _gpus(ray: Any, address: str | None) -> int:
    """Join or start Ray; how many GPUs it has."""
    # a worker needs this process's settings (the compile cache among them), and none of its devices
    kept = {
        k: v
        for k, v in os.environ.items()
        if k.startswith(("JAX_", "PYTHONPATH", "OPENBLAS", "OMP", "XLA_FLAGS"))
    }
    kept["XLA_FLAGS"] = " ".join(
        w for w in kept.get("XLA_FLAGS", "").split() if "device_count" not in w
    )
    settings = {
        "log_to_driver": False,
        "configure_logging": False,
        "runtime_env": {"env_vars": kept},
    }
    try:
        ray.init(address=address, **settings) if address else ray.init(
            include_dashboard=False, **settings
        )
    except (ConnectionError, ValueError) as error:
        raise BadInput(
            f"--ray {address}: {' '.join(str(error).split())[:200]}; start it with `ray start "
            f"--head`"
        ) from None
    except Exception as error:  # of no class of its own
        if "timed out during startup" not in str(error):
            raise
        raise BadInput(
            "--ray: Ray did not start within its 30 s; on a busy machine try again, with --resume"
        ) from None
    return int(ray.cluster_resources().get("GPU", 0))


def _batch(shared: Any, number: int, save_after: float) -> list[dict[str, Any]]:
    """One batch, in a worker."""
    from adaptsim_jax.adaptation.sweep_run import Held, rows_of

    sweep, path = shared
    folder = SweepFolder.load(Path(path))
    return rows_of(
        Held(sweep, folder), folder.plan.batches[number], lambda rounds, note: None, save_after
    )
