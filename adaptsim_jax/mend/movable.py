"""A model file with the files that it reads beside it, so that it compiles wherever it lies."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mend.mjcf import commented

ASSETS = "assets"


def movable(path: str | Path) -> dict[str, str | bytes]:
    """`{name: content}` of the MJCF at `path` and of `assets/` beside it. BadInput names a file
    that is not there.
    """
    path = Path(path)
    spec = mujoco.MjSpec.from_file(str(path))
    out: dict[str, str | bytes] = {}
    meshes, textures = (path.parent / z for z in (spec.meshdir, spec.texturedir))
    _take(spec.meshes, meshes, out)
    _take(spec.hfields, meshes, out)
    _take(spec.skins, meshes, out)
    _take(spec.textures, textures, out)
    if out:
        spec.meshdir = spec.texturedir = ASSETS
    spec.modelfiledir = ""
    return {path.name: commented(spec.to_xml(), _comments(path)), **out}


def _take(elements: Iterable[Any], folder: Path, out: dict[str, str | bytes]) -> None:
    for element in elements:
        if not element.file:
            continue
        file = folder / element.file
        if not file.is_file():
            raise BadInput(f"{file}: no such file, which the model reads; put it back there")
        name, content = file.name, file.read_bytes()
        if out.get(f"{ASSETS}/{name}", content) != content:  # another file of that name
            name = f"{len(out)}_{name}"
        out[f"{ASSETS}/{name}"] = content
        element.file = name


def _comments(path: Path) -> list[str]:
    """Lines above a model that `mend.mjcf` wrote there."""
    lines = path.read_text(encoding="utf-8").splitlines()
    marks = [line for line in lines if line.startswith("<!-- ")]
    return [line.removeprefix("<!-- ").removesuffix(" -->") for line in marks]
