"""From the press of Stop, or a danger event, to the confirmed standstill."""

from __future__ import annotations

import asyncio
from typing import Any, Generic

from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher.decisions import Decisions
from pcmrs.dispatcher.events import DAEMON, Submission, not_confirmed, stopped
from pcmrs.dispatcher.execution import ExecutionContext
from pcmrs.dispatcher.recorder import QueuedRow
from pcmrs.dispatcher.stops import STANDSTILL, Presses, Stops, StopUnderWay
from pcmrs.dispatcher.workflow import C, D
from pcmrs.messages import Reason, Verdict


class StopControl(Generic[C, D]):
    """Stops everything, and follows each Stop until the robot has confirmed that it stands.

    Args:
        context: Shared parts of the dispatcher.
        stops: Numbers Stops and knows what each waits for.
        decisions: Rejects waiting commands.
        activities: Activities that may move the robot.

    Attributes:
        in_doubt: The hold of a Stop or a failure was not confirmed, and this has not been acknowledged since.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        stops: Stops,
        decisions: Decisions[C, D],
        activities: Activities[C, D],
    ) -> None:
        self.in_doubt = False
        self._coordinator = context.coordinator
        self._procedure = context.procedure
        self._tasks = context.tasks
        self._hold = context.hold
        self._presses = Presses(context.coordinator)
        self._stops = stops
        self._locks = context.locks
        self._decisions = decisions
        self._activities = activities
        self._listeners = context.listeners

    def begin(self, source: str, reason: Reason | None, then: Submission) -> asyncio.Task[bool]:
        """Begin to stop everything; see `Dispatcher.begin_stop`.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has requested it.
            then: Submits the operations that follow from a danger event.
        """
        reason = reason or Reason(code="stopped", text=f"Stopped by {source}.", fields={"source": source})
        number, holding = self.latch(), self._hold.stop()
        self._stops.wait_for(STANDSTILL, holding)
        moving = self._activities.end_moving()
        ending = [pending.verdict for pending in self._locks.running]
        for pending in self._locks.running:
            pending.stop(reason)
        self._listeners.notify_stop()
        for pending in self._locks.turn_away():
            pending.end_wait()
            self._decisions.reject(pending.command, pending.verdict, reason)
        recorded = self._coordinator.announce(stopped(source, reason, number))
        following = self.follow_danger(then)
        self._coordinator.publish_snapshot()
        return self._tasks.spawn(self._end(number, source, recorded, [holding, *ending, *moving, *following]))

    def press(self, source: str, presses: int) -> StopUnderWay:
        """Stop for a person; see `Dispatcher.press_stop`.

        Args:
            source: Who stops.
            presses: Number of presses of this source since the last call.
        """
        stop = self._presses.find(source)
        if stop is None or self._started_since_stop():
            standing = self.begin(source, None, list)
            stop, presses = StopUnderWay(source, self._stops.state.number, standing), presses - 1
            self._presses.add(stop, self._hold.stop())
        else:
            self._listeners.notify_stop()  # commands that have come to the edges since end, too
        if presses:
            stop.join(source, presses)
        return stop

    def latch(self) -> int:
        """Set the latch, which counts as a Stop; return the Stop's number."""
        self._stops.begin()
        self._procedure.latch()
        return self._stops.state.number

    def follow_danger(self, submit: Submission) -> list[asyncio.Future[Verdict]]:
        """Submit the operations that follow from danger, and allow no acknowledgement before they are decided.

        Operations that the state does not allow are decided already: they neither run nor wait.
        """
        following = submit()
        for pending in (*self._locks.running, *self._locks.waiting):
            if pending.verdict in following:
                self._stops.wait_for(pending.name, pending.verdict)
        return following

    async def hold_after_failure(self, number: int) -> None:
        """Hold the robot because of a failure, and confirm Stop `number` or doubt that the robot stands."""
        await self.take_standstill(number, DAEMON, stands=await self._hold.stop())

    async def take_standstill(self, number: int, source: str, *, stands: bool) -> None:
        """Confirm a Stop, or announce that robot or stimulator have not confirmed that they stand.

        Args:
            number: Number of the Stop.
            source: Who has stopped.
            stands: Robot and stimulator have confirmed.
        """
        if stands:
            self._stops.stood(number)
            self._coordinator.publish_snapshot()
        else:
            self.in_doubt = True
            await self._coordinator.announce(not_confirmed(source))

    def _started_since_stop(self) -> bool:
        """Returns whether anything runs or waits that the last Stop has not ended."""
        running = any(pending.stopped is None for pending in self._locks.running)
        return running or any(not pending.spec.event for pending in self._locks.waiting)

    async def _end(self, number: int, source: str, recorded: QueuedRow, ending: list[asyncio.Future[Any]]) -> bool:
        await recorded
        await asyncio.wait(ending)
        confirmed = all(each.result() is not False for each in ending)
        await self.take_standstill(number, source, stands=confirmed)
        return confirmed
