"""Codes of bad input. `python docs/codes.py` renews `adaptsim_jax/core/codes.toml` where messages
or functions changed; `page` is `reference/errors.md` of the site.

A code stays with its message while the function or the words stay. No code is given twice.
"""

from __future__ import annotations

import ast
import json
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "adaptsim_jax"
FILE = PACKAGE / "core" / "codes.toml"
ERRORS = {"BadInput", "Torn"}
SHOWN = {"str", "repr", "brief", "one_line", "join", "sorted", "list", "tuple", "map"}
GONE = "gone"
LENGTH = 48  # of the words that tell a message from the others of its function
ROOMS = {
    "cli": ("CLI", "Command line"),
    "commands": ("CLI", "Command line"),
    "core": ("CORE", "Files, keys, runs and checkpoints"),
    "space": ("SPACE", "Parameters"),
    "logs": ("LOG", "Logs and meta.toml"),
    "mechanisms": ("MODEL", "Model files"),
    "simulators": ("SIM", "Simulators"),
    "effects": ("EFFECT", "Effects"),
    "attribution": ("FIT", "Diagnosis of a mechanism"),
    "diagnosis": ("DIAG", "Diagnosis, any"),
    "mend": ("MEND", "What a diagnosis writes, and export"),
    "tasks": ("TASK", "Pendulum, pushes, scoops, tosses"),
    "environments": ("ENV", "Environments"),
    "learners": ("LEARN", "Learners"),
    "adaptation": ("ADAPT", "Training, adaptation, sweeps"),
    "baselines": ("BASE", "Comparisons"),
    "control": ("CTRL", "Controllers"),
    "report": ("REPORT", "Pages and pictures"),
}
HEAD = f"""# Codes of bad input: by the function that makes a message, each with words that no other
# message of that function has. `python docs/codes.py` writes it. A code keeps its meaning; those
# under [{GONE}] are not given again.
"""

Table = dict[str, dict[str, str]]


@dataclass(frozen=True)
class Site:
    """A message of bad input that a function makes.

    Args: place: `module:function`, as `BadInput.place`. parts: Its constant parts. shown: The
        whole, with names of values in braces.
    """

    place: str
    parts: tuple[str, ...]
    shown: str

    @property
    def text(self) -> str:
        """The message where every value is empty, as far as words are searched in it."""
        return "\0".join(self.parts)

    @property
    def room(self) -> tuple[str, str]:
        """Its prefix and title."""
        return ROOMS[self.place.partition(":")[0].split(".")[1]]


def sites() -> list[Site]:
    """Every message of bad input of the package, once a function, by file and line."""
    found: list[Site] = []
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        found += _sites(ast.parse(path.read_text(encoding="utf-8")), module, "")
    order = list(ROOMS)
    found.sort(key=lambda site: order.index(site.place.partition(":")[0].split(".")[1]))
    return list({(site.place, site.parts): site for site in found}.values())


def _sites(node: ast.AST, module: str, function: str) -> Iterator[Site]:
    for child in ast.iter_child_nodes(node):
        inner = function
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            between = ".<locals>." if isinstance(node, ast.FunctionDef) else "."
            inner = f"{function}{between}{child.name}".removeprefix(".")
        if isinstance(child, ast.Call) and getattr(child.func, "id", "") in ERRORS:
            parts = list(_parts(child.args[0]))
            constant = tuple(text for text, is_constant in parts if is_constant)
            yield Site(f"{module}:{function}", constant, "".join(text for text, _ in parts))
        yield from _sites(child, module, inner)


def _parts(node: ast.expr) -> Iterator[tuple[str, bool]]:
    """Parts of a message, each with whether it is constant."""
    if isinstance(node, ast.Constant):
        yield str(node.value), True
    elif isinstance(node, ast.JoinedStr):
        for value in node.values:
            yield from _parts(value)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        yield from _parts(node.left)
        yield from _parts(node.right)
    else:
        yield f"{{{_name(node).strip('_').lower()}}}", False


