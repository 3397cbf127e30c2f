"""How the command tells a person how far it is: on standard error, as a bar, as a line now and then, or not at all."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[int, int], None]

_LINE_SECONDS = 5.0
"""Where there is no terminal, a line is printed this often [s]."""


class Reporter:
    """Says what is going on, for one run of the command.

    Attributes:
        quiet: Nothing is said.
    """

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet

    def say(self, text: str) -> None:
        """One line on standard error."""
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)

    @contextmanager
    def progress(self, title: str, unit: str, rate: int = 0) -> Iterator[Progress]:
        """A callback to be called with (done, total).

        Args:
            title: What is being done.
            unit: What is counted, in the plural.
            rate: How many of them make a second of the run; the speed is then also given relative to real time.
        """
        if self.quiet:
            yield lambda done, total: None
        elif sys.stderr.isatty():
            with _bar(title, unit, rate) as callback:
                yield _now_and_then(callback)
        else:
            yield _now_and_then(_Lines(title, unit, rate))


def _now_and_then(callback: Progress) -> Progress:
    """The callback, passed on at most ten times a second: a run calls it after each of thousands of frames."""
    due = 0.0

    def passed_on(done: int, total: int) -> None:
        nonlocal due
        now = time.perf_counter()
        if now >= due or done >= total:
            due = now + 0.1
            callback(done, total)

    return passed_on


class _Speed:
    """How fast something goes, from the first call on: what came before it, a compilation say, does not count."""

    def __init__(self, unit: str, rate: int) -> None:
        self._unit, self._rate = unit, rate
        self._first: tuple[float, int] | None = None

    def status(self, now: float, done: int, total: int) -> str:
        """'1200 of 5400 frames, 4800/s (160 x real time), 0.9 s left'."""
        if self._first is None:
            self._first = (now, done)
        start, before = self._first
        speed = (done - before) / (now - start) if now > start else 0.0
        left = f", {duration((total - done) / speed)} left" if speed > 0.0 else ""
        return f"{done} of {total} {self._unit}{speed_text(speed, self._rate)}{left}"


class _Lines:
    """A plain line every few seconds; none for what is done sooner."""

    def __init__(self, title: str, unit: str, rate: int) -> None:
        self._title = title
        self._speed = _Speed(unit, rate)
        self._said = time.perf_counter()

    def __call__(self, done: int, total: int) -> None:
        now = time.perf_counter()
        status = self._speed.status(now, done, total)
        if now - self._said >= _LINE_SECONDS:
            self._said = now
            print(f"{self._title}: {status}", file=sys.stderr, flush=True)


@contextmanager
def _bar(title: str, unit: str, rate: int) -> Iterator[Progress]:
    """A bar at the foot of the terminal that goes away when the work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),
        TextColumn("{task.fields[status]}"),
    )
    speed = _Speed(unit, rate)
    # Few refreshes: the bar's thread takes its time from the work.
    with Bar(*columns, console=Console(stderr=True), refresh_per_second=5, transient=True) as bar:
        task = bar.add_task(title, total=None, status="starting (the first run ever compiles for a while)")

        def callback(done: int, total: int) -> None:
            status = speed.status(time.perf_counter(), done, total)
            bar.update(task, completed=done, total=total, status=status)

        yield callback


def speed_text(speed: float, rate: int) -> str:
    """', 4800/s (160 x real time)', or nothing where the speed is not known yet."""
    if speed <= 0.0:
        return ""
    relative = f" ({speed / rate:.3g} x real time)" if rate else ""
    return f", {speed:.0f}/s{relative}" if speed >= 10 else f", {speed:.1f}/s{relative}"


def duration(seconds: float) -> str:
    """A time as people say it: '0.4 s', '12 s', '3 min 20 s', '2 h 5 min'."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def size(count: float) -> str:
    """Bytes as people say them: '12 kB', '3.4 MB', '1.2 GB'."""
    for unit in ("bytes", "kB", "MB"):
        if count < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"
