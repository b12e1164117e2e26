"""From completed command to verdict: journalled, committed, answered, then published.

The journal takes a limited number of rejections of each user, and of all users together: a program on the cell's
machine may use many names. A rejection beyond the limit is answered like any other, but leaves no row: one row says how
many there were. Accepted commands are not counted. The reason of a rejection is clipped, since it may repeat what the
sender has chosen.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial
from typing import Any, Final, Generic

import structlog

from pcmrs.bucket import TokenBucket
from pcmrs.clock import Clock
from pcmrs.dispatcher.command_checks import is_event
from pcmrs.dispatcher.events import CompletedCommand, Coordinator, Recorder
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.dispatcher.workflow import C, D
from pcmrs.errors import JournalError, PcmrsError
from pcmrs.failpoints import failpoint
from pcmrs.messages import Command, Decision, DeviceEvent, Reason, Verdict
from pcmrs.messages.clipping import clipped_reason
from pcmrs.messages.identity import PEOPLE

RATE_HZ: Final = 10.0
"""Long-term rate of one user's rejections that get a row each, Hz."""
BURST: Final = 1000
"""Number of one user's rejections that may get a row at once."""
USERS: Final = 16
"""Number of users with their own limit; the others share one."""
TOGETHER: Final = 4
"""Rate and number of the rejections of all users together that get a row, in multiples of those of one user."""
OTHERS: Final = "others"
PERIOD: Final = 10.0
"""Period after which one row counts the rejections without a row, s."""
TOO_MANY: Final = "too_many_rejections"
DROPPED: Final = "rejections_dropped"


class Rejections:
    """Decide which rejections get a row.

    Args:
        clock: Clock of the machine.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._buckets: dict[str, TokenBucket] = {}
        self._together = TokenBucket(TOGETHER * RATE_HZ, TOGETHER * BURST, clock)
        self._dropped: dict[str, int] = {}
        self._coordinator: Coordinator[Any, Any] | None = None
        self._timer: asyncio.TimerHandle | None = None

    def attach(self, coordinator: Coordinator[Any, Any]) -> None:
        """Announce the number of rejections without a row by `coordinator`, once per `PERIOD` while there are any."""
        self._coordinator = coordinator

    def limit(self, command: Command, reason: Reason) -> Reason | None:
        """Return why a rejection gets no row; None if it gets one.

        Args:
            command: The rejected command.
            reason: Reason of the rejection.
        """
        if command.role not in PEOPLE:
            return None
        known = command.user in self._buckets or len(self._buckets) < USERS
        name = command.user if known else OTHERS
        bucket = self._buckets.setdefault(name, TokenBucket(RATE_HZ, BURST, self._clock))
        spent, whose, rate_hz = bucket, command.user, RATE_HZ
        if bucket.take():
            if self._together.take():
                return None
            spent, whose, rate_hz = self._together, "all users", TOGETHER * RATE_HZ
        self._dropped[name] = self._dropped.get(name, 0) + 1
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(PERIOD, self.report)
        wait = spent.wait
        text = f"Commands of {whose} were rejected more often than {rate_hz:g} times per second, so this rejection is "
        text += f"only counted: correct the command, and ask again in {wait:.1f} s. "
        text += f"Reason of the rejection: {reason.text}"
        fields = {"rejected_for": reason.code, "limit_hz": rate_hz, "retry_after": wait}
        return Reason(code=TOO_MANY, text=text, fields=fields)

    def report(self) -> None:
        """Announce how many rejections have got no row since the last time."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        dropped, self._dropped = self._dropped, {}
        for user, count in dropped.items():
            text = f"{count} rejections of commands of {user} have no row: the limits are {RATE_HZ:g} per second, and "
            text += f"{TOGETHER * RATE_HZ:g} of all users together."
            fields = {"user": user, "count": count, "limit_hz": RATE_HZ}
            if self._coordinator is not None:
                event = DeviceEvent(device="dispatcher", code=DROPPED, text=text, fields=fields)
                self._coordinator.announce_later(event)


log = structlog.get_logger(__name__)

JOURNAL = JournalError.code


