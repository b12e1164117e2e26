"""A campaign whose faults do not take place: every row must then find that nothing was injected.

Whatever brings a fault about asks `is_sham` first, or is done by `bring_about`. A row that passes without its fault
proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_sham = ContextVar("sham", default=False)


@contextmanager
def sham() -> Iterator[None]:
    """No fault takes place during the context, in the tasks and `asyncio.to_thread` threads that it starts."""
    token = _sham.set(True)
    try:
        yield
    finally:
        _sham.reset(token)


def is_sham() -> bool:
    """Whether what brings a fault about must do nothing."""
    return _sham.get()


def bring_about(act: Callable[[], object]) -> None:
    """Does what a fault consists of, such as the sending of a signal; in a sham campaign nothing."""
    if not is_sham():
        act()
