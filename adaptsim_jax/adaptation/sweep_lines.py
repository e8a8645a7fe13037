"""On which line of a TOML file a key stands, so that what is wrong with its value can be said where
it is.
"""

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager

from adaptsim_jax.core.errors import BadInput

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]=]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""\s*((?:"[^"]*"|'[^']*'|[\w-]+)(?:\s*\.\s*(?:"[^"]*"|'[^']*'|[\w-]+))*)\s*=""")


class Lines:
    """Lines, counted from 1, of the keys of a TOML text by their dotted names; entries of
    `[[name]]` are `name.0`, `name.1`, ...
    """

    def __init__(self, path: str, text: str):
        self.path, self.at = path, dict(_keys(text))

    def where(self, key: str) -> str:
        """'FILE, line 7' for a dotted key, or for the table it would stand in; 'FILE' where neither
        is in the text.
        """
        while key not in self.at and "." in key:
            key = key.rpartition(".")[0]
        if key in self.at:
            return f"{self.path}, line {self.at[key]}"
        return self.path

    @contextmanager
    def blamed(self, key: str) -> Iterator[None]:
        """Bad input that is raised inside is said to stand on the line of `key`."""
        try:
            yield
        except BadInput as error:
            where = self.where(key)
            raise BadInput(
                str(error) if str(error).startswith(where) else f"{where}: {error}"
            ) from None


def _keys(text: str) -> Iterator[tuple[str, int]]:
    table, counts, before = "", {}, ""
    for number, line in enumerate(text.splitlines(), 1):
        if before:  # within an array of several lines
            before += "\n" + line
        elif found := _HEADER.match(line):
            table = _dotted(found[2])
            if found[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = f"{table}.{counts[table]}"
            yield table, number
            continue
        elif found := _KEY.match(line):
            name = _dotted(found[1])
            yield (f"{table}.{name}" if table else name), number
            before = line
        if before and _whole(before):
            before = ""


def _whole(text: str) -> bool:
    try:
        tomllib.loads(text)
    except ValueError:
        return False
    return True


def _dotted(name: str) -> str:
    parts = re.findall(r"""\"([^"]*)\"|'([^']*)'|([\w-]+)""", name)
    return ".".join("".join(part) for part in parts)
