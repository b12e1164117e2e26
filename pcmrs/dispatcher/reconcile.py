"""Makes true what the disk says of the commands that were being journalled when the journal failed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Container
from typing import Generic

from pcmrs.dispatcher.activities import Activities
from pcmrs.dispatcher.decisions import JOURNAL, Conclusion, Decisions
from pcmrs.dispatcher.memory import Memory
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.run import C, D
from pcmrs.dispatcher.unsettled import Unsettled
from pcmrs.fsm import Closure
from pcmrs.messages import Command, Reason, Verdict

LOST = Reason(code=JOURNAL, text="The journal failed while it ran; nobody knows how it ended.")


class Reconciliation(Generic[C, D]):
    """Used while nothing runs and nothing is accepted.

    Args:
        procedure: Where is committed what the disk has.
        memory: Gets the verdicts that count.
        decisions: Has what is doubtful.
        unsettled: Drops what has become known.
        activities: Follow the commits.
    """

    def __init__(
        self,
        procedure: Procedure[C, D],
        memory: Memory,
        decisions: Decisions[C, D],
        unsettled: Unsettled,
        activities: Activities[C, D],
    ) -> None:
        self._procedure = procedure
        self._memory = memory
        self._decisions = decisions
        self._unsettled = unsettled
        self._activities = activities

    async def of_all(self, begun: Container[tuple[str, str]]) -> AsyncIterator[Verdict]:
        """Settles one after the other what is doubtful, and yields the verdicts that count instead.

        Args:
            begun: Source and id of the commands of which the journal has the intent and no outcome.

        Raises:
            JournalError: The journal cannot be read or written; what is left stays doubtful.
        """
        self._procedure.forget_promises()
        waiting, self._decisions.doubtful = self._decisions.doubtful, []
        try:
            while waiting:
                verdict = await self._of(waiting[0], begun)
                waiting.pop(0)
                if verdict is not None:
                    yield verdict
        finally:
            self._decisions.doubtful[:0] = waiting

    async def _of(self, conclusion: Conclusion[C, D], begun: Container[tuple[str, str]]) -> Verdict | None:
        command = conclusion.command
        self._memory.forget(command)
        verdict, is_new = self._memory.verdict_of(command)
        if not is_new:
            return self._take_recorded(conclusion, verdict.result())
        if (command.source, command.id) not in begun:  # then no step was taken, or they touched nothing outside
            self._memory.forget(command)
            self._unsettled.withdraw(command.source, command.id)
            return None
        self._decisions.conclude(self._unknown(command, verdict))
        return await asyncio.shield(verdict)  # others may wait for it when the resume is cancelled

    def _take_recorded(self, conclusion: Conclusion[C, D], recorded: Verdict) -> Verdict:
        command = conclusion.command
        self._decisions.commit_recorded(conclusion, recorded)
        self._activities.follow(command)
        if recorded.decision != "unknown":
            self._unsettled.withdraw(command.source, command.id)
        if recorded.decision == "accepted":
            self._unsettled.settle_by(command.branch, command.operation)
        return recorded

    def _unknown(self, command: Command, verdict: asyncio.Future[Verdict]) -> Conclusion[C, D]:
        """With the state that its operation declares for what nobody knows."""
        closure = self._procedure.ask(command.branch, command.operation)
        change = closure.unknown if isinstance(closure, Closure) else None
        return Conclusion(command, verdict, "unknown", LOST, change=change)