def _name(node: ast.expr) -> str:
    """The name of a value, of the function that makes it, or of what that function shows."""
    if isinstance(node, ast.FormattedValue | ast.Subscript):
        return _name(node.value)
    if isinstance(node, ast.Call):
        name = _name(node.func)
        return _name(node.args[0]) if name in SHOWN and node.args else name
    return getattr(node, "attr", getattr(node, "id", "..."))


def words_of(site: Site, others: list[Site]) -> str:
    """The longest words of a message that no other of its function has; where it has none of its
    own, its longest.
    """
    cut = [part[:LENGTH].rpartition(" ")[0] if part[LENGTH:] else part for part in site.parts]
    ranked = sorted((part for part in cut if part.strip(" :;,.'")), key=len, reverse=True)
    own = [part for part in ranked if not any(part in other.text for other in others)]
    return next(iter(own + ranked), "")


def codes_of(every: list[Site], before: Table) -> dict[Site, str]:
    """The code of each message: that of `before` by function and words, by words alone, or by
    function alone where one message of it is new and one code of it is open; else the next number.
    """
    rows = [(c, p, w) for p, codes in before.items() if p != GONE for c, w in codes.items()]
    codes: dict[Site, str] = {}

    def suits(site: Site, place: str, words: str, step: int) -> bool:
        if step == 0:
            return site.place == place and words == words_now[site]
        if step == 1:
            return site.place == place and bool(words) and words in site.text
        if step == 2:
            return len(words) > LENGTH // 4 and words in site.text
        return site.place == place

    words_now = {s: words_of(s, _others(s, every)) for s in every}
    for step in range(4):
        for site in (s for s in every if s not in codes):
            alike = [row for row in rows if suits(site, *row[1:], step)]
            if len(alike) == 1:
                codes[site] = alike[0][0]
                rows.remove(alike[0])
    last = Counter()
    for code in (c for table in before.values() for c in table):
        _, prefix, number = code.split("-")
        last[prefix] = max(last[prefix], int(number))
    for site in (s for s in every if s not in codes):
        last[site.room[0]] += 1
        codes[site] = f"E-{site.room[0]}-{last[site.room[0]]:03}"
    return codes


def _others(site: Site, every: list[Site]) -> list[Site]:
    return [other for other in every if other.place == site.place and other != site]


def renewed(every: list[Site], before: Table) -> str:
    """The text of `codes.toml`. Of a function, messages without words of their own stand last."""
    codes = codes_of(every, before)
    lines = [HEAD]
    for place in sorted({site.place for site in every}):
        here = [site for site in every if site.place == place]
        words = {site: words_of(site, _others(site, here)) for site in here}
        unsure = {s: sum(words[s] in other.text for other in here) for s in here}
        here.sort(key=lambda s: (not words[s], unsure[s], codes[s]))
        lines.append(f"[{json.dumps(place)}]")
        lines += [f"{codes[s]} = {json.dumps(words[s], ensure_ascii=False)}" for s in here]
    ever = {code for table in before.values() for code in table}
    lines += [f"\n[{GONE}]", *(f'{code} = ""' for code in sorted(ever - set(codes.values())))]
    return "\n".join(lines) + "\n"


def stored() -> Table:
    """What `codes.toml` holds."""
    return tomllib.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


def page() -> str:
    """Every code with its message, by subject."""
    codes = codes_of(sites(), stored())
    parts = [
        "# Errors and their codes\n\nMade from the code. Input that cannot be used ends a command "
        "with exit code 2 and one line: what, why, the mend, and a code in brackets. Look the code "
        "up here, or search for it. A code keeps its meaning in later versions; words may change. "
        "In Python it is `BadInput.code`. Braces stand for values. A message that repeats another "
        "has that one's code."
    ]
    for title in dict.fromkeys(title for _, title in ROOMS.values()):
        here = sorted((code, site) for site, code in codes.items() if site.room[1] == title)
        if here:
            rows = "\n".join(f"| `{code}` | {_cell(site.shown)} |" for code, site in here)
            parts.append(f"## {title}\n\n| code | message |\n| --- | --- |\n{rows}")
    return "\n\n".join(parts) + "\n"


def _cell(text: str) -> str:
    for mark in "\\|*_<`[]":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())


if __name__ == "__main__":
    FILE.write_text(renewed(sites(), stored()), encoding="utf-8")
