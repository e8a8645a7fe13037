"""Progress of work in parts, some of them at once: a bar for each on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from adaptsim_jax.core.progress import clock

Parts = Callable[..., None]
"""`report(part, done, total, note="")`: `done` of `total` of the part are done; 0 when it begins, all when it is over."""

LINE_EVERY = 20.0  # s between plain lines of one part


def silent(part: str, done: float, total: float, note: str = "") -> None:
    """`Parts` that say nothing."""


@contextlib.contextmanager
def parts_progress(titles: Mapping[str, str], stream: Any = None) -> Iterator[Parts]:
    """`Parts` that show each of `titles` (by part) when it begins and when it is over, with the time that it took. May be called
    from several threads."""
    stream = stream or sys.stderr
    show = _Bars(titles) if stream.isatty() else _Lines(titles, stream)
    try:
        yield show.report
    finally:
        show.close()


class _Lines:
    """A line when a part begins, one each twenty seconds, and one at its end."""

    def __init__(self, titles: Mapping[str, str], stream: Any):
        self.titles, self.stream, self.width = titles, stream, max(map(len, titles.values()))
        self.began: dict[str, float] = {}
        self.next: dict[str, float] = {}
        self.over: set[str] = set()
        self.lock = threading.Lock()

    def report(self, part: str, done: float, total: float, note: str = "") -> None:
        with self.lock:
            now = time.monotonic()
            first = part not in self.began
            if first:
                self.began[part] = now
            if done >= total and part not in self.over:
                self.over.add(part)
                self._say(part, f"done in {clock(now - self.began[part])}" + (f", {note}" if note else ""))
            elif done < total and (first or now >= self.next[part]):
                self._say(part, f"{100 * done / total:.0f} %, {note}" if done > 0 and note else note or "begun")
            else:
                return
            self.next[part] = now + LINE_EVERY

    def _say(self, part: str, words: str) -> None:
        print(f"{self.titles[part]:{self.width}}  {words}", file=self.stream, flush=True)

    def close(self) -> None:
        pass


class _Bars:
    """A rich bar for each part, from its beginning; the library is loaded only when there is something to show."""

    def __init__(self, titles: Mapping[str, str]):
        self.titles = titles
        self.bars: Any = None
        self.rows: dict[str, Any] = {}
        self.lock = threading.Lock()

    def report(self, part: str, done: float, total: float, note: str = "") -> None:
        with self.lock:
            if self.bars is None:
                self._open()
            if part not in self.rows:
                self.rows[part] = self.bars.add_task(self.titles[part], total=1.0, note="")
            self.bars.update(self.rows[part], completed=done / max(total, 1e-9), note=note)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self.bars = Progress(*columns, console=Console(stderr=True))
        self.bars.start()

    def close(self) -> None:
        if self.bars is not None:
            self.bars.stop()
