"""SPEC.toml read and checked; every fault is named with its line."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.adaptation.phase1_config import check
from adaptsim_jax.adaptation.sweep_spec import MOST, Draws, Lines, Member, Range, Sweep, SweepSpec
from adaptsim_jax.adaptation.training import (
    TrainConfig,
    default_config,
    preset,
    presets_of,
    table_of,
    with_defaults,
)
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import MAX_SEED, BadInput, brief, check_counts
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.registry import TASKS, make_task


def read_sweep(path: str | Path) -> Sweep:
    """The sweep in the TOML file `path`. Before anything is run BadInput names the line of an
    unknown key, with the nearest known one. It also names that of a value of the wrong type or
    outside of its bounds, and of values that do not fit each other.
    """
    table = configs.read(path, "no such file; name the SPEC.toml of a sweep")
    lines = Lines(str(path), Path(path).read_bytes().decode("utf-8-sig"))
    env = _environment(table, lines, Path(path).parent)
    spec = _spec(table if env is None else table | {"task": "environment"}, lines, str(path))
    base = _base(spec, lines, Path(path).parent, env or {})
    axes = _axes(spec, lines)
    for key, value, line in _every(axes):
        with lines.blamed(line):
            _check_key(spec.task, configs.to_table(base), key, value, lines.where(line))
    return _members(spec, base, axes, lines)


def _environment(table: Table, lines: Lines, folder: Path) -> Table | None:
    """The env.toml that the spec names as its task, read; None where it names a task."""
    named = table.get("task")
    if not (isinstance(named, str) and named.endswith(".toml")):
        return None
    from adaptsim_jax.environments.setting import read_env

    with lines.blamed("task"):
        return read_env(folder / named)


def _spec(table: Table, lines: Lines, path: str) -> SweepSpec:
    known = list(SweepSpec.__dataclass_fields__)
    for name in table:
        with lines.blamed(name):
            if name not in known:
                raise BadInput(f"unknown key '{name}'; {configs.suggest(name, known)}")
            given = {name: table[name]} | ({} if name == "task" else {"task": "pendulum"})
            configs.from_table(SweepSpec, given, lines.where(name))
    spec = configs.from_table(SweepSpec, table, path)
    with lines.blamed("task"):
        configs.pick("task", spec.task, TASKS)
    for name in ("starts", "iterations"):
        check_counts(spec, (name,), f"{lines.where(name)}: ")
    if spec.random.count < 0 or (spec.random.count == 0) != (not spec.random.values):
        raise BadInput(
            f"{lines.where('random')}: random needs count, at least 1, and [random.values] with a "
            "range for each key"
        )
    return spec


def seeds_of(spec: SweepSpec, lines: Lines | None = None) -> list[int]:
    """Which seeds each combination is run with."""
    seeds = list(range(spec.seeds) if isinstance(spec.seeds, int) else spec.seeds)
    where = lines.where("seeds") if lines else "seeds"
    if not seeds or len(set(seeds)) < len(seeds) or not all(0 <= s <= MAX_SEED for s in seeds):
        raise BadInput(
            f"{where}: seeds = {brief(spec.seeds)}: give a number of at least 1, or a list of "
            "different seeds"
        )
    return seeds


def _base(spec: SweepSpec, lines: Lines, folder: Path, env: Table) -> TrainConfig:
    """The configuration that members start from. env: The table of an env.toml, empty for other
    tasks.
    """
    if spec.preset and spec.config:
        raise BadInput(f"{lines.where('config')}: preset and config are both given; leave one out")
    base = default_config(spec.task)
    if env:
        base = configs.from_table(TrainConfig, with_defaults(spec.task, env), "env.toml")
    if spec.preset:
        with lines.blamed("preset"):
            base = preset(configs.pick("preset", spec.preset, presets_of(spec.task)))
    if spec.config:
        with lines.blamed("config"):
            table = table_of(folder / spec.config, spec.task, spec.config)
            base = configs.from_table(TrainConfig, with_defaults(spec.task, table), spec.config)
    for key, value in leaves(spec.set, configs.to_table(base)).items():
        with lines.blamed(f"set.{key}"):
            _check_key(spec.task, configs.to_table(base), key, value, lines.where(f"set.{key}"))
    return with_values(base, leaves(spec.set, configs.to_table(base)))


def leaves(table: Table, base: Table) -> Table:
    """Values by dotted key, whether they were written as `"hyper.delta" = 1`, `hyper.delta = 1` or
    in a nested table. Never taken apart further than the configuration `base` is nested.
    """
    flat = {}
    for name, value in table.items():
        inner = _at(base, name)
        if isinstance(value, dict) and (isinstance(inner, dict) or inner is None):
            flat |= {f"{name}.{key}": item for key, item in leaves(value, inner or {}).items()}
        else:
            flat[name] = value
    return flat


def _at(table: Any, key: str) -> Any:
    for part in key.split("."):
        table = table.get(part) if isinstance(table, dict) else None
    return table


def with_values(base: TrainConfig, values: Table, where: str = "values") -> TrainConfig:
    """`base` with values by dotted key."""
    table = configs.to_table(base)
    for key, value in values.items():
        table = configs.over(table, _nested(key, value))
    return configs.from_table(TrainConfig, table, where)


def _nested(key: str, value: Any) -> Table:
    for part in reversed(key.split(".")):
        value = {part: value}
    return value


def _check_key(task: str, base: Table, key: str, value: Any, where: str) -> None:
    """BadInput, from `where`, if the configuration has no such key, or no such value there."""
    if key == "seed" or key.startswith("seed."):
        raise BadInput(
            "key 'seed' is not swept; write seeds = 16 or seeds = [3, 5] at the top of the file"
        )
    head, _, option = key.partition(".")
    table = configs.over(base, _nested(key, value))
    made = configs.from_table(TrainConfig, table, where)
    if head == "task" and option and "model" not in made.task:
        kind = TASKS[task].config
        default = configs.to_table(kind())
        configs.from_table(kind, configs.over(default, made.task), where, "task.")
    elif head == "task" and not option:
        raise BadInput("key 'task' is a table; name an option in it, such as task.trials")


# ---------------------------------------------------------------- members

Axis = list[Table]
"""Alternatives: each a set of values by dotted key, with `lines`' names of them under `""`."""


