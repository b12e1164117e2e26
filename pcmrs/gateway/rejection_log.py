"""Tells log and journal of what the gateway itself refuses, at a bounded rate."""

from __future__ import annotations

from dataclasses import dataclass

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.gateway.adapter import Core
from pcmrs.messages import DeviceEvent

PERIOD = 10.0
"""Seconds between two reports of one reason."""

REFUSED = "refused"

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class PendingReport:
    """What was refused for one reason since it was told last: how often, and the newest."""

    count: int
    source: str
    text: str


class RejectionLog:
    """Reports the first of each reason at once; as long as more come, the newest every `PERIOD`, with their number.

    What the dispatcher refuses it journals itself. What does not get there is journalled by this: nothing is refused
    in silence, and a flood fills neither log nor journal. A motion that is refused is reported each time, as one that
    the dispatcher refuses: who looks for why the arm did not move finds it.

    Args:
        core: Journals the reports.
        clock: The machine's.
        tasks: Owns the waiting.
        edge: Of the daemon; stands in the reports.
    """

    def __init__(self, core: Core, clock: Clock, tasks: BackgroundTasks, edge: str = "gateway") -> None:
        self._edge = edge
        self._core = core
        self._clock = clock
        self._tasks = tasks
        self._untold: dict[str, PendingReport] = {}
        self._told: set[str] = set()
        self._waiting = False

    def add(self, source: str, reason: str, text: str, *, each: bool = False) -> None:
        """Takes one refusal; never waits.

        Args:
            source: Who asked, as the daemon records it.
            reason: One of the codes that there are.
            text: What, which value, which limit, what to do.
            each: It is reported at once, by itself.
        """
        if each:
            self._tell(reason, PendingReport(1, source, text))
            return
        before = self._untold.get(reason)
        self._untold[reason] = PendingReport(1 if before is None else before.count + 1, source, text)
        if reason not in self._told:
            self._report(reason)
        if not self._waiting:
            self._waiting = True
            self._tasks.spawn(self._wait())

    async def _wait(self) -> None:
        while self._told:
            await self._clock.sleep(PERIOD)
            self._told.clear()
            for reason in tuple(self._untold):
                self._report(reason)
        self._waiting = False

    def _report(self, reason: str) -> None:
        self._told.add(reason)
        self._tell(reason, self._untold.pop(reason))

    def _tell(self, reason: str, untold: PendingReport) -> None:
        fields = {"count": untold.count, "source": untold.source, "reason": reason}
        _log.warning(REFUSED, text=untold.text, **fields)
        self._core.report(DeviceEvent(device=self._edge, code=REFUSED, text=untold.text, fields=fields))
