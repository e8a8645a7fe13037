"""The one exception that means: the user's input is at fault, and here is the mend."""

import unicodedata

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

    The command line prints the message and exits with code 2; library callers may catch it as a
    ValueError. Names that files hold may break a line: they are escaped.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(str(message)))
