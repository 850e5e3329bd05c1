"""Progress with an estimate of the time left: a live bar in a terminal, a line now and then in a log file."""

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class ProgressBar:
    """A context manager that counts up to `total`.

    Args:
      title: what is being done.
      total: number of steps of the whole work.
      done: steps done before (a resumed run).
      quiet: show nothing.
      seconds_between_lines: how often a line is printed where there is no terminal.
    """

    def __init__(
        self, title: str, total: int, done: int = 0, quiet: bool = False, seconds_between_lines: float = 30.0
    ):
        self._title, self._total, self._done, self._first = title, total, done, done
        self._quiet = quiet
        self._interval = seconds_between_lines
        self._console = Console(file=sys.stderr)
        self._bar: Progress | None = None

    def __enter__(self) -> "ProgressBar":
        self._last_line = time.monotonic()
        self._begun: float | None = None
        if not self._quiet and self._console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=self._console,
            )
            self._task = self._bar.add_task(self._title, total=self._total, completed=self._done, note="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, note: str = "") -> None:
        """One step is done; `note` is shown behind the bar."""
        self._done += 1
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, note=note)
            return
        now = time.monotonic()
        if self._begun is None:
            # The first step compiles: it says nothing of the others.
            self._begun, self._first = now, self._done
        if now - self._last_line >= self._interval or self._done == self._total:
            self._last_line = now
            timed, rest = self._done - self._first, self._total - self._done
            left = f", {(now - self._begun) / timed * rest:.0f} s left" if timed else ""
            self._console.print(
                f"{self._title}: {self._done}/{self._total}{left}  {note}",
                soft_wrap=True,
                highlight=False,
            )
