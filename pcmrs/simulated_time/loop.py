"""An event loop in which waiting costs nothing: when no callback is due, time jumps to the next timer.

The timers and the order in which callbacks were scheduled determine the order of execution. Tasks are numbered, so that
a set of them has the same order in every run. Sockets, threads and processes are not supported: using them fails.

All simulated processes share the loop. One of them can be held up, as by a long callback or by a scheduler that gives
it no time: its callbacks then wait, in their order, and those of the others continue.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections import deque
from collections.abc import Callable
from contextvars import Context, ContextVar
from typing import Any, TypeVarTuple, Unpack, cast

from pcmrs.errors import PcmrsError


class SimulationError(PcmrsError):
    """The simulation itself cannot go on."""

    code = "simulation"


class _NumberedTask(asyncio.Task[Any]):
    """A task that is hashed by its number: the address of an object differs in every run."""

    def __init__(self, work: Any, *, loop: SimulatedLoop, **options: Any) -> None:
        self._number = loop.next_number()  # first, because the base class puts the task into a set
        super().__init__(work, loop=loop, **options)

    def __hash__(self) -> int:
        return self._number


_Arguments = TypeVarTuple("_Arguments")

OWNER: ContextVar[dict[asyncio.Task[Any], None] | None] = ContextVar("owner", default=None)
"""Tasks of the simulated process in whose context the code runs; tasks that it starts belong to it, too."""


class SimulatedLoop(asyncio.BaseEventLoop):
    """An event loop in simulated time, which starts at 0 s."""

    _ready: deque[asyncio.Handle]  # of the base class

    def __init__(self) -> None:
        super().__init__()
        self._now = 0.0
        self._numbers = itertools.count(1)
        self._timers: list[tuple[float, int, asyncio.TimerHandle]] = []
        self._held_up: dict[int, float] = {}
        self.set_task_factory(self._numbered_task)

    def time(self) -> float:
        """Return the simulated time since the loop was made, s."""
        return self._now

    def call_soon(
        self,
        callback: Callable[[Unpack[_Arguments]], object],
        *args: *_Arguments,
        context: Context | None = None,
    ) -> asyncio.Handle:
        handle = asyncio.Handle(callback, args, self, context)
        self._ready.append(handle)
        return handle

    def call_soon_threadsafe(
        self,
        callback: Callable[[Unpack[_Arguments]], object],
        *args: *_Arguments,
        context: Context | None = None,
    ) -> asyncio.Handle:
        """Call soon: what a thread of a simulated process does runs in the thread of this loop."""
        return self.call_soon(callback, *args, context=context)

    def call_later(
        self,
        delay: float,
        callback: Callable[[Unpack[_Arguments]], object],
        *args: *_Arguments,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        return self.call_at(self._now + delay, callback, *args, context=context)

    def call_at(
        self,
        when: float,
        callback: Callable[[Unpack[_Arguments]], object],
        *args: *_Arguments,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        timer = asyncio.TimerHandle(when, callback, args, self, context)
        heapq.heappush(self._timers, (when, next(self._numbers), timer))
        return timer

    def _run_once(self) -> None:
        """Advance to the next timer if no callback is due, then run what is due."""
        timers, due = self._timers, self._ready
        while timers and (timers[0][0] <= self._now or not due or timers[0][2].cancelled()):
            when, _, timer = heapq.heappop(timers)
            if not timer.cancelled():
                self._now = max(self._now, when)
                due.append(timer)
        if not (due or self._stopping):  # type: ignore[attr-defined]
            raise SimulationError("The simulation is stuck: all tasks wait, and no timer is set.")
        for _ in range(len(due)):
            handle = due.popleft()
            if handle.cancelled():
                continue
            until = self._held_up_until(handle) if self._held_up else 0.0
            if until > self._now:
                heapq.heappush(timers, (until, next(self._numbers), cast(asyncio.TimerHandle, handle)))
            else:
                handle._run()  # noqa: SLF001  # as asyncio's own loop does

    def hold_up(self, owned: dict[asyncio.Task[Any], None], seconds: float) -> None:
        """Hold up the process that owns these tasks; its threads continue.

        Args:
            owned: Tasks of the process, see `OWNER`.
            seconds: Duration from now, s.
        """
        self._held_up[id(owned)] = self._now + seconds

    def _held_up_until(self, handle: asyncio.Handle) -> float:
        owned = handle._context.get(OWNER)  # type: ignore[attr-defined]  # noqa: SLF001  # asyncio shows it nowhere
        until = 0.0 if owned is None else self._held_up.get(id(owned), 0.0)
        if self._held_up and max(self._held_up.values()) <= self._now:
            self._held_up.clear()
        return until

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """Do nothing: a cancelled timer is dropped when it is due."""

    def next_number(self) -> int:
        """Return the number of the next task."""
        return next(self._numbers)

    @staticmethod
    def _numbered_task(loop: asyncio.AbstractEventLoop, work: Any, **options: Any) -> asyncio.Task[Any]:
        task = _NumberedTask(work, loop=cast(SimulatedLoop, loop), **options)
        context: Context | None = options.get("context")
        owned = OWNER.get() if context is None else context.get(OWNER)
        if owned is not None:
            owned[task] = None
            task.add_done_callback(owned.pop)
        return task
