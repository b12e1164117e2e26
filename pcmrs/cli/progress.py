"""Progress on standard error, so that standard output has only the result: a bar, or lines in a file or pipe."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from pcmrs.cli.tables import Terminal
from pcmrs.clock import SystemClock

LONG = 20_000
"""Number of joint states from which a search takes long enough for a bar."""

LINE_PERIOD = 10.0
"""Time between two lines without a terminal, s of the machine."""


SPEED_PERIOD = 600.0
"""Period over which the speed is estimated for the remaining time, s of the machine: a fault takes half a minute."""


@contextmanager
def progress_bar(*, beyond: int = 0, transient: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar as soon as there is more to do than `beyond`.

    Args:
        beyond: Amount of work that takes too little time for a bar.
        transient: The bar is removed at the end; then nothing is written into a file.

    Yields:
        A function to call with a text, the finished amount of work, and the whole amount.
    """
    console = Terminal(stderr=True)
    # A string as a column is escaped by the terminal; a TextColumn is not.
    times = (TimeElapsedColumn(), "left", TimeRemainingColumn())
    columns = ("{task.description:<40}", BarColumn(), MofNCompleteColumn(), *times)
    bar = Progress(*columns, console=console, transient=transient, speed_estimate_period=SPEED_PERIOD)
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
                console.print(f"{done}/{total} {text}", highlight=False)

        yield show if console.is_terminal else write


@contextmanager
def search_bar(origin: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar for the search of the workflow in a file; a short search shows none.

    Yields:
        A function to call with the numbers of joint states that have been examined and that are known.
    """
    with progress_bar(beyond=LONG, transient=True) as show:
        yield functools.partial(show, f"joint states of {origin}")
