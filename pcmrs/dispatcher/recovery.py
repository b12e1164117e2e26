"""What is unknown after a failure, and how the dispatcher goes on when the journal can be written again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Container, Iterable
from typing import Generic

from pcmrs.dispatcher.activities import Activities
from pcmrs.dispatcher.decisions import JOURNAL, CompletedCommand, Decisions
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.run import C, D
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.fsm import Blueprint, Closure
from pcmrs.fsm.blueprint import OperationSpec
from pcmrs.messages import Command, Reason, UnknownOutcome, Verdict


class PendingOutcomes:
    """What has ended `unknown` and has not been settled since.

    A motion is settled by an operation of its branch that looks: accepted, and with steps of its own, such as
    `placement.locate`. Everything else is settled by an operation that acknowledges a Stop; where it does not act on
    the patient, also by an operation of its branch, as a connection is by connecting.

    Of several unknown outcomes of one operation the newest is kept: the operator has to look once.

    Args:
        blueprint: The workflow.
        earlier: What is unsettled already.
    """

    def __init__(self, blueprint: Blueprint, earlier: Iterable[UnknownOutcome] = ()) -> None:
        self._blueprint = blueprint
        self._outcomes = {(each.branch, each.operation): each for each in earlier}

    def shown(self) -> list[UnknownOutcome]:
        """All of them, in the order in which they came."""
        return list(self._outcomes.values())

    def add(self, outcome: UnknownOutcome) -> None:
        """One more."""
        self._outcomes.pop((outcome.branch, outcome.operation), None)
        self._outcomes[outcome.branch, outcome.operation] = outcome

    def follow(self, command: Command, verdict: Verdict, now: float) -> None:
        """A verdict has been given at `now`, Unix s: adds what is unknown, drops what an accepted operation settles."""
        if verdict.decision == "accepted":
            self.settle_by(command.branch, command.operation)
        elif verdict.decision == "unknown":
            self.add(
                UnknownOutcome(
                    command=command.id,
                    source=command.source,
                    branch=command.branch,
                    operation=command.operation,
                    since=now,
                )
            )

    def withdraw(self, source: str, command: str) -> None:
        """The outcome of a command has become known."""
        self._outcomes = {
            key: each for key, each in self._outcomes.items() if (each.source, each.command) != (source, command)
        }

    def settle_by(self, branch: str, operation: str) -> None:
        """An operation has been accepted: drops what that settles."""
        by = self._blueprint.find(branch, operation)
        if by is not None:
            self._outcomes = {key: each for key, each in self._outcomes.items() if not self._settles(branch, by, each)}

    def _settles(self, branch: str, by: OperationSpec, outcome: UnknownOutcome) -> bool:
        looks = branch == outcome.branch and bool(by.steps)
        of = self._blueprint.find(outcome.branch, outcome.operation)
        if of is not None and of.moves:
            return looks
        return by.unlatches or (looks and not (of is not None and of.affects_patient))


LOST = Reason(code=JOURNAL, text="The journal failed while it ran; nobody knows how it ended.")


class Reconciliation(Generic[C, D]):
    """Used while nothing runs and nothing is accepted.

    Args:
        procedure: Where is committed what the disk has.
        verdict_cache: Gets the verdicts that count.
        decisions: Has what is doubtful.
        outcomes: Drops what has become known.
        activities: Follow the commits.
    """

    def __init__(
        self,
        procedure: Procedure[C, D],
        verdict_cache: VerdictCache,
        decisions: Decisions[C, D],
        outcomes: PendingOutcomes,
        activities: Activities[C, D],
    ) -> None:
        self._procedure = procedure
        self._verdict_cache = verdict_cache
        self._decisions = decisions
        self._outcomes = outcomes
        self._activities = activities

    async def of_all(self, begun: Container[tuple[str, str]]) -> AsyncIterator[Verdict]:
        """Settles one after the other what is doubtful, and yields the verdicts that count instead.

        Args:
            begun: Source and id of the commands of which the journal has the intent and no outcome.

        Raises:
            JournalError: The journal cannot be read or written; what is left stays doubtful.
        """
        self._procedure.forget_promises()
        waiting, self._decisions.unconfirmed = self._decisions.unconfirmed, []
        try:
            while waiting:
                verdict = await self._of(waiting[0], begun)
                waiting.pop(0)
                if verdict is not None:
                    yield verdict
        finally:
            self._decisions.unconfirmed[:0] = waiting

    async def _of(self, completed: CompletedCommand[C, D], begun: Container[tuple[str, str]]) -> Verdict | None:
        command = completed.command
        self._verdict_cache.forget(command)
        verdict, is_new = self._verdict_cache.verdict_of(command)
        if not is_new:
            return self._take_recorded(completed, verdict.result())
        if (command.source, command.id) not in begun:  # then no step was taken, or they touched nothing outside
            self._verdict_cache.forget(command)
            self._outcomes.withdraw(command.source, command.id)
            return None
        self._decisions.conclude(self._unknown(command, verdict))
        return await asyncio.shield(verdict)  # others may wait for it when the resume is cancelled

    def _take_recorded(self, completed: CompletedCommand[C, D], recorded: Verdict) -> Verdict:
        command = completed.command
        self._decisions.commit_recorded(completed, recorded)
        self._activities.follow(command)
        if recorded.decision != "unknown":
            self._outcomes.withdraw(command.source, command.id)
        if recorded.decision == "accepted":
            self._outcomes.settle_by(command.branch, command.operation)
        return recorded

    def _unknown(self, command: Command, verdict: asyncio.Future[Verdict]) -> CompletedCommand[C, D]:
        """With the state that its operation declares for what nobody knows."""
        closure = self._procedure.ask(command.branch, command.operation)
        change = closure.unknown if isinstance(closure, Closure) else None
        return CompletedCommand(command, verdict, "unknown", LOST, change=change)
