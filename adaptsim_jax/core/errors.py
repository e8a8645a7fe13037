"""The one exception that means: the user's input is at fault, and here is the mend."""

from __future__ import annotations

import math
import sys
import tomllib
import unicodedata
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

# ---------------------------------------------------------------- what was given
#
# What a person gave, in a file or on the command line: whether it is a number that can be used, and
# how to show it in a message.

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


BREAKS = ("Cc", "Zl", "Zp")  # Unicode categories: control characters, line and paragraph separators


def one_line(text: str) -> str:
    """`text` with a space for each line break and escapes for other control characters."""
    escapes = {
        c: c.encode("unicode_escape").decode()
        for c in set(text)
        if unicodedata.category(c) in BREAKS
    }
    return text.translate(str.maketrans(escapes | {"\n": " ", "\r": " ", "\t": " "}))


class BadInput(ValueError):
    """Input that cannot be used. Its message is one line: what (file, row, key), why, and the mend.

    The command line prints the message with its `code` and exits with 2; library callers may catch
    it as a ValueError. Names that files hold may break a line: they are escaped.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(str(message)))
        caller = sys._getframe(1)
        self.place = f"{caller.f_globals.get('__name__')}:{caller.f_code.co_qualname}"

    @property
    def code(self) -> str:
        """The kind of fault, as `E-LOG-007`: the same in every version. Of a message that repeats
        another's words, that one's code; empty where code outside of the package raised it.
        """
        for code, words in fault_codes().get(self.place, {}).items():  # empty words stand last
            if words in str(self):
                repeated = self.__context__
                return repeated.code if not words and isinstance(repeated, BadInput) else code
        return ""

    @property
    def coded(self) -> str:
        """The message with its code at the end."""
        return f"{self} [{self.code}]".removesuffix(" []")


@cache
def fault_codes() -> dict[str, dict[str, str]]:
    """Words by which a message is known, by `module:function` that makes it and by code, as
    `docs/codes.py` keeps them.
    """
    return tomllib.loads(Path(__file__).with_name("codes.toml").read_text(encoding="utf-8"))


def check_counts(record: Any, names: Iterable[str], where: str = "", mark: str = ":") -> None:
    """BadInput where one of these fields of `record` is below 1.

    Args:
        where: What stands before the field's name. mark: Stands before the mend.
    """
    for name in names:
        if getattr(record, name) < 1:
            value = getattr(record, name)
            raise BadInput(f"{where}{name} = {value}{mark} give at least 1")