class Decisions(Generic[C, D]):
    """Make completed commands durable and commit them, one after the other.

    Args:
        procedure: The procedure that they change.
        recorder: The journal.
        verdict_cache: Verdicts that requesters wait for.
        coordinator: The dispatcher. It gets each completed command once its verdict is given, and fails when one
            cannot be journalled or committed.
        rejections: Decides which rejections get no row; None if all get one.

    Attributes:
        unconfirmed: Commands that could not be concluded; only the disk knows whether they are journalled.
    """

    def __init__(
        self,
        procedure: Procedure[C, D],
        recorder: Recorder,
        verdict_cache: VerdictCache,
        coordinator: Coordinator[C, D],
        rejections: Rejections | None = None,
    ) -> None:
        self._procedure = procedure
        self._recorder = recorder
        self._verdict_cache = verdict_cache
        self._coordinator = coordinator
        self._rejections = rejections
        self.unconfirmed: list[CompletedCommand[C, D]] = []

    def conclude(self, completed: CompletedCommand[C, D]) -> None:
        """Journal a decision; as soon as it is durable, commit and answer it.

        A rejected event leaves no row: it changes nothing, and the report of the device has its own row.
        """
        procedure, rejected = self._procedure, completed.decision == "rejected"
        if rejected and is_event(procedure.blueprint, completed.command):
            self._verdict_cache.forget(completed.command)
            self._answer(completed, self._verdict(completed, "rejected", completed.reason, procedure.joint()))
            return
        limited = self._limit(completed) if rejected else None
        if limited is not None:
            self._only_answer(completed, limited)
            return
        try:
            sequence = procedure.sequence if rejected else procedure.reserve(completed.change)
            states = procedure.joint() | (dict(completed.change.states) if completed.change is not None else {})
            verdict = self._verdict(completed, completed.decision, completed.reason, states, sequence)
            failpoint("dispatcher.before_outcome")
            written = self._recorder.decision(
                completed.command,
                verdict,
                procedure.promised(),
                completed.changes,
                with_intent=completed.with_intent,
            )
            durable: asyncio.Future[Any] = asyncio.ensure_future(written)
        except Exception as error:
            self.fail_with(completed, error)
            return
        if durable.done():
            self._commit(completed, verdict, durable)
        else:
            durable.add_done_callback(partial(self._commit, completed, verdict))

    def reject(self, command: Command, verdict: asyncio.Future[Verdict], reason: Reason) -> None:
        """Conclude a command as rejected.

        Args:
            command: The command.
            verdict: Verdict to give.
            reason: Reason of the rejection.
        """
        self.conclude(CompletedCommand(command, verdict, "rejected", reason))

    def reject_unrecorded(self, command: Command, verdict: asyncio.Future[Verdict], reason: Reason) -> None:
        """Reject a command without a row, and publish that. One beyond the limit is only counted, as if it had a row.

        Args:
            command: The command.
            verdict: Verdict to give.
            reason: Reason of the rejection.
        """
        rejected: CompletedCommand[C, D] = CompletedCommand(command, verdict, "rejected", reason)
        self.answer_unrecorded(replace(rejected, reason=self._limit(rejected) or reason))
        self._coordinator.publish_verdict(verdict.result())

    def answer_unrecorded(self, completed: CompletedCommand[C, D]) -> None:
        """Answer a command without a row, since it changes nothing that a later decision could rest on."""
        verdict = self._verdict(completed, completed.decision, completed.reason, self._procedure.joint())
        self._verdict_cache.settle(completed.verdict, verdict)

    def fail_with(self, completed: CompletedCommand[C, D], error: BaseException) -> None:
        """Fail because of a command that the dispatcher could not conclude, and answer it.

        Args:
            completed: The command.
            error: The error of the program or the journal.
        """
        log.error("dispatcher_broken", command=completed.command.id, exc_info=error)
        reason = self._coordinator.fail_for(error)
        decision: Decision = "rejected" if completed.decision == "rejected" else "unknown"
        self._answer(completed, self._verdict(completed, decision, reason, self._procedure.joint()))
        if decision == "rejected":
            self._verdict_cache.forget(completed.command)
        else:
            self.unconfirmed.append(completed)

    def commit_recorded(self, completed: CompletedCommand[C, D], recorded: Verdict) -> None:
        """Commit a command that is durable after all, while nothing else is being journalled; Stop's latch stays.

        Args:
            completed: The command.
            recorded: The verdict that the journal has.

        Raises:
            BlueprintError: The states in memory are not to be trusted.
        """
        self._procedure.commit(recorded.sequence, completed.change, completed.changes, unlatch=False)
        self._procedure.forget_promises()

    def _only_answer(self, completed: CompletedCommand[C, D], reason: Reason) -> None:
        """Reject a command without a row; it is decided again when it is repeated."""
        self._answer(completed, self._verdict(completed, "rejected", reason, self._procedure.joint()))
        self._verdict_cache.forget(completed.command)

    def _limit(self, completed: CompletedCommand[C, D]) -> Reason | None:
        if self._rejections is None or completed.reason is None:
            return None
        return self._rejections.limit(completed.command, completed.reason)

    def _commit(self, completed: CompletedCommand[C, D], verdict: Verdict, durable: asyncio.Future[Any]) -> None:
        try:
            durable.result()
            failpoint("dispatcher.after_outcome")
            if completed.decision != "rejected":
                self._procedure.commit(
                    verdict.sequence, completed.change, completed.changes, unlatch=completed.unlatches
                )
        except (Exception, asyncio.CancelledError) as error:
            self.fail_with(completed, error)
        else:
            self._answer(completed, verdict)

    def _answer(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        failpoint("dispatcher.before_reply")
        self._verdict_cache.settle(completed.verdict, verdict)
        self._coordinator.on_completed(completed, verdict)

    def _verdict(
        self,
        completed: CompletedCommand[C, D],
        decision: Decision,
        reason: Reason | None,
        states: dict[str, str],
        sequence: int | None = None,
    ) -> Verdict:
        command, run = completed.command, completed.run
        state = states.get(command.branch, "")
        if decision == "rejected" and reason is not None:
            reason = clipped_reason(reason)
        return Verdict(
            id=command.id,
            branch=command.branch,
            operation=command.operation,
            decision=decision,
            state=state,
            reason=reason,
            allowed=self._procedure.allowed(command.branch, states) if state else [],
            result=run.result if run is not None and run.result else None,
            sequence=self._procedure.sequence if sequence is None else sequence,
        )


def reason_for(error: BaseException) -> Reason:
    """Return why nothing is accepted any more after `error`."""
    code = error.code if isinstance(error, PcmrsError) else "internal_error"
    hint = "If it does not resume by itself when the journal can be written again: " if code == JOURNAL else ""
    return Reason(code=code, text=f"The dispatcher has stopped for safety: {error} {hint}Restart the daemon.")
