"""`--horizon S`: how long the simulated stretches are, in s."""

from __future__ import annotations

import argparse

LONGEST = 1e4
"""s that no stretch reaches."""


def length(text: str) -> float:
    """Seconds, or 0 for whole trials."""
    if not 0.0 <= (value := _seconds(text)) < LONGEST:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no length of time; give seconds, or 0 for whole trials"
        )
    return value


def stretch(text: str) -> float:
    """Seconds above 0."""
    if not 0.0 < (value := _seconds(text)) < LONGEST:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no length of a stretch; give seconds above 0 (whole trials: --yardstick "
            f"whole)"
        )
    return value


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return -1.0
