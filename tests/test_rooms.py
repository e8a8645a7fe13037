"""The rooms of the package (docs/architecture.md): each imports only from those above it, so that none knows what it is used for."""

import ast
from pathlib import Path

import pytest

import adaptsim_jax

PACKAGE = Path(adaptsim_jax.__file__).parent
ROOMS = (
    "errors", "given", "files", "progress", "config", "compile_cache", "compile_flags", "memory", "kept_programs", "space",
    "control", "models", "mechanisms", "attribution", "learners", "tasks", "tree_store", "store", "adapt", "baselines", "closeloop",
    "sysid", "report", "doctor", "demo", "commands", "cli", "__main__",
)  # fmt: skip
PAGE = ("closeloop/diagnose.py", "report")  # `diagnose(out=...)` writes its page, when all is computed


def room(path: Path) -> str:
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def imported(tree: ast.AST) -> set[str]:
    """Rooms that a module imports from, inside functions too; not what only a type checker reads."""
    checked = {
        id(n)
        for i in ast.walk(tree)
        if isinstance(i, ast.If) and "TYPE_CHECKING" in ast.dump(i.test)
        for n in ast.walk(i)
    }
    found = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.ImportFrom)
            and (node.module or "").split(".")[0] == "adaptsim_jax"
            and id(node) not in checked
        ):
            inside = node.module.split(".")[1:]
            found |= {inside[0]} if inside else {alias.name for alias in node.names}
    return found - {"__version__"}


def test_every_room_has_its_place():
    there = {room(f) for f in PACKAGE.rglob("*.py")} - {"__init__"}
    assert there == set(ROOMS)


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_imports_only_from_those_above_it(name):
    above = set(ROOMS[: ROOMS.index(name) + 1])
    files = [f for f in PACKAGE.rglob("*.py") if room(f) == name]
    wrong = {
        (str(f.relative_to(PACKAGE)), other) for f in files for other in imported(ast.parse(f.read_text())) - above
    } - {PAGE}
    assert not wrong
