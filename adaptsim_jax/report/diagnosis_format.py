"""Numbers as a person reads them: three significant digits, a prefix that fits, intervals in one
unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

DASH = "\u2013"
MINUS = "\u2212"
_SUPERSCRIPT = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
_PREFIXED = ("rad", "N", "s", "m", "V", "A", "W", "J")
"""First symbols that take a milli or a micro in front. kg does not: g and mg would hide the base
unit.
"""


def unit_name(unit: str | None) -> str:
    """A unit as it is set: `Nm`, `N*m`, `N m` -> `N·m`; `kg m^2` -> `kg·m²`; dimensionless ->
    empty.
    """
    text = (unit or "").strip()
    if text.lower() in ("", "1", "-", "none", "dimensionless"):
        return ""
    text = text.replace("Nm", "N m").replace("**", "^").replace("*", " ").replace("·", " ")
    text = text.replace("^2", "²").replace("^3", "³").replace("^-1", "⁻¹")
    return "·".join(text.split()).replace("·/·", "/").replace("/·", "/").replace("·/", "/")


def scaled(unit: str | None, size: float | None) -> tuple[float, str]:
    """`(factor, name)` so that `factor * value` in `name` reads well for values of about `size`."""
    name = unit_name(unit)
    head = name.replace("/", "·").split("·")[
        0
    ]  # m² and the like stay as they are: a milli would be squared
    if head not in _PREFIXED or not size or not math.isfinite(size) or abs(size) >= 0.1:
        return 1.0, name
    if abs(size) >= 1e-4:
        return (1e3, "m" + name)
    return (1e6, "µ" + name)


def number(value: float | None, digits: int = 3) -> str:
    """`value` with `digits` significant digits; a dash for none; powers of ten beyond 1e-3 ..
    1e5.
    """
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -3 <= exponent < 5:
        return (
            f"{fixed(value / 10.0**exponent, digits - 1)}×10{str(exponent).translate(_SUPERSCRIPT)}"
        )
    return fixed(value, max(0, digits - 1 - exponent))


def fixed(value: float, decimals: int) -> str:
    """`value` with so many decimals, a true minus sign, and no minus before a zero."""
    text = f"{value:.{max(0, decimals)}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def quantity(
    value: float | None, unit: str | None = "", digits: int = 3, like: float | None = None
) -> str:
    """`12.3 mrad`; the prefix is chosen for the size `like`, so that neighbours share it."""
    factor, name = scaled(unit, value if like is None else like)
    text = number(None if value is None else factor * value, digits)
    if text == DASH or not name:
        return text
    return f"{text} {name}"


def between(
    value: float | None,
    low: float | None,
    high: float | None,
    unit: str | None = "",
    like: float | None = None,
) -> str:
    """`31.2 [28.7, 33.8] mN·m`: as many digits as the interval bears, at most five of the value."""
    if (
        value is None
        or low is None
        or high is None
        or not all(map(math.isfinite, (value, low, high)))
    ):
        return quantity(value, unit, like=like)
    size = max(abs(value), abs(low), abs(high))
    factor, name = scaled(unit, size if like is None else like)
    if 1e-3 <= factor * size < 1e5 or size == 0:
        scale = 0
    else:
        scale = math.floor(math.log10(factor * size))
    shown = [factor * x / 10.0**scale for x in (value, low, high)]
    decimals = interval_decimals(*shown)
    value_text, low_text, high_text = (fixed(x, decimals) for x in shown)
    power = f" ×10{str(scale).translate(_SUPERSCRIPT)}" if scale else ""
    return f"{value_text} [{low_text}, {high_text}]{power}" + (f" {name}" if name else "")


def interval_decimals(value: float, low: float, high: float) -> int:
    """Decimals that show the half width to one digit, two where it begins below 3.55; the value to
    five.
    """
    half = (high - low) / 2
    size = max(abs(value), abs(low), abs(high))
    if size <= 0:
        return 0
    most = max(0, 4 - math.floor(math.log10(size)))
    if half <= 0:
        return max(0, most - 2)
    place = math.floor(math.log10(half))
    wanted = (1 if half / 10.0**place < 3.55 else 0) - place
    return min(max(wanted, 0), most)


def percent(share: float | None) -> str:
    """`67 %`; a decimal below ten; never a rounded 100 or 0 for what is not."""
    if share is None or not math.isfinite(share):
        return DASH
    value = 100 * share
    if 0 < abs(value) < 0.1:
        if value > 0:
            return "< 0.1 %"
        return f"> {MINUS}0.1 %"
    if 99 < value < 100:
        return f"{min(value, 99.9):.1f} %"
    return f"{fixed(value, 0 if abs(value) >= 9.95 else 1)} %"


def p_value(p: float | None) -> str:
    """`0.032`; `< 0.001`."""
    if p is None or not math.isfinite(p):
        return DASH
    if p < 0.001:
        return "< 0.001"
    return f"{p:.2g}"


def listing(names: Sequence[str], last: str = "and") -> str:
    """`a, b and c`."""
    names = list(names)
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def reward(value: float | None, decimals: int = 3) -> str:
    """A reward; a dash where there is none."""
    if value is None:
        return DASH
    return fixed(value, decimals)


def skill(value: float | None) -> str:
    """A skill with two decimals; a dash for none."""
    if value is None or not math.isfinite(value):
        return DASH
    return f"{value:.2f}".replace("-", MINUS)


def count(n: int | float | None, noun: str) -> str:
    """`1 trial`, `7,200 samples`."""
    if n is None:
        return f"{DASH} {noun}s"
    return f"{int(n):,} {noun}{'' if int(n) == 1 else 's'}"
