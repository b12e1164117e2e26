"""Bars on standard error, so that standard output holds the result only; in a file or a pipe, a line now and then."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pcmrs.clock import SystemClock

LONG = 20_000
"""From so many joint states on a search takes long enough for a bar."""

LINE_PERIOD = 10.0
"""Between two lines where there is no terminal, s of the machine."""


@contextmanager
def progress_bar(*, beyond: int = 0, transient: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A bar that appears as soon as there is more to do than `beyond`.

    Args:
        beyond: So much is done before anybody wonders.
        transient: Whether it is wiped off at the end; then nothing goes into a file.

    Yields:
        What is to be told what is done now, how much is done, and of how much.
    """
    columns = (TextColumn("{task.description:<40}", markup=False), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    bar = Progress(*columns, TimeElapsedColumn(), console=console, transient=transient)
    task = bar.add_task("", total=None)
    clock, last = SystemClock(), -math.inf
    with ExitStack() as shown:

        def show(text: str, done: int, total: int) -> None:
            if total > beyond and not bar.live.is_started:
                shown.enter_context(bar)
            bar.update(task, description=text, completed=done, total=total)

        def write(text: str, done: int, total: int) -> None:
            nonlocal last
            if not transient and total > beyond and (done == total or clock.monotonic() - last > LINE_PERIOD):
                last = clock.monotonic()
                console.print(f"{done}/{total} {text}", markup=False, highlight=False)

        yield show if console.is_terminal else write


@contextmanager
def search_bar(origin: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for the search of the workflow in a file; a short search shows none.

    Yields:
        What is to be told how many joint states have been looked at, and how many are known.
    """
    with progress_bar(beyond=LONG, transient=True) as show:
        yield functools.partial(show, f"joint states of {origin}")
