"""A sweep of the pendulum that is as small as may be, and how to run the command in a process of
its own.
"""

import os
import subprocess
import sys

SPEC = """task = "pendulum"
seeds = 2
targets = ["wd", "ood-1"]
iterations = 3

[set]
every = 2
task.scaling = "paper"
task.reference = "optimum"
phase1.trajectories = 64
phase1.parallel = 8
phase1.updates = 2
phase1.batch = 8
phase1.hidden = [8]
phase1.capacity = 256
phase1.archive = 256
phase1.horizon = 4

[grid]
hyper.delta = [0.1, 0.15]
"hyper.learner.learning_rate" = [3e-4, 1e-3]
"""


def write(folder, text=SPEC):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "SPEC.toml"
    path.write_text(text)
    return path


def environment(devices=1):
    """Without strict promotion, which a user does not set; `devices` of the CPU."""
    given = {k: v for k, v in os.environ.items() if k != "JAX_NUMPY_RANK_PROMOTION"}
    flags = os.environ.get("XLA_FLAGS", "")
    return given | {"XLA_FLAGS": f"{flags} --xla_force_host_platform_device_count={devices}"}


def start(words, devices=1):
    command = [sys.executable, "-m", "adaptsim_jax.cli", "sweep", *map(str, words)]
    return subprocess.Popen(
        command,
        env=environment(devices),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def run(words, devices=1):
    """What the command printed; it must end well."""
    process = start(words, devices)
    said = process.communicate(timeout=500)[0]
    assert process.returncode == 0, said
    return said


def table(folder):
    return (folder / "results.csv").read_bytes(), (folder / "results.json").read_bytes()
