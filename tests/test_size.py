"""Size in syntax nodes, of the whole and of each room: what is added is paid by what goes.

A merge that lowers a count lowers it here, too. Lines cost nothing, dense ones gain nothing.
"""

import ast
import json
from collections import Counter
from pathlib import Path

import adaptsim_jax

PACKAGE = Path(adaptsim_jax.__file__).parent
MOST = json.loads((Path(__file__).parent / "size.json").read_text())
SLACK = 40  # nodes of a room: a mend of a line or two is no growth


def nodes(tree: ast.AST) -> int:
    """Expressions and statements of a file, without docstrings."""
    every = list(ast.walk(tree))
    texts = sum(
        isinstance(n, ast.Expr)
        and isinstance(n.value, ast.Constant)
        and isinstance(n.value.value, str)
        for n in every
    )
    return sum(isinstance(n, (ast.expr, ast.stmt)) for n in every) - 2 * texts


def counted() -> Counter[str]:
    """Syntax nodes by room; files at the top are `top`."""
    out: Counter[str] = Counter()
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE).parts
        room = parts[0] if len(parts) > 1 else "top"
        out[room] += nodes(ast.parse(file.read_text()))
    return out


def test_no_room_grows_unpaid():
    rooms = counted()
    grown = {room: n for room, n in rooms.items() if n > MOST.get(room, 0) + SLACK}
    assert not grown, f"nodes by room beyond tests/size.json: {grown}; let as much go"
    assert rooms.total() <= MOST["whole"] + SLACK
