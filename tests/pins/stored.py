"""What is stored beside the tests, and how it is compared and renewed.

`ADAPTSIM_PINS=renew python -m pytest tests/pins` writes all of `stored/*.json` anew; review its
difference: a change of structure leaves none.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent / "stored"
ROUNDING = 1e-6  # of a number, or of the largest of its row
NOTHING = 1e-12  # less apart is rounding of sums: a gain of -7e-13 is none


def mark(z: Any) -> list[float]:
    """An array in four numbers: how large it is, its size, and what two waves along it pick out."""
    flat = np.nan_to_num(np.asarray(z, float)).ravel()
    at = np.arange(flat.size)
    size = float(np.sqrt(np.mean(np.square(flat)))) if flat.size else 0.0
    waves = [float(np.mean(flat * np.cos(w * at + 0.3))) if flat.size else 0.0 for w in (0.7, 1.9)]
    return [float(flat.size), size, *waves]


def plain(z: Any) -> Any:
    """As JSON has it, with numbers of twelve digits."""
    if isinstance(z, dict):
        return {str(k): plain(v) for k, v in z.items()}
    if isinstance(z, (list, tuple)):
        return [plain(v) for v in z]
    if isinstance(z, (bool, str)) or z is None:
        return z
    if isinstance(z, (int, np.integer)):
        return int(z)
    return float(f"{float(z):.12g}") if np.isfinite(z) else str(float(z))


def check(name: str, value: Any, rounding: float = ROUNDING) -> None:
    """Compare with what is stored under a name, or store it."""
    path, now = FOLDER / f"{name}.json", plain(value)
    if os.environ.get("ADAPTSIM_PINS") == "renew":
        path.write_text(json.dumps(now, indent=1) + "\n")
        return
    lines = list(differences(json.loads(path.read_text()), now, rounding))
    assert not lines, "\n".join(lines[:20])


def differences(old: Any, new: Any, rounding: float, at: str = ""):
    """Lines that say where two things differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        if list(old) != list(new):
            yield f"{at}: keys {_both(list(old), list(new))}"
        for key in old:
            if key in new:
                yield from differences(old[key], new[key], rounding, f"{at}/{key}")
    elif isinstance(old, list) and isinstance(new, list):
        yield from _of_rows(old, new, rounding, at)
    elif _is_number(old) and _is_number(new):
        if abs(old - new) > max(rounding * max(abs(old), abs(new)), NOTHING):
            yield f"{at}: {old} was stored, {new} now"
    elif old != new:
        yield f"{at}: {old!r} was stored, {new!r} now"


def _of_rows(old: list, new: list, rounding: float, at: str):
    if len(old) != len(new):
        yield f"{at}: {_both(old, new)}"
    elif old and all(map(_is_number, old)) and all(map(_is_number, new)):
        size = max(map(abs, [*old, *new]))
        if max(abs(a - b) for a, b in zip(old, new, strict=True)) > rounding * size:
            yield f"{at}: {old} were stored, {new} now"
    else:
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, rounding, f"{at}/{k}")


def _is_number(z: Any) -> bool:
    return isinstance(z, (int, float)) and not isinstance(z, bool)


def _both(old: list, new: list) -> str:
    gone = [z for z in old if z not in new]
    more = [z for z in new if z not in old]
    return f"{len(old)} stored, {len(new)} now; gone {gone[:5]}, new {more[:5]}"
