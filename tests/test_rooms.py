"""The rooms of the package (docs/architecture.md): each imports only from those above it, so that
none knows what it is used for.

The same holds within a room: its files and sub-rooms stand in an order of their own.
"""

import ast
from pathlib import Path

import pytest

import adaptsim_jax

PACKAGE = Path(adaptsim_jax.__file__).parent
ROOMS = (
    "core",
    "space",
    "control",
    "effects",
    "mechanisms",
    "mend",
    "logs",
    "diagnosis",
    "simulators",
    "attribution",
    "learners",
    "report",
    "tasks",
    "environments",
    "adaptation",
    "baselines",
    "commands",
    "cli",
    "__main__",
)
WITHIN = {
    "core": (
        "lazy",
        "errors",
        "files",
        "progress",
        "config",
        "registry",
        "constants",
        "trig",
        "parallel",
        "process",
        "traced",
        "tree_store",
        "store",
    ),
    "effects": (
        "base",
        "registry",
        "joints",
    ),
    "mechanisms": (
        "lanes",
        "model_numbers",
        "quaternions",
        "tree",
        "kinematics",
        "dynamics",
        "equations",
        "inertia_frames",
        "urdf",
        "switches",
        "spec",
        "roles",
        "transmission",
        "mjcf",
        "allowed",
        "double_pendulum",
    ),
    "logs": (
        "criteria",
        "columns",
        "words",
        "senders",
        "log_units",
        "csv_rows",
        "beside",
        "declared",
        "headings",
        "log_meta",
        "log",
        "table_checks",
        "noise",
        "stretch_rows",
        "quality",
        "clock",
        "table_clocks",
        "archive",
        "table",
        "tables",
        "pool",
        "counters",
        "repeats",
        "command_files",
        "bag",
        "messages",
        "angles",
        "trajectories",
        "readers",
        "lerobot",
        "joint_columns",
        "speeds",
        "scales",
        "unit_guess",
        "guess",
        "ros",
        "inputs",
        "assemble",
        "read",
        "pendulum",
        "begin",
    ),
    "diagnosis": (
        "run",
        "criteria",
        "schema",
        "recommended",
        "testing",
        "steps",
        "straight",
        "rules",
        "finding",
        "numbers",
        "folds",
        "problem",
        "fit",
        "models",
        "objective",
        "search",
        "trials",
        "simulator",
        "starts",
        "report",
        "experiment",
        "rows",
        "written",
        "simulated",
    ),
    "environments": (
        "fields",
        "laws",
        "simulated",
        "own",
        "peers",
        "found_laws",
        "mended",
        "episodes",
        "trainer",
        "course",
        "targets",
        "diagnosed",
        "setting",
        "policies",
        "task",
        "kind",
    ),
    "tasks": (
        "base",
        "camera_record",
        "camera_effects",
        "trial_record",
        "trial_diagnosis",
        "one_shot",
        "one_action",
        "robot_trials",
        "engine",
        "pendulum",
        "pushing",
        "scooping",
        "toss",
        "registry",
    ),
}
FILES = sorted(f for f in PACKAGE.rglob("*.py") if f != PACKAGE / "__init__.py")


def place(path: Path) -> tuple[str, ...]:
    """Folders and stem of a file; of a package's own `__init__`, the folders."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


MODULES = {place(f) for f in FILES}


def imported(path: Path) -> set[tuple[str, ...]]:
    """Modules of this package that a file imports, inside functions too; not what only a type
    checker reads.
    """
    tree = ast.parse(path.read_text())
    checked = {
        id(n)
        for i in ast.walk(tree)
        if isinstance(i, ast.If) and "TYPE_CHECKING" in ast.dump(i.test)
        for n in ast.walk(i)
    }
    found = set()
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom) and not node.level and id(node) not in checked:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import) and id(node) not in checked:
            names = [alias.name for alias in node.names]
        for parts in (tuple(n.split(".")[1:]) for n in names if n.split(".")[0] == "adaptsim_jax"):
            found |= {parts} if parts in MODULES else {parts[:-1]}
    return found - {()}


IMPORTS = {place(f): imported(f) for f in FILES}


def test_every_room_has_its_place():
    assert {p[0] for p in MODULES} == set(ROOMS)
    for room, order in WITHIN.items():
        assert {p[1] for p in MODULES if p[0] == room and len(p) > 1} == set(order)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_from_those_above_it(room):
    above = set(ROOMS[: ROOMS.index(room) + 1])
    assert not {
        (p, other) for p in MODULES if p[0] == room for other in IMPORTS[p] if other[0] not in above
    }


@pytest.mark.parametrize("room", WITHIN)
def test_a_part_of_a_room_imports_only_from_those_above_it(room):
    order = WITHIN[room]
    inside = [p for p in MODULES if p[0] == room and len(p) > 1]
    assert not {
        (p, other)
        for p in inside
        for other in IMPORTS[p]
        if other[0] == room and (len(other) < 2 or order.index(other[1]) > order.index(p[1]))
    }


def test_no_file_imports_itself_in_a_circle():
    done, path = set(), []

    def visit(module):
        assert module not in path, " -> ".join(".".join(m) for m in [*path, module])
        if module not in done:
            path.append(module)
            for other in sorted(IMPORTS[module]):
                visit(other)
            path.pop()
            done.add(module)

    for module in sorted(MODULES):
        visit(module)
