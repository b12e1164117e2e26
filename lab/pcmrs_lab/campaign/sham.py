"""Campaign without faults: every row must then detect that nothing was injected.

All code that injects a fault checks `is_sham` first, or uses `inject_unless_sham`. A row that passes without its fault
proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_sham = ContextVar("sham", default=False)


@contextmanager
def sham() -> Iterator[None]:
    """Inject no fault during the context, in the tasks and `asyncio.to_thread` threads that it starts."""
    token = _sham.set(True)
    try:
        yield
    finally:
        _sham.reset(token)


def is_sham() -> bool:
    """Return whether code that injects a fault must do nothing."""
    return _sham.get()


def inject_unless_sham(act: Callable[[], object]) -> None:
    """Perform the act of a fault, such as sending a signal; do nothing in a sham campaign."""
    if not is_sham():
        act()
