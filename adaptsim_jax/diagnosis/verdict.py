"""The verdict of a report: made here alone, whatever searched and whatever is told later on."""

from collections.abc import Sequence
from typing import Any

LEFT = ("structured_unattributed", "partly_explained")
"""Verdicts that say that more than noise is left."""


def verdict(named: bool, left: bool, alike: bool = False) -> str:
    """The kind of the verdict. named: whether anything is; left: whether more than noise is left;
    alike: whether something else does as well in the place of a name.
    """
    if left:
        return "partly_explained" if named else "structured_unattributed"
    if not named:
        return "within_noise"
    return "explained_class" if alike else "explained"


def verdict_of(effects: Sequence[dict[str, Any]], left: bool) -> str:
    """The verdict of the rows `effects` of a report."""
    return verdict(bool(effects), left, any(row.get("alternatives") for row in effects))


def with_effects(
    report: dict[str, Any], effects: Sequence[dict[str, Any]], left: bool | None = None
) -> None:
    """Put other rows into `effects` of a report, and the verdict that goes with them, in place.
    left: whether more than noise is left, as it was where None.
    """
    left = report["verdict"] in LEFT if left is None else left
    report |= {"effects": list(effects), "verdict": verdict_of(effects, left)}
