"""What one file adds: tasks, mechanisms, effects, engines and baselines by name, ours and those of
other packages.

A registry knows where each thing stands (`"package.module:NAME"`) and loads it when it is asked
for, so that listing names loads no JAX. Another package adds to it by an entry point of the group
`adaptsim.<kind>`, without a line here:

    [project.entry-points."adaptsim.effects"]
    magnet = "my_package.magnet:MAGNET"
"""

import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput

Thing = TypeVar("Thing")


class Registry(Mapping[str, Thing], Generic[Thing]):
    """Things of one kind by name, in an order that does not change: ours as listed, then those of
    other packages by name.

    kind: Also names the group of entry points. within: A part of it, whose entry points are called
    `within.name`. type: What each thing is, by the name of its class, where they are all of one.
    """

    def __init__(self, kind: str, own: Mapping[str, str], within: str = "", type: str = ""):
        self.group, self.within, self.type = f"adaptsim.{kind}", within, type
        self.own = {name: EntryPoint(name, value, self.group) for name, value in own.items()}

    @cached_property
    def others(self) -> dict[str, EntryPoint]:
        """What other packages add. BadInput where two things have one name."""
        found: dict[str, EntryPoint] = {}
        prefix = f"{self.within}." if self.within else ""
        for point in sorted(entry_points(group=self.group), key=lambda p: p.name):
            name = point.name.removeprefix(prefix)
            if not point.name.startswith(prefix) or (not prefix and "." in name):
                continue
            if name in self.own or name in found:
                raise BadInput(
                    f"entry point {point.name} = {point.value} of {self.group}: there is another "
                    "of that name; rename it"
                )
            found[name] = point
        return found

    def __iter__(self) -> Iterator[str]:
        return iter((*self.own, *self.others))

    def __len__(self) -> int:
        return len(self.own) + len(self.others)

    def __contains__(self, name: object) -> bool:
        return name in self.own or name in self.others

    def __getitem__(self, name: str) -> Thing:
        point = self.own.get(name) or self.others[name]
        if name in self.own:
            return point.load()
        try:
            thing = point.load()
        except Exception as error:
            why = " ".join(f"{error.__class__.__name__}: {error}".split())
            raise BadInput(
                f"entry point {point.name} = {point.value} of {self.group} does not load: {why}; "
                "mend or uninstall it"
            ) from error
        if self.type and self.type not in {c.__name__ for c in thing.__class__.__mro__}:
            raise BadInput(
                f"entry point {point.name} = {point.value} of {self.group} is a "
                f"{thing.__class__.__name__}, not a {self.type}; name the {self.type}"
            )
        return thing

    def named(self, name: str, what: str) -> Thing:
        """The thing called `name`; BadInput with the nearest name where there is none. what: It in
        words, `task`.
        """
        if name not in self:
            raise BadInput(f"{what} '{name}' is unknown; {suggest(name, self)}")
        return self[name]


def function_named(text: str, where: str) -> Callable[..., Any]:
    """The function that `module:function` or `path/to/file.py:function` names. where: The option or
    key that has it, for BadInput.
    """
    home, _, name = text.rpartition(":")
    made = getattr(_module(home, where), name, None)
    if not callable(made):
        raise BadInput(f"{where}: '{home}' has no function '{name}'; name one that it has")
    return made


OWN = "adaptsim_own_"  # begins the names of modules that are a person's own files


def _module(home: str, where: str) -> ModuleType:
    if home.endswith(".py"):
        path = Path(home)
        if not path.exists():
            raise BadInput(
                f"{where}: {home}: no such file; put it there, or name it by its new place (of a "
                "run: in its config.toml)"
            )
        spec = importlib.util.spec_from_file_location(f"{OWN}{path.stem}", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        folder = str(path.resolve().parent)
        if folder not in sys.path:  # it may import its neighbours, now and later
            sys.path.append(folder)
        try:
            spec.loader.exec_module(module)
        except SyntaxError as error:
            raise BadInput(f"{where}: {home}, line {error.lineno}: {error.msg}; mend it") from None
        return module
    try:
        return importlib.import_module(home)
    except ModuleNotFoundError as error:
        raise BadInput(
            f"{where}: no module '{error.name}'; install it, or name a file: "
            f"path/to/{home}.py:function"
        ) from None


def own_line(error: BaseException) -> str | None:
    """'rig.py, line 7' of the last line that `error` passed in a person's own file, or in a
    neighbour of it; None where it passed none.
    """
    files = [m.__file__ for name, m in list(sys.modules.items()) if name.startswith(OWN)]
    folders = {Path(file).resolve().parent for file in files if file}
    found = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        path = Path(frame.f_code.co_filename)
        if folders and path.resolve().parent in folders:
            found = f"{path.name}, line {line}"
    return found
