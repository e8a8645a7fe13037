"""The one signature of all physics backends: same scene, same parameters, same trajectory type;
and several of them on the same batch, timed and compared pair by pair.
"""

from __future__ import annotations

import importlib
import itertools
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report
from adaptsim_jax.core.registry import Registry

Array = Any
S = TypeVar("S")


class Trajectory(NamedTuple):
    """`state: [B, T, S]` (positions, then velocities; rad, rad/s) after each command row.

    `code: [B]` is 0, or 1 where the motion ceased to be finite.
    """

    state: Array
    code: Array


class EngineKind(NamedTuple):
    """An engine as a registry of backends holds it: `make(options, *settings) -> simulate`, of
    `Backend`.

    options: The task's own (`PushOptions`, `ScoopOptions`; of the pendulum its step [s]). settings:
    a NamedTuple of what is the engine's alone, with defaults. `make` raises BadInput where the
    engine is absent or cannot do the options.
    """

    settings: type
    make: Callable[..., Callable[[Array, Array, Array], Trajectory]]


class NoSettings(NamedTuple):
    """Of an engine that has none of its own."""


class Backend(NamedTuple):
    """`simulate(params [B, P], commands [B, T, U], initial [B, S]) -> Trajectory`, rows held for a
    step.
    """

    name: str
    simulate: Callable[[Array, Array, Array], Trajectory]


class Engines(Registry[EngineKind]):
    """The engines of a task by name.

    own: Where the records of ours stand. default: Options where none are given; check: `(engine,
    options) -> options`, BadInput where no engine can do them. called: What options are called
    where they may be given by name.
    """

    def __init__(
        self,
        task: str,
        own: Mapping[str, str],
        default: Any,
        check: Callable[[str, Any], Any],
        called: str = "",
    ):
        super().__init__("backends", own, within=task)
        self.default, self.check, self.called = default, check, called

    def make(self, name: str, options: Any = None, /, **settings: Any) -> Backend:
        """A backend for `options`; `settings` are the engine's own, records may be given as tables.
        BadInput where the name is unknown, the engine absent, or unable.
        """
        kind = self.named(name, "backend")
        if options is None:
            options = settings.pop(self.called, self.default)
        checked = self.check(name, options)
        return Backend(name, kind.make(checked, *own_settings(name, kind.settings, settings)))


def own_settings(engine: str, kind: type[S], settings: Table) -> S:
    """An engine's own `settings` as its record `kind`, whose defaults stand for what is left out;
    tables become records.

    BadInput names an unknown key or a value of another type.
    """
    made = config.from_table(kind, settings, f"backend {engine}")
    for name in ("threads", "batch"):
        count = getattr(made, name, None)
        if count is not None and count < 1:
            raise BadInput(f"backend {engine}, {name} = {count}: give at least 1, or leave it out")
    return made


def checked_batch(task: str, arrays: Mapping[str, Any], widths: Sequence[int]) -> list[np.ndarray]:
    """`arrays` by name as float64 `[B, width]` each; BadInput where shapes do not fit together."""
    found = [np.asarray(array, float) for array in arrays.values()]
    count = len(found[0]) if found[0].ndim else "B"
    for name, array, width in zip(arrays, found, widths, strict=True):
        if array.ndim != 2 or array.shape[1] != width or len(array) != len(found[0]):
            shape = list(array.shape)
            raise BadInput(f"{task}, {name}: has shape {shape}; give [{count}, {width}]")
    return found


def steps_a_row(what: str, dt: float, row: float, usual: float) -> int:
    """How many steps of `dt` s make a row of `row` s. BadInput where they do not. usual: A step
    that does.
    """
    every = round(row / dt) if dt > 0 else 0
    if every < 1 or abs(row / dt - every) > 1e-6:
        raise BadInput(f"{what}, dt = {dt} s must divide the row of {row} s; use {usual}")
    return every


def filled_batches(count: int, size: int) -> list[tuple[slice, np.ndarray]]:
    """Where each batch of `size` goes, and its samples. The last one is filled up, so that one size
    is compiled.
    """
    return [
        (slice(at, min(at + size, count)), np.minimum(np.arange(at, at + size), count - 1))
        for at in range(0, count, size)
    ]


def drake_modules() -> Any:
    """`pydrake.all`; BadInput where Drake is not installed."""
    try:
        return importlib.import_module("pydrake.all")
    except ImportError:
        raise BadInput(
            "backend drake is not installed; pip install 'adaptsim_jax[drake]'"
        ) from None


