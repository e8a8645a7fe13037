"""`adaptsim new`: files to start an effect, a mechanism, a task, an environment, an engine or a
baseline from.
"""

from __future__ import annotations

import argparse
import keyword
from importlib.metadata import EntryPoint
from pathlib import Path

from adaptsim_jax.core.config import read

KINDS = read(Path(__file__).parent / "starts" / "kinds.toml")
POINT = """[project.entry-points."adaptsim.{group}"]
"{point}" = "{{name}}:{object}"
"""
PYPROJECT = """[project]
name = "{project}"
version = "0.1"

[tool.setuptools]
py-modules = ["{name}"]   # one word a file beside this one
"""
EXAMPLES = """
  adaptsim new effect cable_drag             writes cable_drag.py, and pyproject.toml where there is none
  adaptsim new mechanism arm --dir robots    writes robots/arm.xml, an MJCF to fill in
  adaptsim new task puck                     writes puck.py
  adaptsim new engine late                   writes late.py, the pendulum in other physics
  adaptsim new environment hopper            writes hopper.toml, hopper.py and hopper.xml: fields, reward, MJCF
  adaptsim new baseline hill_climb           writes hill_climb.py, a row of `adaptsim compare`
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """Write what runs as it stands, and how it is installed; nothing is overwritten."""
    from importlib import resources

    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import output_folder, write_bytes

    if not (args.name.isidentifier() and args.name.islower()) or keyword.iskeyword(args.name):
        raise BadInput(
            f"'{args.name}' is no name for a file of Python; use letters in lower case, digits and "
            "_"
        )
    if args.name in _names(args.kind):
        raise BadInput(
            f"{args.kind} '{args.name}' is there already, and two of one name are refused; give "
            "another NAME"
        )
    kind = KINDS[args.kind]
    paths = [args.dir / f"{args.name}{suffix}" for suffix in kind["files"]]
    for path in paths:
        if path.exists():
            raise BadInput(f"{path}: is there already; give another NAME, or --dir")
    output_folder(args.dir)
    for path in paths:
        start = resources.files("adaptsim_jax.commands") / "starts" / f"{args.kind}{path.suffix}.j2"
        text = (
            start.read_text(encoding="utf-8")
            .replace("{{ name }}", args.name)
            .replace("{{ file }}", path.name)
        )
        write_bytes(path, text.encode())
        print(f"written: {path}")
    if "registry" in kind:
        _make_known(kind, args.name, args.dir)
    print(f"next: {kind['next'].format(file=paths[0], name=args.name)}")
    return 0


def _names(kind: str) -> tuple[str, ...]:
    """What is known of a kind."""
    if home := KINDS[kind].get("registry"):
        found = EntryPoint(kind, f"adaptsim_jax.{home}", "").load()
        return tuple(found() if callable(found) else found.own)
    return ()


def _make_known(kind: dict[str, str], name: str, folder: Path) -> None:
    """A pyproject.toml whose entry points make the object one of ours. The lines for it where there
    is a file already.
    """
    from adaptsim_jax.core.files import write_bytes

    lines = POINT.format(**kind).format(name=name)
    file = folder / "pyproject.toml"
    if file.exists():
        print(f"add to {file}, and '{name}' to its py-modules or packages:\n\n{lines}")
    else:
        text = PYPROJECT.format(
            name=name, project=f"my-{name.replace('_', '-').removeprefix('my-')}"
        )
        write_bytes(file, f"{text}\n{lines}".encode())
        print(f"written: {file}")
    where = kind["where"].format(name=name)
    print(f"once installed (pip install -e {folder}) it is known to {where}")
