"""Timers: begun by the commit that enters their state, ended by the one that leaves it; each posts an event."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Mapping
from typing import Generic

from pcmrs.dispatcher.decisions import Decisions
from pcmrs.dispatcher.events import DAEMON, TIMER_ENDED, TIMER_STARTED, CompletedCommand
from pcmrs.dispatcher.execution import ExecutionContext
from pcmrs.dispatcher.workflow import C, D
from pcmrs.fsm.timers import RunningTimer, TimerSchedule
from pcmrs.messages import Command, DeviceEvent, Reason, Verdict


class Timers(Generic[C, D]):
    """Timers of the states that the branches are in.

    They measure the monotonic time of the cell's clock, from the commit that enters the state. So no change of the wall
    clock has an effect, and after a pause of the daemon a timer that is due posts its event once. They end with the
    run: after a restart all branches are in their starting states, in which no timer runs.

    Stop and its latch do not end them. A failure of the journal does not, either: an event that is posted meanwhile is
    submitted again when the procedure is resumed, as the report of a device is, unless the timer has ended or was
    restarted: by an operation whose outcome was unknown, and which the journal has as accepted.

    Args:
        context: Shared parts of the dispatcher.
        decisions: Answers an event that does not count any more.
        limits: The configuration's ``procedure.limits``.

    Raises:
        ConfigurationError: A limit that a timer names cannot be its time.
    """

    def __init__(
        self, context: ExecutionContext[C, D], decisions: Decisions[C, D], limits: Mapping[str, float]
    ) -> None:
        self._context = context
        self._coordinator = context.coordinator
        self._decisions = decisions
        blueprint = context.workflow.blueprint
        self._schedule = TimerSchedule(blueprint, limits)
        self._declared = any(branch.timers for branch in blueprint.branches.values())
        self._parents: dict[str, str] = {}
        self._posted: dict[str, asyncio.Future[Verdict]] = {}
        self._waiting: asyncio.Task[None] | None = None
        self._closed = False

    def follow(self, command: Command, verdict: Verdict) -> None:
        """End the timers of states that have been left, and begin those that a command has begun.

        Args:
            command: The command.
            verdict: The verdict on it.
        """
        if self._closed or not self._declared:
            return
        accepted = f"{command.branch}.{command.operation}" if verdict.decision == "accepted" else ""
        now = self._context.clock.monotonic()
        changes = self._schedule.follow(self._context.procedure.joint(), now, accepted)
        for timer in changes.ended:
            self._withdraw(timer)
            text = f"{timer.key} has ended: {timer.branch} is not {timer.state} any more."
            self._coordinator.announce_later(_event(TIMER_ENDED, timer, command, text))
        for timer in changes.begun:
            self._withdraw(timer)
            self._parents[timer.key] = command.id
            text = f"{timer.key} begins: {timer.posts} follows in {timer.after:g} s while {timer.branch} is "
            self._coordinator.announce_later(_event(TIMER_STARTED, timer, command, f"{text}{timer.state}."))
        if changes.ended or changes.begun:
            self._wait_for_next()

    def counts(self, command: Command) -> bool:
        """Return false for the event of a timer that has ended or was restarted since it was posted.

        Args:
            command: Command of a timer or of any other source.
        """
        source, _, key = command.source.partition(":")
        timer = self._schedule.running.get(key)
        return source != "timer" or (timer is not None and timer.expired)

    def follow_again(self, command: Command, verdict: asyncio.Future[Verdict]) -> None:
        """Withdraw an event that was submitted again, too, if its timer ends or is restarted while it waits.

        Args:
            command: Command of a timer or of any other source.
            verdict: Verdict on it to come.
        """
        source, _, key = command.source.partition(":")
        if source == "timer":
            self._posted[key] = verdict

    def close(self) -> None:
        """End all; none begins any more, and no event follows."""
        self._closed = True
        self._cancel_wait()

    def _wait_for_next(self) -> None:
        self._cancel_wait()
        due = self._schedule.next_due
        if due is not None and not self._closed:
            self._waiting = self._context.tasks.spawn(self._wait(due))

    def _cancel_wait(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    async def _wait(self, due: float) -> None:
        clock = self._context.clock
        while (left := due - clock.monotonic()) > 0.0:
            await clock.sleep(left)
        self._waiting = None  # what follows from an event waits for the next one, and must not cancel this task
        for timer in self._schedule.expire(clock.monotonic()):
            current = self._schedule.running.get(timer.key)
            if current is not None and current.due == timer.due:  # an earlier event may have ended or restarted it
                self._posted[timer.key] = self._coordinator.admit(self._command(timer))
        self._wait_for_next()

    def _command(self, timer: RunningTimer) -> Command:
        return Command(
            id=f"{timer.name}-{uuid.uuid4().hex}",
            branch=timer.branch,
            operation=timer.posts,
            source=f"timer:{timer.key}",
            user=DAEMON,
            role="daemon",
            parent=self._parents[timer.key],
        )

    def _withdraw(self, timer: RunningTimer) -> None:
        """Reject the event of a timer that has ended or was restarted, if it still waits for its branches."""
        posted = self._posted.pop(timer.key, None)
        pending = None if posted is None else self._context.locks.withdraw(posted)
        if pending is not None:
            text = f"{timer.key} has ended, or was restarted, before {pending.name} was decided."
            reason = Reason(code="timer_ended", text=text)
            self._decisions.answer_unrecorded(CompletedCommand(pending.command, pending.verdict, "rejected", reason))


def _event(code: str, timer: RunningTimer, command: Command, text: str) -> DeviceEvent:
    fields = {"branch": timer.branch, "state": timer.state, "after": timer.after, "command": command.id}
    return DeviceEvent(device=f"timer:{timer.key}", code=code, text=text, fields=fields)
