"""Log and journal of the refusals by the gateway itself, at a bounded rate."""

from __future__ import annotations

from dataclasses import dataclass

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.gateway._adapter import Core
from pcmrs.messages import DeviceEvent

PERIOD = 10.0
"""Period of the reports of one reason, s."""

REFUSED = "refused"

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class PendingReport:
    """Refusals for one reason since its last report: their number, and the newest one."""

    count: int
    source: str
    text: str


class RejectionLog:
    """Log that reports the first refusal of a reason at once, and then the newest every `PERIOD`, with their number.

    The dispatcher journals its own refusals. This log journals those that do not get there: no refusal is silent, and a
    flood fills neither log nor journal. Each refusal of a motion is reported, as by the dispatcher, so that anyone who
    looks for why the arm did not move finds it.

    Args:
        core: The daemon, which journals the reports.
        clock: The machine's clock.
        tasks: Owner of the task that waits.
        edge: Name of the edge of the daemon, for the reports.
    """

    def __init__(self, core: Core, clock: Clock, tasks: BackgroundTasks, edge: str = "gateway") -> None:
        self._edge = edge
        self._core = core
        self._clock = clock
        self._tasks = tasks
        self._pending: dict[str, PendingReport] = {}
        self._reported: set[str] = set()
        self._waiting = False

    def add(self, source: str, reason: str, text: str, *, each: bool = False) -> None:
        """Add one refusal; never waits.

        Args:
            source: Source of the command, as it is journalled.
            reason: Code of the reason, one of a fixed set.
            text: What was refused, the value, the limit, and what to do.
            each: Report it at once, by itself.
        """
        if each:
            self._publish(reason, PendingReport(1, source, text))
            return
        before = self._pending.get(reason)
        self._pending[reason] = PendingReport(1 if before is None else before.count + 1, source, text)
        if reason not in self._reported:
            self._report(reason)
        if not self._waiting:
            self._waiting = True
            self._tasks.spawn(self._wait())

    async def _wait(self) -> None:
        while self._reported:
            await self._clock.sleep(PERIOD)
            self._reported.clear()
            for reason in tuple(self._pending):
                self._report(reason)
        self._waiting = False

    def _report(self, reason: str) -> None:
        self._reported.add(reason)
        self._publish(reason, self._pending.pop(reason))

    def _publish(self, reason: str, report: PendingReport) -> None:
        fields = {"count": report.count, "source": report.source, "reason": reason}
        _log.warning(REFUSED, text=report.text, **fields)
        self._core.report(DeviceEvent(device=self._edge, code=REFUSED, text=report.text, fields=fields))
