"""From how a command ended to its verdict: journalled, committed, answered, then published.

The journal takes a limited number of rejections of each user. A rejection beyond the limit is answered like any other,
but leaves no row: one row says how many there were. Accepted commands are not counted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic

import structlog

from pcmrs.bucket import TokenBucket
from pcmrs.clock import Clock
from pcmrs.dispatcher.admission import is_event
from pcmrs.dispatcher.locks import Attempt
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.recorder import Recorder
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.dispatcher.verdict_cache import Memory
from pcmrs.errors import JournalError, PcmrsError
from pcmrs.failpoints import failpoint
from pcmrs.fsm import Change
from pcmrs.messages import Command, Decision, DeviceEvent, Reason, Verdict
from pcmrs.messages.identity import PEOPLE

RATE_HZ: Final = 10.0
"""Rejections of one user per second that get a row each, in the long run."""
BURST: Final = 1000
"""Rejections of one user that get a row at once."""
USERS: Final = 16
"""Users with a limit of their own; the others share one."""
OTHERS: Final = "others"
PERIOD: Final = 10.0
"""Rejections without a row are counted in one after so long, s."""
TOO_MANY: Final = "too_many_rejections"
DROPPED: Final = "rejections_dropped"


class Rejections:
    """Decides which rejections get a row.

    Args:
        clock: The machine's.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._buckets: dict[str, TokenBucket] = {}
        self._dropped: dict[str, int] = {}
        self._tell: Callable[[DeviceEvent], object] | None = None
        self._timer: asyncio.TimerHandle | None = None

    def on_dropped(self, tell: Callable[[DeviceEvent], object]) -> None:
        """Has `tell` called with the number of rejections without a row, once in `PERIOD` while there are any."""
        self._tell = tell

    def limit(self, command: Command, reason: Reason) -> Reason | None:
        """Why a rejection for `reason` gets no row; None where it gets one."""
        if command.role not in PEOPLE:
            return None
        known = command.user in self._buckets or len(self._buckets) < USERS
        name = command.user if known else OTHERS
        bucket = self._buckets.setdefault(name, TokenBucket(RATE_HZ, BURST, self._clock))
        if bucket.take():
            return None
        self._dropped[name] = self._dropped.get(name, 0) + 1
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(PERIOD, self.tell)
        wait = bucket.wait
        text = f"{reason.text} Commands of {command.user} were rejected more often than {RATE_HZ:g} times per second, "
        text += f"so this rejection is only counted: correct the command, and ask again in {wait:.1f} s."
        fields = {"rejected_for": reason.code, "limit_hz": RATE_HZ, "retry_after": wait}
        return Reason(code=TOO_MANY, text=text, fields=fields)

    def tell(self) -> None:
        """Tells of what has got no row since the last time."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        dropped, self._dropped = self._dropped, {}
        for user, count in dropped.items():
            text = f"{count} rejections of commands of {user} have no row: more than {RATE_HZ:g} per second."
            fields = {"user": user, "count": count, "limit_hz": RATE_HZ}
            if self._tell is not None:
                self._tell(DeviceEvent(device="dispatcher", code=DROPPED, text=text, fields=fields))


log = structlog.get_logger(__name__)

JOURNAL = JournalError.code


@dataclass(frozen=True, slots=True)
class Conclusion(Generic[C, D]):
    """How a command ended.

    Attributes:
        attempt: Its attempt; None for a command that never became one.
        run: What its checks and steps left behind; None when there were none.
        change: What is to be committed, if anything.
        with_intent: Its intent is journalled together with the decision.
    """

    command: Command
    verdict: asyncio.Future[Verdict]
    decision: Decision
    reason: Reason | None = None
    attempt: Attempt | None = None
    run: Run[C, D] | None = None
    change: Change | None = None
    with_intent: bool = False

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the procedure's data; only an accepted command has any."""
        return self.run.changes if self.run is not None and self.decision == "accepted" else {}

    @property
    def unlatches(self) -> bool:
        """Whether it releases the latch; a Stop that came while it was journalled is not acknowledged by it."""
        attempt = self.attempt
        accepted = self.decision == "accepted"
        return accepted and attempt is not None and attempt.spec.unlatches and attempt.stopped is None


