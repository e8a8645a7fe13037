"""Progress of long work, told by the caller between chunks: a bar on a terminal, plain lines elsewhere.

Library code takes a `Report`, a function of (done, total, note), and knows nothing of terminals.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, TextIO

Report = Callable[..., None]
"""`report(done, total, note="")`: `done` of `total` are done; `note` is a few words such as 'reward 0.93'."""

SHOW_AFTER = 2.0  # s; shorter work says nothing
LINE_EVERY = 10.0  # s between plain lines


def silent(done: float, total: float, note: str = "") -> None:
    """A `Report` that says nothing."""


@contextlib.contextmanager
def progress(label: str, stream: Any = None) -> Iterator[Report]:
    """A `Report` that shows `label` with the time left, once the work has taken more than two seconds."""
    stream = stream or sys.stderr
    show = _Bar(label) if stream.isatty() else _Lines(label, stream)
    try:
        yield show.report
    finally:
        show.close()


def clock(seconds: float) -> str:
    """'42 s', '3 min 05 s' or '2 h 07 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


class _Lines:
    """A line every ten seconds, for logs and pipes."""

    def __init__(self, label: str, stream: TextIO):
        self.label, self.stream = label, stream
        self.start = time.monotonic()
        self.first: tuple[float, float] | None = None
        self.next = self.start + SHOW_AFTER
        self.shown = False

    def report(self, done: float, total: float, note: str = "") -> None:
        now = time.monotonic()
        # the first chunk holds the compile time, so the rate is measured after it
        if self.first is None:
            self.first = (now, done)
        if now < self.next or (done >= total and not self.shown):
            return
        self.next, self.shown = now + LINE_EVERY, True
        left = self._left(now, done, total)
        parts = [f"{self.label}: {100 * done / max(total, 1e-9):.0f} %", left, note]
        print(", ".join(part for part in parts if part), file=self.stream, flush=True)

    def _left(self, now: float, done: float, total: float) -> str:
        if done >= total:
            return f"done in {clock(now - self.start)}"
        since, before = self.first or (self.start, 0.0)
        if done <= before:
            return ""
        return f"{clock((now - since) * (total - done) / (done - before))} left"

    def close(self) -> None:
        pass


class _Bar:
    """A rich bar; the library is loaded only when there is something to show."""

    def __init__(self, label: str):
        self.label = label
        self.start = time.monotonic()
        self.bar = None
        self.task = None

    def report(self, done: float, total: float, note: str = "") -> None:
        if self.bar is None:
            if time.monotonic() - self.start < SHOW_AFTER or done >= total:
                return
            self._open()
        self.bar.update(self.task, completed=done, total=total, note=note)  # type: ignore[union-attr]

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self.bar = Progress(*columns, console=Console(stderr=True))
        self.task = self.bar.add_task(self.label, note="")
        self.bar.start()

    def close(self) -> None:
        if self.bar is not None:
            self.bar.stop()
