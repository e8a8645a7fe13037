"""One table of what the package's speed is beside its peers, at a small size: `make bench`, at most
ten minutes.

    python benchmarks/table.py --out bench             bench/table.json and bench/table.md
    python benchmarks/table.py --only phase1 engines   some of the parts
    python benchmarks/table.py --peer-python PYTHON    a Python that has torch and mujoco[sysid]

Each row is a process of its own, which has a number of XLA's host devices of its own; parts are run
in the order below, and what the time does not suffice for is said in the table. Rates are without
compile, which has a column of its own.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
LIMIT = 600.0  # s, of the whole; a sixth of it is the most that a row may take
OUT_OF_TIME = {"note": "not measured: out of time"}
POLICIES = (1, 16, 128, 1024)


def rows() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(part, what is measured, its arguments): what `measure` is told in a process of its own."""
    for learner in ("bdq", "naf"):
        for count in POLICIES:
            yield (
                "learners",
                f"{learner} updates, {count} policies at once",
                {"learner": learner, "policies": count},
            )
    for devices, seeds in ((1, 1), (1, 4), (2, 4), (2, 16)):
        what = f"phase 1 of the pendulum, {seeds} seeds at once on {devices} devices"
        yield "phase1", what, {"devices": devices, "seeds": seeds}
    for task, engines in {
        "pushing": ("planar", "native", "mjx"),
        "scooping": ("hydro", "native"),
    }.items():
        for engine in engines:
            yield "engines", f"{task} in {engine}", {"task": task, "engine": engine}
    yield "diagnose", "effects of a hinge beside a fit of its mass and damping", {}


# ---------------------------------------------------------------- in a process of its own


def measure(part: str, given: dict[str, Any], peer_python: str) -> dict[str, Any]:
    """unit, ours, compile_s, and where there is a peer: peer, peer_name, ratio."""
    found = {"learners": learners, "phase1": phase1, "engines": engines, "diagnose": diagnosis}[
        part
    ](peer_python=peer_python, **given)
    if found.get("peer"):
        found["ratio"] = found["ours"] / found["peer"]
    return found


def learners(learner: str, policies: int, peer_python: str, batch: int = 64) -> dict[str, Any]:
    """Updates a second of `policies` networks together (BDQ 128 x 128, NAF 64 x 64), beside
    PyTorch's in a loop.
    """
    if learner == "naf":
        from naf import compiled

        run, took = compiled(policies, batch, 64)
        script = ["naf_torch.py", "--policies", str(min(policies, 64))]
    else:
        run, took = _bdq(policies, batch)
        script = ["bdq_torch.py", "--policies", str(min(policies, 64))]
    return {"unit": "updates/s", "ours": run()[0], "compile_s": took} | beside(
        "PyTorch, a loop", peer_python, *script
    )