class Decisions(Generic[C, D]):
    """Makes conclusions durable and true, one after the other.

    Args:
        procedure: Where they are committed.
        recorder: Where they are journalled.
        memory: Where those who asked wait.
        settled: Called with the conclusion and its verdict once the verdict is given.
        broken: Called when a conclusion cannot be journalled or committed; the verdict is already given.
        rejections: Says which rejections get no row; None where all get one.

    Attributes:
        doubtful: Those that could not be brought to their end; only the disk knows whether they are journalled.
    """

    def __init__(
        self,
        procedure: Procedure[C, D],
        recorder: Recorder,
        memory: Memory,
        settled: Callable[[Conclusion[C, D], Verdict], None],
        broken: Callable[[BaseException], Reason],
        rejections: Rejections | None = None,
    ) -> None:
        self._procedure = procedure
        self._recorder = recorder
        self._memory = memory
        self._settled = settled
        self._broken = broken
        self._rejections = rejections
        self.doubtful: list[Conclusion[C, D]] = []

    def conclude(self, conclusion: Conclusion[C, D]) -> None:
        """Journals a decision; as soon as that is durable, it is committed and answered.

        An event that is rejected changes nothing, and what a device has reported has a row of its own: it leaves none.
        """
        procedure, rejected = self._procedure, conclusion.decision == "rejected"
        if rejected and is_event(procedure.blueprint, conclusion.command):
            self._memory.forget(conclusion.command)
            self._answer(conclusion, self._verdict(conclusion, "rejected", conclusion.reason, procedure.joint()))
            return
        limited = self._limit(conclusion) if rejected else None
        if limited is not None:
            self._only_answer(conclusion, limited)
            return
        try:
            sequence = procedure.sequence if rejected else procedure.reserve(conclusion.change)
            states = procedure.joint() | (dict(conclusion.change.states) if conclusion.change is not None else {})
            verdict = self._verdict(conclusion, conclusion.decision, conclusion.reason, states, sequence)
            failpoint("dispatcher.before_outcome")
            written = self._recorder.decision(
                conclusion.command,
                verdict,
                procedure.promised(),
                conclusion.changes,
                with_intent=conclusion.with_intent,
            )
            durable: asyncio.Future[Any] = asyncio.ensure_future(written)
        except Exception as error:
            self.break_off(conclusion, error)
            return
        if durable.done():
            self._commit(conclusion, verdict, durable)
        else:
            durable.add_done_callback(partial(self._commit, conclusion, verdict))

    def answer_unrecorded(self, conclusion: Conclusion[C, D]) -> None:
        """Answers what changes nothing that a later decision could rest on."""
        verdict = self._verdict(conclusion, conclusion.decision, conclusion.reason, self._procedure.joint())
        self._memory.settle(conclusion.verdict, verdict)

    def break_off(self, conclusion: Conclusion[C, D], error: BaseException) -> None:
        """Answers a command that the dispatcher itself could not bring to its end."""
        log.error("dispatcher_broken", command=conclusion.command.id, exc_info=error)
        reason = self._broken(error)
        decision: Decision = "rejected" if conclusion.decision == "rejected" else "unknown"
        self._answer(conclusion, self._verdict(conclusion, decision, reason, self._procedure.joint()))
        if decision == "rejected":
            self._memory.forget(conclusion.command)
        else:
            self.doubtful.append(conclusion)

    def commit_recorded(self, conclusion: Conclusion[C, D], recorded: Verdict) -> None:
        """Commits what is durable after all, while nothing else is being journalled; Stop's latch stays.

        Raises:
            BlueprintError: Memory is not to be trusted.
        """
        self._procedure.commit(recorded.sequence, conclusion.change, conclusion.changes, unlatch=False)
        self._procedure.forget_promises()

    def _only_answer(self, conclusion: Conclusion[C, D], reason: Reason) -> None:
        """Rejects a command without a row; it is decided anew when it is repeated."""
        self._answer(conclusion, self._verdict(conclusion, "rejected", reason, self._procedure.joint()))
        self._memory.forget(conclusion.command)

    def _limit(self, conclusion: Conclusion[C, D]) -> Reason | None:
        if self._rejections is None or conclusion.reason is None:
            return None
        return self._rejections.limit(conclusion.command, conclusion.reason)

    def _commit(self, conclusion: Conclusion[C, D], verdict: Verdict, durable: asyncio.Future[Any]) -> None:
        try:
            durable.result()
            failpoint("dispatcher.after_outcome")
            if conclusion.decision != "rejected":
                self._procedure.commit(
                    verdict.sequence, conclusion.change, conclusion.changes, unlatch=conclusion.unlatches
                )
        except (Exception, asyncio.CancelledError) as error:
            self.break_off(conclusion, error)
        else:
            self._answer(conclusion, verdict)

    def _answer(self, conclusion: Conclusion[C, D], verdict: Verdict) -> None:
        failpoint("dispatcher.before_reply")
        self._memory.settle(conclusion.verdict, verdict)
        self._settled(conclusion, verdict)

    def _verdict(
        self,
        conclusion: Conclusion[C, D],
        decision: Decision,
        reason: Reason | None,
        states: dict[str, str],
        sequence: int | None = None,
    ) -> Verdict:
        command, run = conclusion.command, conclusion.run
        state = states.get(command.branch, "")
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
    """Why nothing is accepted any more after `error`."""
    code = error.code if isinstance(error, PcmrsError) else "internal_error"
    way = "If it does not go on by itself as soon as the journal can be written again: " if code == JOURNAL else ""
    return Reason(code=code, text=f"The dispatcher has stopped for safety: {error} {way}Restart the daemon.")