class DrakeWorld:
    """A Drake plant with hydroelastic contact in steps of `dt` s.

    solver: Drake's contact approximation. resolution: m, of the pressure field of what is soft.
    """

    def __init__(self, drake: Any, dt: float, solver: str, resolution: float):
        self.drake, self.resolution = drake, resolution
        self.builder = drake.DiagramBuilder()
        config = drake.MultibodyPlantConfig(
            time_step=dt,
            discrete_contact_approximation=solver,
            contact_model="hydroelastic_with_fallback",
        )
        self.plant, self.graph = drake.AddMultibodyPlant(config, self.builder)

    def built(self) -> None:
        """The simulator and its context, once the plant is final."""
        self.simulator = self.drake.Simulator(self.builder.Build())
        self.context = self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def surface(self, friction: float, modulus: float | None = None, **material: Any) -> Any:
        """Proximity properties of a rigid surface, or of a soft one of `modulus` Pa."""
        d = self.drake
        properties = d.ProximityProperties()
        if modulus is None:
            d.AddRigidHydroelasticProperties(0.1, properties)
        else:
            d.AddCompliantHydroelasticProperties(self.resolution, modulus, properties)
        coulomb = d.CoulombFriction(friction, friction)
        d.AddContactMaterial(friction=coulomb, properties=properties, **material)
        return properties

    def collide(self, body: Any, at: Any, shape: Any, name: str, properties: Any) -> None:
        """A geometry of `body` that touches; at: its middle `[3]` m, or its pose."""
        pose = at if isinstance(at, self.drake.RigidTransform) else self.drake.RigidTransform(at)
        self.plant.RegisterCollisionGeometry(body, pose, shape, name, properties)

    def bodies(self, model: Any, inertia: Any, *names: str) -> list[Any]:
        """Bodies of a model, all with one spatial inertia."""
        return [self.plant.AddRigidBody(name, model, inertia) for name in names]


def in_threads(threads: int | None, one: Callable[..., np.ndarray], *columns: Any) -> list[Any]:
    """`one` of each row of `columns`, on as many threads (None: a core each)."""
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        return list(pool.map(lambda row: one(*row), zip(*columns, strict=True)))


class Parity(NamedTuple):
    """The engines of a task against each other: `measured(samples, seed, report) -> results`, and
    those as `lines` for a person.
    """

    measured: Callable[[int, int, Report], Table]
    lines: Callable[[Table], list[str]]


class EngineRun(NamedTuple):
    """outcome `[B, ...]` and code `[B]` of the trials, and seconds: the first call (compiling), and
    a trial of a warm call by the wall clock and by processor time.
    """

    outcome: np.ndarray
    code: np.ndarray
    first: float
    each: float
    cpu_each: float


def engines_and_pairs(
    names: Sequence[str],
    run: Callable[[str], EngineRun],
    row: Callable[[EngineRun], Table],
    pair: Callable[[EngineRun, EngineRun], Table],
    progress: Report,
) -> Table:
    """`{cores, engines, pairs}`: a row for each engine, or why it did not run, and one for each
    pair of those that did.
    """
    runs, engines = {}, []
    for done, name in enumerate(names):
        progress(done, len(names), name)
        try:
            runs[name] = run(name)
        except BadInput as error:
            engines.append({"engine": name, "ran": False, "why": error.coded})
            continue
        engines.append({"engine": name, "ran": True, **row(runs[name])})
    pairs = [{"pair": [a, b], **pair(runs[a], runs[b])} for a, b in itertools.combinations(runs, 2)]
    return {"cores": os.cpu_count(), "engines": engines, "pairs": pairs}


def timed_run(
    simulate: Callable, batch: tuple, outcome: Callable, *, compiles: bool = True, wide: int = 0
) -> EngineRun:
    """The outcomes of a batch, and how long it takes. An engine that compiles nothing is called
    once; `wide` trials are timed instead of the batch where an engine is made for many.
    """
    out, first, cpu = _timed(simulate, batch)
    found = outcome(np.asarray(out.state))
    if not compiles:
        return EngineRun(found, out.code, 0.0, first / len(batch[0]), cpu / len(batch[0]))
    if wide:
        batch = tuple(np.resize(a, (wide, a.shape[1])) for a in batch)
        _timed(simulate, batch)
    _, seconds, cpu = _timed(simulate, batch)
    return EngineRun(found, out.code, first, seconds / len(batch[0]), cpu / len(batch[0]))


def _timed(simulate: Callable, batch: tuple) -> tuple[Any, float, float]:
    begin, cpu = time.perf_counter(), time.process_time()
    out = simulate(*batch)
    np.asarray(out.state)
    return out, time.perf_counter() - begin, time.process_time() - cpu


def speed_row(run: EngineRun, what: str, messages: Mapping[int, str]) -> Table:
    """Speed of one engine in `what` (pushes, trials) a second, and how many of its trials went
    wrong in which way.
    """
    counts = {text: int((run.code == c).sum()) for c, text in messages.items() if c}
    return {
        f"{what}_per_second": 1 / run.each,
        f"{what}_per_cpu_second": 1 / max(run.cpu_each, 1e-9),
        "first_call_s": run.first,
        "went_wrong": {text: count for text, count in counts.items() if count},
    }


def pair_lines(
    found: Table, wide: int, head: str, noun: str, numbers: Callable[[Table], str]
) -> list[str]:
    """The table of pairs of engines, their names `wide`. noun: What went well in neither where
    nothing was compared.
    """
    lines = [f"{'pair':{wide}} {head} {'compared':>9}"]
    for row in found["pairs"]:
        words = f"no {noun} went well in both"
        if row["compared"]:
            words = f"{numbers(row)} {row['compared']:9}"
        lines.append(f"{' - '.join(row['pair']):{wide}} {words}")
    return lines


def engine_lines(found: Table, numbers: Callable[[Table], str]) -> list[str]:
    """A line an engine: its numbers and what went wrong in it, or why it did not run."""
    lines = []
    for row in found["engines"]:
        words = f"did not run: {row.get('why')}"
        if row["ran"]:
            wrong = "".join(f"; {count}: {what}" for what, count in row["went_wrong"].items())
            words = numbers(row) + wrong
        lines.append(f"{row['engine']:18} {words}")
    return lines
