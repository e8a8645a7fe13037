"""What a person gave, in a file or on the command line: whether it is a number that can be used,
and how to show it in a message.
"""

from __future__ import annotations

import math
from typing import Any

MAX_SEED = 2**32 - 1  # of JAX


def finite(value: Any) -> float | None:
    """`value` as a float; None where it is no number (booleans are none), not finite, or an integer
    beyond every float.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    if math.isfinite(number):
        return number
    return None


def brief(value: Any) -> str:
    """`value` as it was written, cut at 60 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than some thousand digits
        return "a number of thousands of digits"
    if len(text) <= 60:
        return text
    return text[:57] + "..."
