"""`adaptsim doctor`: each backend is tried with a computation whose answer is known, and what an
adaptation trajectory of Phase 1 costs on this machine in each engine of a task.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import io
import json
import platform
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.core import process
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.core.parallel import cores

EXAMPLES = """
  adaptsim doctor
  adaptsim doctor --json > doctor.json     for a report of a fault
  adaptsim doctor --costs                  and what a trajectory of Phase 1 costs here in each engine; some minutes
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """0 where everything that the core needs works here, else 1."""
    from adaptsim_jax.commands.parser import next_step

    found = examine()
    rows = costs() if args.costs else iter(())
    if args.json:
        print(json.dumps(found | ({"costs": list(rows)} if args.costs else {}), indent=1))
        return int(bool(found["faults"]))
    show(found)
    for row in rows:
        print(cost_line(row), flush=True)
    if not found["faults"]:
        next_step("demo    the tour, a few minutes")
    return int(bool(found["faults"]))


# ---------------------------------------------------------------- what works

PACKAGES = tuple("jax jaxlib flax optax numpy scipy mujoco mujoco-mjx matplotlib drake".split())

EXTRAS = {
    "drake": "Drake as a reference engine",
    "environments": "environments of Playground, Brax and gymnax",
    "ros": "bags of ROS 1 and 2, MCAP",
    "lerobot": "data sets of LeRobot",
    "rerun": "a diagnosis for the viewer Rerun",
    "sbi": "sbi's estimators beside ours",
    "video": "films as MP4",
    "cluster": "sweeps over hosts by Ray",
}
"""What each optional part is for."""

_SCENE = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="hinge" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="1"/></body></worldbody></mujoco>"""  # noqa: E501


def examine() -> Table:
    """Versions, devices, backends, compile cache; `faults` has a line for each thing the core
    lacks.
    """
    versions = {name: _version(name) for name in PACKAGES}
    backends = {name: _try(trial) for name, trial in _TRIALS.items()}
    files, size = process.cache_size()
    found = {
        "schema": 1,
        "adaptsim_jax": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": cores(),
        "versions": versions,
        "devices": _devices(),
        "backends": backends,
        "absent_extras": [name for name in EXTRAS if not _has_extra(name)],
        "compile_cache": {"folder": str(process.cache_folder()), "files": files, "bytes": size},
    }
    found["faults"] = _faults(found)
    return found


def show(found: Table) -> None:
    """Print what `examine` found, for a person."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    console.print(
        f"adaptsim_jax {found['adaptsim_jax']}, Python {found['python']}, {found['platform']}"
    )
    versions = [f"{name} {version}" for name, version in found["versions"].items() if version]
    console.print(f"packages   {', '.join(versions)}")
    console.print(
        f"devices    {', '.join(found['devices']) or 'none'}; {found['cores']} cores to use"
    )
    for name, backend in found["backends"].items():
        if backend["works"]:
            mark = "[green]works[/green]"
        else:
            mark = "[yellow]absent[/yellow]"
        console.print(f"  {name:8} {mark}  {escape(backend['note'])}")
    for name in found["absent_extras"]:
        mend = f'pip install "adaptsim_jax[{name}]"'
        console.print(f"  {name:12} not installed: {EXTRAS[name]}; {mend}", markup=False)
    cache = found["compile_cache"]
    console.print(
        f"cache      {cache['folder']} ({cache['files']} files, {cache['bytes'] / 1e6:.1f} MB); "
        f"{process.CACHE_VARIABLE} names another, removing it is safe"
    )
    for fault in found["faults"]:
        console.print(f"[red]fault[/red]      {escape(fault)}")
    if not found["faults"]:
        console.print("everything that the core needs works here")


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _has_extra(name: str) -> bool:
    """Whether every package that an optional part asks for is installed."""
    lines = importlib.metadata.requires("adaptsim_jax") or []
    asked = [line for line in lines if re.search(f"extra == [\"']{name}[\"']", line)]
    return all(_version(re.split(r"[^\w.-]", line)[0]) for line in asked)


def _devices() -> list[str]:
    try:
        import jax

        return [f"{device.platform}:{device.id} ({device.device_kind})" for device in jax.devices()]
    except Exception as error:
        return [f"none ({_line(error)})"]


def _try(trial: Callable[[], str]) -> Table:
    start = time.perf_counter()
    try:
        # MJX says on its first import that optional parts are absent; that belongs in no report
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            note = trial()
        return {"works": True, "note": f"{note} ({time.perf_counter() - start:.1f} s)"}
    except Exception as error:
        return {"works": False, "note": _line(error)}


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _try_jax() -> str:
    import jax
    import jax.numpy as jnp

    solved = jax.jit(lambda x: jnp.linalg.solve(x, jnp.ones(2)).sum())
    value = float(solved(jnp.diag(jnp.array([2.0, 4.0]))))
    if abs(value - 0.75) > 1e-5:
        raise RuntimeError(f"a linear solve gave {value} for 0.75")
    return f"a compiled linear solve is right on {jax.default_backend()}"


