"""From a verdict to what follows from it: publication, waiting commands, activities and posted commands."""

from __future__ import annotations

import asyncio
from typing import Generic

import structlog

from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher._admission import CommandAdmission
from pcmrs.dispatcher.events import CompletedCommand
from pcmrs.dispatcher.execution import ExecutionContext
from pcmrs.dispatcher.recovery import FailureRecovery, PendingOutcomes
from pcmrs.dispatcher.stops import StopControl
from pcmrs.dispatcher.workflow import C, D, Run
from pcmrs.messages import Command, Verdict

log = structlog.get_logger(__name__)


class FollowUp(Generic[C, D]):
    """Does what follows from a verdict.

    Args:
        context: Shared parts of the dispatcher.
        admission: Admits waiting and posted commands.
        stop_control: Its doubt ends with an acknowledgement.
        recovery: Remembers the reports of devices that a failure has kept from being decided.
        outcomes: Unknown outcomes.
        activities: Follow the states.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        admission: CommandAdmission[C, D],
        stop_control: StopControl[C, D],
        recovery: FailureRecovery[C, D],
        outcomes: PendingOutcomes,
        activities: Activities[C, D],
    ) -> None:
        self._coordinator = context.coordinator
        self._clock = context.clock
        self._locks = context.locks
        self._admission = admission
        self._stop_control = stop_control
        self._recovery = recovery
        self._outcomes = outcomes
        self._activities = activities
        self._listeners = context.listeners

    def on_completed(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        """Publish a verdict that has been given, and release the locks, whatever fails of what follows from it.

        Args:
            completed: The completed command.
            verdict: The verdict on it.
        """
        if verdict.decision == "accepted":
            self._listeners.notify_accepted(completed.command)
        loop = asyncio.get_running_loop()
        # The requester receives it before those who watch: its task runs in the second turn of the loop from now,
        # because of the shield in `Dispatcher.submit`.
        loop.call_soon(loop.call_soon, self._coordinator.publish_verdict, verdict)
        if completed.pending is not None:
            self._locks.running.remove(completed.pending)
            if self._locks.waiting:
                loop.call_soon(self._admission.admit_waiting)
        try:
            self._follow(completed, verdict)
        except Exception as error:
            log.exception("verdict_not_followed", command=verdict.id)
            self._coordinator.fail_for(error)

    def _follow(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        control = self._stop_control
        control.in_doubt = control.in_doubt and not completed.unlatches
        self._outcomes.follow(completed.command, verdict, self._clock.wall())
        self._activities.follow(completed.command)
        self._recovery.remember_missed(completed.command, verdict)
        if completed.run is not None and verdict.decision == "accepted":
            self._submit_posts(completed.command, completed.run)

    def _submit_posts(self, parent: Command, run: Run[C, D]) -> None:
        for number, (branch, operation, arguments) in enumerate(run.posts):
            self._admission.admit(
                Command(
                    id=f"{parent.id}/{number}",
                    branch=branch,
                    operation=operation,
                    source=f"operation:{parent.source}",
                    user=parent.user,
                    role="daemon",
                    arguments=arguments,
                    parent=parent.id,
                )
            )
