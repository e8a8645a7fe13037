"""Progress of long work, told by the caller between chunks: a bar on a terminal, plain lines
elsewhere; and of work in parts, some of them at once, with a bar or lines for each.

Library code takes a `Report`, a function of (done, total, note), and knows nothing of terminals.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, TextIO

Report = Callable[..., None]
"""`report(done, total, note="")`: `done` of `total` are done, `math.inf` where nobody knows how
much follows; `note` is a few words such as 'reward 0.93'.
"""

Note = Callable[[str], None]
"""`note(words)` says what a search does now."""

Parts = Callable[..., None]
"""`report(part, done, total, note="")`: `done` of `total` of the part are done; 0 when it begins,
all when it is over.
"""

SHOW_AFTER = 2.0  # s; shorter work says nothing
LINE_EVERY = 10.0  # s between plain lines
PART_LINE_EVERY = 20.0  # s between plain lines of one part


def silent(done: float, total: float, note: str = "") -> None:
    """A `Report` that says nothing."""


def notes_of(report: Report | None) -> Note:
    """`note(words)` for work of which nobody knows how much follows."""
    return partial(report or silent, 0.0, math.inf)


def no_notes(note: str) -> None:
    """A `Note` that says nothing."""


def silent_parts(part: str, done: float, total: float, note: str = "") -> None:
    """`Parts` that say nothing."""


def progress(label: str, stream: Any = None) -> contextlib.AbstractContextManager[Report]:
    """A `Report` that shows `label` with the time left, once the work has taken more than two
    seconds.
    """
    stream = stream or sys.stderr
    return _shown(_Bar(label) if stream.isatty() else _Lines(label, stream))


def parts_progress(
    titles: Mapping[str, str], stream: Any = None
) -> contextlib.AbstractContextManager[Parts]:
    """`Parts` that show each of `titles` (by part) when it begins and when it is over, with the
    time that it took. May be called from several threads.
    """
    stream = stream or sys.stderr
    return _shown(_PartBars(titles) if stream.isatty() else _PartLines(titles, stream))


@contextlib.contextmanager
def _shown(show: Any) -> Iterator[Callable[..., None]]:
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
        if math.isinf(total):
            parts = [f"{self.label}: {clock(now - self.start)} so far", note]
        else:
            parts = [
                f"{self.label}: {100 * done / max(total, 1e-9):.0f} %",
                self._left(now, done, total),
                note,
            ]
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


class _PartLines:
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
                self._report(
                    part, f"done in {clock(now - self.began[part])}" + (f", {note}" if note else "")
                )
            elif done < total and (first or now >= self.next[part]):
                known = done > 0 and note and not math.isinf(total)
                self._report(
                    part, f"{100 * done / total:.0f} %, {note}" if known else note or "begun"
                )
            else:
                return
            self.next[part] = now + PART_LINE_EVERY

    def _report(self, part: str, words: str) -> None:
        print(f"{self.titles[part]:{self.width}}  {words}", file=self.stream, flush=True)

    def close(self) -> None:
        pass


class _Bars:
    """Rich bars, open from the first row on; the library is loaded only when there is something to
    show.

    time: The name of rich's column that tells it. width: Of a bar.
    """

    def __init__(self, time: str, width: int = 40):
        self.time, self.width = time, width
        self.bars: Any = None
        self.rows: dict[tuple[str, bool], Any] = {}

    def update(self, title: str, done: float, total: float, note: str) -> None:
        self.bars = self.bars or self._opened()
        endless = math.isinf(total)
        if (title, endless) not in self.rows:
            if (title, not endless) in self.rows:
                self.bars.remove_task(self.rows.pop((title, not endless)))
            self.rows[title, endless] = self.bars.add_task(
                title, total=None if endless else total, note=""
            )
        known = {} if endless else {"completed": done, "total": total}
        self.bars.update(self.rows[title, endless], note=note, **known)

    def _opened(self) -> Any:
        from rich import progress
        from rich.console import Console

        bars = progress.Progress(
            progress.TextColumn("{task.description}"),
            progress.BarColumn(bar_width=self.width),
            progress.TaskProgressColumn(),
            getattr(progress, self.time)(),
            progress.TextColumn("{task.fields[note]}"),
            console=Console(stderr=True),
        )
        bars.start()
        return bars

    def close(self) -> None:
        if self.bars is not None:
            self.bars.stop()


class _Bar(_Bars):
    """One bar with the time left, once the work has taken a while."""

    def __init__(self, label: str):
        super().__init__("TimeRemainingColumn")
        self.label, self.start = label, time.monotonic()

    def report(self, done: float, total: float, note: str = "") -> None:
        if self.bars is None and (time.monotonic() - self.start < SHOW_AFTER or done >= total):
            return
        if math.isinf(total):
            long = f", {clock(time.monotonic() - self.start)} so far"
        else:
            long = ""
        self.update(self.label, done, total, note + long)


class _PartBars(_Bars):
    """A bar for each part with the time that it has taken, from its beginning."""

    def __init__(self, titles: Mapping[str, str]):
        super().__init__("TimeElapsedColumn", width=24)
        self.titles, self.lock = titles, threading.Lock()

    def report(self, part: str, done: float, total: float, note: str = "") -> None:
        with self.lock:
            self.update(self.titles[part], done, total, note)
