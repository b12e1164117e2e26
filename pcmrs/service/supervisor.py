"""Tasks of the daemon: each has a name and a limit of restarts; beyond that the daemon stops safely and ends."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from contextvars import ContextVar
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NoReturn

import structlog

from pcmrs.clock import Clock
from pcmrs.errors import SupervisionError
from pcmrs.messages import DeviceEvent

log = structlog.get_logger(__name__)

RESTARTS = 3
"""Limit of the restarts of a task within `WITHIN`."""
WITHIN = 60.0
"""Period of `RESTARTS`, s of the machine."""
REPORT_TIME = 5.0
"""Limit of the wait for a report and the Stop that may follow from it, s."""

Report = Callable[[DeviceEvent], Awaitable[None]]
Work = Callable[[], Coroutine[Any, Any, None]]


class RestartLimit:
    """Limit of restarts per time.

    Args:
        restarts: Limit of the restarts within `within`.
        within: Period, s of `clock`.
        clock: The machine's clock.
    """

    def __init__(self, restarts: int, within: float, clock: Clock) -> None:
        self.restarts, self.within = restarts, within
        self._clock = clock
        self._deaths: deque[float] = deque()

    def reached(self) -> bool:
        """Count one more death; return whether it is one too many."""
        now = self._clock.monotonic()
        self._deaths.append(now)
        while now - self._deaths[0] > self.within:
            self._deaths.popleft()
        return len(self._deaths) > self.restarts


@dataclass(slots=True)
class TaskStatus:
    """Status of one supervised task.

    Attributes:
        name: Name of the task.
        quiet: Limit between two marks of a task that works, s of the machine; None for one that only waits.
        marked: Time of its last mark, s of the machine's monotonic clock.
        restarts: Number of its restarts.
    """

    name: str
    quiet: float | None
    marked: float
    restarts: int = 0

    def answers(self, now: float) -> bool:
        """Return whether it has marked within its limit at time `now`, s."""
        return self.quiet is None or now - self.marked <= self.quiet


class Supervisor:
    """One `asyncio.TaskGroup` of named tasks; a context, whose end cancels them and waits for their end.

    A task that dies, by an error or by ending, is logged with its name, counted, reported and restarted. One that dies
    more often than its limit ends the context with `SupervisionError`, after a report of danger: then the robot is held
    and latched. Tasks that are not restarted are owned by `pcmrs.background.BackgroundTasks` instead.

    Args:
        clock: The machine's clock.

    Attributes:
        report: Takes the events, such as `Dispatcher.report`; to be set before any task can die that matters.
        died: Tasks that died since the start.
        strays: Failures in the event loop that belong to no task of the supervisor, such as a handler of the bus.
    """

    def __init__(self, clock: Clock) -> None:
        self.report: Report = _to_nobody
        self.died = self.strays = 0
        self._clock = clock
        self._group = asyncio.TaskGroup()
        self._tasks: set[asyncio.Task[None]] = set()
        self._statuses: dict[str, TaskStatus] = {}
        self._failure: SupervisionError | None = None

    async def __aenter__(self) -> Supervisor:
        await self._group.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for task in tuple(self._tasks):
            task.cancel()
        try:
            await self._group.__aexit__(kind, error, trace)
        except BaseExceptionGroup:
            if self._failure is not None:
                raise self._failure from self._failure.__cause__
            if error is None:
                raise

    def start(
        self, name: str, work: Work, *, restarts: int = RESTARTS, within: float = WITHIN, quiet: float | None = None
    ) -> None:
        """Run `work`, which does not end by itself, until the context ends.

        Args:
            name: Unique name of the task.
            work: Makes the coroutine, again for every restart.
            restarts: Limit of the restarts within `within`.
            within: Period of that limit, s of the machine.
            quiet: Limit between two calls of `mark` by `work`, s of the machine; None if it only waits.
        """
        status = self._statuses[name] = TaskStatus(name, quiet, self._clock.monotonic())
        self._create(name, self._keep(status, work, RestartLimit(restarts, within, self._clock)))

    def spawn(self, name: str, work: Coroutine[Any, Any, object]) -> None:
        """Run `work` once; an error in it ends the daemon safely, since nobody else would receive it.

        Args:
            name: Name of the task.
            work: The coroutine.
        """
        self._create(name, self._once(name, work))

    def statuses(self) -> list[TaskStatus]:
        """Return the status of all started tasks, in order of their start."""
        return list(self._statuses.values())

    def counters(self) -> dict[str, int]:
        """Return the numbers of tasks that died, of failures outside of tasks, and of restarts by task."""
        restarted = {f"restarts.{each.name}": each.restarts for each in self.statuses() if each.restarts}
        return {"tasks.died": self.died, "tasks.strays": self.strays, **restarted}

    def handle_loop_exception(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Log and count a failure outside of all tasks; the exception handler of the event loop.

        Args:
            _loop: The event loop.
            context: Message and exception; see `asyncio.loop.call_exception_handler`.
        """
        self.strays += 1
        log.error("stray_failure", what=context.get("message"), exc_info=context.get("exception"))

    def _create(self, name: str, work: Coroutine[Any, Any, None]) -> None:
        task = self._group.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _once(self, name: str, work: Coroutine[Any, Any, object]) -> None:
        error = await self._death(work)
        if error is not None:
            self._note(name, error)
            await self._give_up(name, error, "")

    async def _keep(self, status: TaskStatus, work: Work, limit: RestartLimit) -> None:
        _marked.set(lambda: setattr(status, "marked", self._clock.monotonic()))
        while True:
            error = await self._death(work())
            self._note(status.name, error)
            if limit.reached():
                await self._give_up(status.name, error, f" more than {limit.restarts} times within {limit.within:g} s")
            status.restarts, status.marked = status.restarts + 1, self._clock.monotonic()
            text = f"The daemon's task '{status.name}' died ({_named(error)}) and was restarted."
            await self._report(DeviceEvent(device="daemon", code="task_restarted", text=text))

    async def _death(self, work: Coroutine[Any, Any, object]) -> BaseException | None:
        """Run the work until it dies; return its error, or None if it has ended without one."""
        try:
            await work
        except (KeyboardInterrupt, SystemExit, GeneratorExit):
            raise
        except BaseException as error:  # a panic of a library in Rust is not an Exception
            task = asyncio.current_task()
            if task is not None and task.cancelling():
                raise  # the context ends: nothing is restarted
            return error  # also a cancellation, if something was cancelled that it has waited for
        return None

    def _note(self, name: str, error: BaseException | None) -> None:
        self.died += 1
        log.error("task_died", task=name, reason=_named(error), exc_info=error)

    async def _give_up(self, name: str, error: BaseException | None, how_often: str) -> NoReturn:
        text = (
            f"The daemon's task '{name}' died{how_often} ({_named(error)}): motion is held and the daemon ends. "
            "The log says why it died; start the daemon again when that is fixed."
        )
        self._failure = SupervisionError(text, task=name)
        event = DeviceEvent(device="daemon", code="task_failed", text=text, danger=True, fields={"task": name})
        await self._report(event)
        raise self._failure from error

    async def _report(self, event: DeviceEvent) -> None:
        """Report an event and wait for the Stop that may follow, within a limit: a failing Stop delays nothing."""
        try:
            async with self._clock.timeout(REPORT_TIME):
                await self.report(event)
        except Exception:
            log.exception("report_failed", code=event.code)


def mark() -> None:
    """Mark that the supervised task of the caller works; do nothing in other tasks."""
    _marked.get()()


def _nothing() -> None:
    """Do nothing: the caller is not supervised."""


_marked: ContextVar[Callable[[], object]] = ContextVar("marked", default=_nothing)


async def _to_nobody(_event: DeviceEvent) -> None:
    """Ignore an event: nothing can be held yet, and the event has been logged."""


def _named(error: BaseException | None) -> str:
    return f"{type(error).__name__}: {error}" if error is not None else "it ended by itself"