def _axes(spec: SweepSpec, lines: Lines) -> list[Axis]:
    grid = [_grid_axis(key, values, lines) for key, values in configs.flatten(spec.grid).items()]
    alternatives = [_random_axis(spec.random, lines)] if spec.random.count else []
    if spec.list:
        alternatives.append([_list_entry(entry, i, lines) for i, entry in enumerate(spec.list)])
    axes = [*grid, *alternatives]
    keys = [key for axis in axes for key in axis[0] if key]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInput(
                f"{lines.where(f'grid.{key}')}: key '{key}' is swept twice; leave it in one place"
            )
    return axes


def _grid_axis(key: str, values: Any, lines: Lines) -> Axis:
    if not isinstance(values, list) or not values:
        raise BadInput(
            f"{lines.where(f'grid.{key}')}: key '{key}' is {brief(values)}; a list of values is "
            "wanted"
        )
    return [{key: value, "": {key: f"grid.{key}"}} for value in values]


def _list_entry(entry: Any, i: int, lines: Lines) -> Table:
    if not isinstance(entry, dict) or not entry:
        raise BadInput(
            f"{lines.where(f'list.{i}')}: entry {i} of list is {brief(entry)}; write [[list]] and "
            "keys below it"
        )
    flat = configs.flatten(entry)
    return flat | {"": {key: f"list.{i}.{key}" for key in flat}}


def _ranges(table: Table, prefix: str = "") -> dict[str, Table]:
    """Range tables by dotted key."""
    flat = {}
    for name, value in table.items():
        nested = (
            isinstance(value, dict) and value and all(isinstance(v, dict) for v in value.values())
        )
        flat |= _ranges(value, f"{prefix}{name}.") if nested else {f"{prefix}{name}": value}
    return flat


