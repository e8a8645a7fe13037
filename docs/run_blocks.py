"""Runs the blocks of a page of `docs/` in order, in an empty folder, and puts what they print into the page.

    python docs/run_blocks.py docs/tutorials/pendulum.md ...

Blocks of `bash` run one after the other in the folder, blocks of `python` share their names. What a block prints stands beneath
it in a block of `text` that follows at once; pictures that the page shows from `figures/` are taken from the folder.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```\n(?:\n```text\n.*?^```\n)?", re.S | re.M)
LEFT_OUT = re.compile(r"^adaptsim: note.*\n", re.M)


def run_page(page: Path, folder: Path) -> str:
    """The page with what its blocks print; their work is left in `folder`. Raises where a block fails."""
    names: dict = {"__name__": "__main__"}

    def ran(match: re.Match) -> str:
        language, code = match.groups()
        printed = bash(code, folder) if language == "bash" else python(code, names, folder)
        printed = LEFT_OUT.sub("", printed.replace(f"{folder}/", "")).strip("\n")
        shown = f"\n```text\n{printed}\n```\n" if printed else ""
        return f"```{language}\n{code}```\n{shown}"

    return BLOCK.sub(ran, page.read_text(encoding="utf-8"))


def bash(code: str, folder: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-ec", code], cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(f"{code}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def python(code: str, names: dict, folder: Path) -> str:
    out = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        exec(compile(code, "page", "exec"), names)
    return out.getvalue()


def main() -> None:
    for page in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as name:
            text = run_page(page, Path(name))
            for figure in re.findall(r"\]\((figures/[\w.-]+)\)", text):
                (page.parent / "figures").mkdir(exist_ok=True)
                shutil.copy(Path(name) / Path(figure).name, page.parent / figure)
        page.write_text(text, encoding="utf-8")
        print(f"ran: {page}")


if __name__ == "__main__":
    main()