def _swing_native(steps: int = 50) -> float:
    mujoco: Any = importlib.import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(_SCENE)
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return float(data.qpos[0])


def _try_native() -> str:
    angle = _swing_native()
    if not 0.5 < angle < 1.0:
        raise RuntimeError(f"a falling pendulum is at {angle} rad after 0.1 s")
    return f"a pendulum swings: {angle:.4f} rad after 0.1 s"


def _try_mjx() -> str:
    import jax

    mjx = mjx_module()
    mujoco: Any = importlib.import_module("mujoco")

    model = mujoco.MjModel.from_xml_string(_SCENE)
    device = mjx.put_model(model)
    data = mjx.make_data(model).replace(qpos=jax.numpy.array([1.0]))
    end = jax.jit(lambda d: jax.lax.fori_loop(0, 50, lambda _, x: mjx.step(device, x), d))(data)
    gap = abs(float(end.qpos[0]) - _swing_native())
    if not gap < 1e-4:
        raise RuntimeError(f"MJX differs from native MuJoCo by {gap} rad after 0.1 s")
    return f"agrees with native MuJoCo to {gap:.0e} rad"


def _try_drake() -> str:
    try:
        drake: Any = importlib.import_module("pydrake.all")
    except ImportError:
        raise RuntimeError("not installed; pip install adaptsim_jax[drake]") from None
    plant = drake.MultibodyPlant(0.001)
    plant.Finalize()
    return "a plant is built"


_TRIALS = {"jax": _try_jax, "native": _try_native, "mjx": _try_mjx, "drake": _try_drake}
_NEEDED = ("jax", "native", "mjx")


def _faults(found: Table) -> list[str]:
    backends, versions = found["backends"], found["versions"]
    faults = [
        f"{name}: {backends[name]['note']}" for name in _NEEDED if not backends[name]["works"]
    ]
    if versions["mujoco"] != versions["mujoco-mjx"]:
        faults.append(
            f"mujoco {versions['mujoco']} with mujoco-mjx {versions['mujoco-mjx']}: install one "
            "version"
        )
    return faults


# ---------------------------------------------------------------- what a trajectory costs

VISITS = 16  # at once; a GPU does more in the same time


ENGINES = {
    "pendulum": {"exact": ""},
    "pushing": {"planar": "", "native": "native-pushing", "mjx": "mjx-pushing"},
    "scooping": {"bank": "", "hydro": "hydro-scooping", "mjx": "mjx-scooping"},
}
"""For each task its engines, each with the preset that Phase 1 would be run with; empty: the task's
default.
"""


def costs(wanted: tuple[str, ...] = ()) -> Iterator[Table]:
    """A row for each task and engine (of the tasks `wanted`, by default all), as it is measured:
    seconds a trajectory, the visits alone, without what is learned from them and the training of
    task policies; and seconds to compile a visit.
    """
    for task in wanted or ENGINES:
        for engine in ENGINES[task]:
            yield {"task": task, "engine": engine} | measure(task, config_of(task, engine))


def config_of(task: str, engine: str) -> Any:
    """What Phase 1 would be run with in an engine."""
    from adaptsim_jax.adaptation.training import default_config, preset

    name = ENGINES[task][engine]
    if name:
        return preset(name)
    return default_config(task)


def measure(task: str, config: Any) -> Table:
    """`VISITS` visits of Phase 1 as `config` has them, of untrained policies at random means of E
    in random targets.
    """
    import jax

    from adaptsim_jax.space import gaussian
    from adaptsim_jax.tasks.registry import make_task

    made = make_task(task, config.task, "doctor")

    def visit(key):
        policy_key, mean_key, target_key, run_key = jax.random.split(key, 4)
        policy = made.init_policy(policy_key)
        if task == "pendulum":  # whose policies are solved for and not learned
            policy = made.train(
                policy_key, gaussian(made.space, made.space.sample(mean_key)), policy
            )
        target = made.targets.physical(made.targets.sample(target_key))
        trajectory = (made.rehearse or made.rollout)(run_key, policy, target)
        return made.observe(trajectory), made.reward(trajectory, made.reference(target))

    keys = jax.random.split(jax.random.key(0), VISITS)
    begin = time.perf_counter()
    program = jax.jit(jax.vmap(visit)).lower(keys).compile()
    compiled = time.perf_counter()
    jax.block_until_ready(program(keys))  # the first call starts what serves it
    again = time.perf_counter()
    jax.block_until_ready(program(keys))
    each = (time.perf_counter() - again) / VISITS
    return {"s_a_trajectory": each * (config.phase1.horizon + 1), "compile_s": compiled - begin}


def cost_line(row: Table) -> str:
    """A row for a person."""
    name = f"{row['task']} in {row['engine']}"
    return (
        f"cost       {name:20} {1e3 * row['s_a_trajectory']:9.2f} ms a trajectory (compiled in "
        f"{row['compile_s']:.0f} s)"
    )