def _random_axis(draws: Draws, lines: Lines) -> Axis:
    rng, columns = np.random.default_rng(draws.seed), {}
    for key, given in _ranges(draws.values).items():
        line = f"random.values.{key}"
        with lines.blamed(line):
            if not isinstance(given, dict):
                raise BadInput(
                    f"key '{key}' is {brief(given)}; write {{low = 0.1, high = 1.0}} or {{choice = "
                    f"[1, 2]}}"
                )
            columns[key] = _drawn(
                rng, configs.from_table(Range, given, lines.where(line)), key, draws.count
            )
    names = {key: f"random.values.{key}" for key in columns}
    return [
        {key: column[i] for key, column in columns.items()} | {"": names}
        for i in range(draws.count)
    ]


def _drawn(rng: np.random.Generator, range_: Range, key: str, count: int) -> list[Any]:
    if range_.choice:
        return [range_.choice[i] for i in rng.integers(len(range_.choice), size=count)]
    low, high = range_.low, range_.high
    if low is None or high is None or not low < high:
        raise BadInput(
            f"key '{key}': low = {low}, high = {high}; give low below high, or choice = [...]"
        )
    if range_.integer:
        return [int(v) for v in rng.integers(int(low), int(high) + 1, size=count)]
    if range_.scale == "log":
        if low <= 0:
            raise BadInput(f"key '{key}': low = {low} on a logarithmic scale; give a positive one")
        return [float(v) for v in np.exp(rng.uniform(np.log(low), np.log(high), count))]
    return [float(v) for v in rng.uniform(low, high, count)]


def _every(axes: list[Axis]):
    """(key, value, its name in the file) of all alternatives."""
    for axis in axes:
        for entry in axis:
            for key, value in entry.items():
                if key:
                    yield key, value, entry[""][key]


def _members(spec: SweepSpec, base: TrainConfig, axes: list[Axis], lines: Lines) -> Sweep:
    seeds = seeds_of(spec, lines)
    count = int(np.prod([len(axis) for axis in axes], dtype=np.float64)) * len(seeds)
    if count > MOST:
        raise BadInput(
            f"{lines.path}: {count} members; {MOST} at most, so shorten a list of [grid]"
        )
    members, tasks = [], {}
    for combination in itertools.product(*axes):
        values = {key: value for entry in combination for key, value in entry.items() if key}
        names = {key: name for entry in combination for key, name in entry[""].items()}
        config = with_values(base, values, str(lines.path))
        _check_whole(spec, config, names, lines, tasks)
        members += [
            Member(len(members) + i, values, replace(config, seed=s)) for i, s in enumerate(seeds)
        ]
    swept = dict.fromkeys(key for axis in axes for entry in axis for key in entry if key)
    return Sweep(spec, tuple(members), tuple(swept))


def _check_whole(
    spec: SweepSpec,
    config: TrainConfig,
    names: dict[str, str],
    lines: Lines,
    tasks: dict[str, Task],
):
    """BadInput where the values of one member do not fit each other; tasks that are made are kept
    in `tasks`, by their options.
    """
    try:
        digest = configs.digest(config.task)
        if digest not in tasks:
            tasks[digest] = make_task(spec.task, config.task, "task")
            for name in spec.targets:
                if name not in tasks[digest].settings:
                    known = configs.suggest(name, tasks[digest].settings)
                    raise BadInput(f"{lines.where('targets')}: unknown target '{name}'; {known}")
        check(config.phase1, tasks[digest])
    except BadInput as error:
        text = str(error)
        if text.startswith(lines.path):
            raise
        # the message names what it is about; the key whose last part it holds is to blame, else all
        # that is swept
        named = {**{key: f"set.{key}" for key in configs.flatten(spec.set)}, **names}
        key = max((k for k in named if k.rpartition(".")[2] in text), key=len, default=None)
        line = named[key] if key else next(iter(names.values()), "set")
        raise BadInput(f"{lines.where(line)}: {text}") from None
