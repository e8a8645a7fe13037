"""`adaptsim new`: a file to start an effect, a mechanism or a task of one's own from."""

from __future__ import annotations

import argparse
import keyword
from pathlib import Path

KINDS = {"effect": ".py", "mechanism": ".xml", "task": ".py"}
NEXT = {
    "effect": "python {file}    its torque; then fill in the physics, and let it compete (docs/howto/extend.md)",
    "mechanism": "adaptsim init LOGS --model {file}",
    "task": "python {file}    trains a small Phase 1 on it",
}
EXAMPLES = """
  adaptsim new effect cable_drag             writes cable_drag.py
  adaptsim new mechanism arm --dir robots    writes robots/arm.xml, an MJCF to fill in
  adaptsim new task puck                     writes puck.py
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", choices=KINDS, metavar="KIND", help="effect, mechanism or task")
    parser.add_argument("name", metavar="NAME", help="in lower case, such as cable_drag")
    parser.add_argument("--dir", type=Path, default=Path("."), metavar="DIR", help="folder of the file (default: here)")


def run(args: argparse.Namespace) -> int:
    """Write one file that runs as it stands; nothing is overwritten."""
    from importlib import resources

    from adaptsim_jax.core.errors import BadInput
    from adaptsim_jax.core.files import output_folder, write_bytes

    if not (args.name.isidentifier() and args.name.islower()) or keyword.iskeyword(args.name):
        raise BadInput(f"'{args.name}' is no name for a file of Python; use letters in lower case, digits and _")
    path = args.dir / f"{args.name}{KINDS[args.kind]}"
    if path.exists():
        raise BadInput(f"{path}: is there already; give another NAME, or --dir")
    start = resources.files("adaptsim_jax.commands") / "starts" / f"{args.kind}{KINDS[args.kind]}.j2"
    text = start.read_text(encoding="utf-8").replace("{{ name }}", args.name).replace("{{ file }}", path.name)
    output_folder(args.dir)
    write_bytes(path, text.encode())
    print(f"written: {path}")
    print(f"next: {NEXT[args.kind].format(file=path)}")
    return 0
