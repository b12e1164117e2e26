"""Outcomes that nobody knows, until an operator has settled them."""

from __future__ import annotations

from collections.abc import Iterable

from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import OperationSpec
from pcmrs.messages import Command, UnknownOutcome, Verdict


class Unsettled:
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
