"""The bar that shows how far a search of joint states has come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

LONG = 20_000
"""From so many joint states on the search takes long enough for a progress bar."""


@contextmanager
def search_bar(origin: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on standard error for the search of the workflow in a file; a short search shows none.

    Yields:
        What is to be told how many joint states have been looked at, and how many are known.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(f"joint states of {escape(origin)}", total=None)
    with ExitStack() as shown:

        def show(looked_at: int, known: int) -> None:
            if known > LONG and not bar.live.is_started:
                shown.enter_context(bar)
            bar.update(task, completed=looked_at, total=known)

        yield show
