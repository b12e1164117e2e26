"""Campaign without faults: every row must then detect that nothing was injected.

All code that injects a fault checks `is_sham` first, or uses `inject_unless_sham`. A row that passes without its fault
proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass
class ShamRun:
    """What has happened in a sham campaign.

    Attributes:
        reached: True once code that injects a fault has asked whether it must do nothing. What fails before that has
            detected no missing fault.
    """

    reached: bool = False


_sham: ContextVar[ShamRun | None] = ContextVar("sham", default=None)


@contextmanager
def sham() -> Iterator[ShamRun]:
    """Inject no fault during the context, in the tasks and `asyncio.to_thread` threads that it starts."""
    run = ShamRun()
    token = _sham.set(run)
    try:
        yield run
    finally:
        _sham.reset(token)


def is_sham() -> bool:
    """Return whether code that injects a fault must do nothing."""
    run = _sham.get()
    if run is None:
        return False
    run.reached = True
    return True


def in_sham_campaign() -> bool:
    """Return whether no fault is injected now, for code that injects none."""
    return _sham.get() is not None


def inject_unless_sham(act: Callable[[], object]) -> None:
    """Perform the act of a fault, such as sending a signal; do nothing in a sham campaign."""
    if not is_sham():
        act()
