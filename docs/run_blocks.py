"""Runs the blocks of a tutorial in order, in an empty folder, and keeps what they print and draw:
`make tutorials`.

    python docs/run_blocks.py                                   all of docs/tutorials
    python docs/run_blocks.py docs/tutorials/pendulum.md ...

Blocks of `bash` run one after the other in the folder, blocks of `python` share their names. What
block k of `page.md` prints is kept in `outputs/page/k.txt` beside the page, where `docs/hooks.py`
finds it for the site; pictures that the page shows from `outputs/page/` are taken from the folder:
`robot-pushes.png` is `robot/pushes.png` there.
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

TUTORIALS = Path(__file__).parent / "tutorials"
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```\n", re.S | re.M)
FIGURE = re.compile(r"\]\(outputs/([\w-]+/[\w.-]+\.png)\)")
LEFT_OUT = re.compile(r"^adaptsim: note.*\n", re.M)
COLOURS = 128  # of a picture that is kept: a quarter of its size, and no difference to the eye


def outputs_of(page: Path) -> Path:
    return page.parent / "outputs" / page.stem


def run_page(page: Path, folder: Path) -> list[str]:
    """What each block prints; their work is left in `folder`. Raises where a block fails."""
    names: dict = {"__name__": "__main__"}
    printed = []
    for language, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        text = bash(code, folder) if language == "bash" else python(code, names, folder)
        lines = LEFT_OUT.sub("", text.replace(f"{folder}/", "")).strip("\n").split("\n")
        printed.append("\n".join(line.rstrip() for line in lines))
    return printed


def bash(code: str, folder: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-ec", code],
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"{code}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def python(code: str, names: dict, folder: Path) -> str:
    out = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        exec(compile(code, "page", "exec"), names)
    return out.getvalue()


def figures_of(page: Path, folder: Path) -> dict[str, Path]:
    """Pictures that the page shows, by their place under `outputs/`. Raises where the folder has
    none of that name.
    """
    made = {"-".join(path.relative_to(folder).parts): path for path in folder.rglob("*.png")}
    shown = FIGURE.findall(page.read_text(encoding="utf-8"))
    if missing := [place for place in shown if Path(place).name not in made]:
        raise RuntimeError(
            f"{page}: no block made {missing[0]}; there are {', '.join(sorted(made))}"
        )
    return {place: made[Path(place).name] for place in shown}


def keep(page: Path, folder: Path, printed: list[str]) -> None:
    """Write all that a run gave; what an earlier one left there goes."""
    from PIL import Image

    out = outputs_of(page)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    for k, text in enumerate(printed, 1):
        if text:
            (out / f"{k}.txt").write_text(text + "\n", encoding="utf-8")
    for place, made in figures_of(page, folder).items():
        with Image.open(made) as picture:
            flat = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            flat.save(out.parent / place, optimize=True)


def main() -> None:
    os.environ.setdefault("MPLBACKEND", "agg")
    for page in map(Path, sys.argv[1:] or sorted(TUTORIALS.glob("*.md"))):
        with tempfile.TemporaryDirectory() as name:
            keep(page, Path(name), run_page(page, Path(name)))
        print(f"ran: {page}")


if __name__ == "__main__":
    main()