def beside(name: str, python: str, *script: str) -> dict[str, Any]:
    """The peer's rate, the first number of the last line that its script prints; or why there is
    none.
    """
    done = subprocess.run(
        [python, str(HERE / script[0]), *script[1:]], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return {"note": f"no peer ({name}): {(done.stderr.strip().splitlines() or ['?'])[-1][:80]}"}
    return {"peer": float(done.stdout.strip().splitlines()[-1].split()[0]), "peer_name": name}


def _bdq(policies: int, batch: int):
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.learners.bdq import BDQConfig, BDQHyper, make_bdq
    from adaptsim_jax.learners.replay import Transition

    bdq, rounds = make_bdq(BDQConfig(obs_dim=28, branches=4)), max(2, 512 // policies)
    state = jax.jit(jax.vmap(bdq.init))(jax.random.split(jax.random.key(0), policies))
    obs = jax.random.normal(jax.random.key(1), (policies, batch, 28))
    action = jax.random.randint(jax.random.key(2), (policies, batch, 4), 0, 3)
    one = jnp.ones((policies, batch))
    data, hyper = Transition(obs, action, one, obs, one), jax.tree.map(jnp.float32, BDQHyper())
    together = jax.vmap(bdq.update, in_axes=(0, 0, None))

    def many(state, data, hyper):
        return jax.lax.scan(
            lambda s, _: (together(s, data, hyper)[0], None), state, None, length=rounds
        )[0]

    begin = time.perf_counter()
    program = jax.jit(many).lower(state, data, hyper).compile()
    took = time.perf_counter() - begin

    def run():
        begin = time.perf_counter()
        jax.block_until_ready(program(state, data, hyper))
        return (rounds * policies / (time.perf_counter() - begin),)

    run()
    return run, took


def phase1(devices: int, seeds: int, peer_python: str) -> dict[str, Any]:
    """Adaptation steps a second of 10 rounds as the paper trains the pendulum, by the programs that
    a sweep runs.
    """
    import jax
    import numpy as np

    from adaptsim_jax.adaptation import sweep_plan
    from adaptsim_jax.adaptation.sweep_batch import make_programs
    from adaptsim_jax.adaptation.sweep_spec import Member, SweepSpec
    from adaptsim_jax.adaptation.training import preset

    config = preset("paper-pendulum")
    member = Member(0, {}, config)
    split = sweep_plan.choose_split(devices, seeds, config.phase1.parallel)
    programs = make_programs(SweepSpec("pendulum"), member, seeds, split)

    def put(x, batched=True):
        return sweep_plan.put(x, programs.mesh, batched)

    hyper = put(jax.tree.map(lambda x: np.full(seeds, x, np.float32), config.hyper))
    begin = time.perf_counter()
    state = programs.init((), put(np.arange(seeds, dtype=np.uint32)))
    state, _ = jax.block_until_ready(
        programs.advance((), state, hyper, put(np.arange(0, 10), False))
    )
    again = time.perf_counter()
    jax.block_until_ready(programs.advance((), state, hyper, put(np.arange(10, 20), False)))
    wall = time.perf_counter() - again
    steps = 10 * config.phase1.parallel * config.phase1.horizon * seeds
    return {"unit": "adaptation steps/s", "ours": steps / wall, "compile_s": again - begin - wall}


def engines(task: str, engine: str, peer_python: str) -> dict[str, Any]:
    """Trials a second of an engine, beside Drake on 4 of the same trials."""
    import numpy as np

    from adaptsim_jax import BadInput

    if task == "pushing":
        from adaptsim_jax.tasks.pushing import model
        from adaptsim_jax.tasks.pushing.engines import make_backend

        batch = model.draw(0, 64)
    else:
        from adaptsim_jax.tasks.scooping import model
        from adaptsim_jax.tasks.scooping.engines import make_backend

        batch = (*model.draw(0, 64), np.zeros((64, 2)))
    simulate = make_backend(engine).simulate
    begin = time.perf_counter()
    simulate(*batch)
    again = time.perf_counter()
    simulate(*batch)
    wall = time.perf_counter() - again
    found = {"unit": "trials/s", "ours": 64 / wall, "compile_s": again - begin - wall}
    try:
        drake, few = make_backend("drake").simulate, tuple(x[:4] for x in batch)
        begin = time.perf_counter()
        drake(*few)
    except BadInput as error:
        return found | {"note": f"no peer: {str(error)[:80]}"}
    return found | {"peer": 4 / (time.perf_counter() - begin), "peer_name": "Drake"}


def diagnosis(peer_python: str) -> dict[str, Any]:
    """Diagnoses a minute of 4 trials of 3 s of a hinge with dry friction, beside MuJoCo's fits of
    its mass and damping.
    """
    sys.path.insert(0, str(HERE.parent))
    from adaptsim_jax.attribution.diagnose import diagnose
    from tests.attribution.pendulum import record

    with tempfile.TemporaryDirectory() as folder:
        record(Path(folder), 0.1, trials=4, seconds=3.0)
        begin = time.perf_counter()
        diagnose(folder, out=None)
        again = time.perf_counter()
        diagnose(folder, out=None)
        wall = time.perf_counter() - again
        found = {"unit": "a minute", "ours": 60 / wall, "compile_s": again - begin - wall}
        return found | beside("mujoco.sysid, fits", peer_python, "mujoco_sysid.py", folder)


# ---------------------------------------------------------------- the table


def apart(part: str, given: dict[str, Any], peer_python: str, seconds: float) -> dict[str, Any]:
    """`measure` in a process of its own, at most for so long; what went wrong is the row's note."""
    flags = (
        f"{os.environ.get('XLA_FLAGS', '')} "
        f"--xla_force_host_platform_device_count={given.get('devices', 1)}"
    )
    command = [
        sys.executable,
        __file__,
        "--row",
        json.dumps([part, given]),
        "--peer-python",
        peer_python,
    ]
    environment = os.environ | {"XLA_FLAGS": flags.strip(), "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return OUT_OF_TIME
    if done.returncode:
        return {"note": f"failed: {(done.stderr.strip().splitlines() or ['?'])[-1][:120]}"}
    return json.loads(done.stdout.strip().splitlines()[-1])


def markdown(table: dict[str, Any]) -> str:
    def number(x):
        return "" if x is None else f"{x:,.0f}" if x >= 100 else f"{x:.3g}"

    lines = [
        f"{table['machine']}, {table['cores']} cores, {table['date']}; compile apart.",
        "",
        "| what | ours | peer | ratio | compile, s |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in table["rows"]:
        ours = f"{number(row['ours'])} {row['unit']}" if "ours" in row else row.get("note", "")
        peer = (
            f"{number(row['peer'])} ({row['peer_name']})"
            if "peer" in row
            else row.get("note", "") * ("ours" in row)
        )
        lines.append(
            f"| {row['what']} | {ours} | {peer} | {number(row.get('ratio'))} | "
            f"{number(row.get('compile_s'))} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("bench"))
    parser.add_argument("--only", nargs="+", choices=["learners", "phase1", "engines", "diagnose"])
    parser.add_argument(
        "--limit", type=float, default=LIMIT, metavar="S", help="seconds in all (600)"
    )
    parser.add_argument("--peer-python", default=sys.executable)
    parser.add_argument("--row", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        part, given = json.loads(args.row)
        print(json.dumps(measure(part, given, args.peer_python)))
        return
    args.out.mkdir(parents=True, exist_ok=True)
    end, made = time.monotonic() + args.limit, []
    for part, what, given in rows():
        if args.only and part not in args.only:
            continue
        left = end - time.monotonic()
        found = (
            apart(part, given, args.peer_python, min(left, args.limit / 6))
            if left > 5
            else OUT_OF_TIME
        )
        made.append({"part": part, "what": what} | found)
        print(json.dumps(made[-1]), flush=True)
    table = {
        "machine": platform.platform(),
        "cores": os.cpu_count(),
        "date": time.strftime("%Y-%m-%d"),
        "rows": made,
    }
    (args.out / "table.json").write_text(json.dumps(table, indent=1) + "\n")
    (args.out / "table.md").write_text(markdown(table))


if __name__ == "__main__":
    main()
