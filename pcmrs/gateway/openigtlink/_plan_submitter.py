"""Commands of one peer: its plans, one after the other, and Stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.commands import PlanKind
from pcmrs.gateway.handlers import PlanLock
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.messages import Command, Verdict

OPERATIONS = {PlanKind.POSE: ("toolplan", "plan"), PlanKind.LANDMARKS: ("registration", "plan_landmarks")}

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Answer:
    """Outcome of a command; `code` and `text` say why it was not accepted."""

    decision: str
    operation: str
    code: str = ""
    text: str = ""

    @property
    def line(self) -> str:
        """Return one line of text for people."""
        head = f"{self.decision} {self.operation}"
        return f"{head} {self.code}: {self.text}" if self.code else head


@dataclass(frozen=True, slots=True)
class Attempt:
    """Plan to be submitted; `number` is its number in the plan lock."""

    number: int
    arguments: Callable[[], dict[str, Any]]


class PlanSubmitter:
    """Submits plans and Stop for one peer. It has no motions, but its plans lock the approaches of its host.

    While a plan is being decided, the newest of each kind waits; earlier ones are superseded and never submitted.

    Args:
        source: Source of the peer's commands in the journal.
        core: The daemon.
        lock: Plan lock of the peer's host.
        tasks: Owner of its tasks.
        answer: Called with the outcome of each command.
        refusals: Log of commands that are refused before they get to the daemon.
    """

    def __init__(
        self,
        source: str,
        core: Core,
        lock: PlanLock,
        tasks: BackgroundTasks,
        answer: Callable[[Answer], None],
        refusals: RejectionLog,
    ) -> None:
        self._source = source
        self._core = core
        self._lock = lock
        self._tasks = tasks
        self._answer = answer
        self._refusals = refusals
        self._waiting: dict[PlanKind, Attempt] = {}
        self._working = False

    def plan(self, kind: PlanKind, arguments: Callable[[], dict[str, Any]]) -> None:
        """Begin a plan; never waits.

        Args:
            kind: Kind of the plan.
            arguments: Returns the operation's arguments, or raises `RefusalError`.
        """
        self._waiting[kind] = Attempt(self._lock.attempt(kind), arguments)
        if not self._working:
            self._working = True
            self._tasks.spawn(self._work())

    def stop(self) -> None:
        """Stop everything at once, ahead of all that waits."""
        self._tasks.spawn(self._stop())

    def halt(self) -> None:
        """Reject the plans that wait, because of Stop."""
        for kind in self._waiting:
            self._answer(self._rejected(".".join(OPERATIONS[kind]), "stopped", "Stop came before it was decided."))
        self._waiting.clear()

    async def _work(self) -> None:
        while self._waiting:
            kind = next(iter(self._waiting))
            self._answer(await self._decide(kind, self._waiting.pop(kind)))
        self._working = False

    async def _decide(self, kind: PlanKind, attempt: Attempt) -> Answer:
        """Returns the answer to a plan, however it ends."""
        branch, operation = OPERATIONS[kind]
        name = f"{branch}.{operation}"
        try:
            verdict = await self._core.submit(
                Command(
                    id=uuid4().hex, branch=branch, operation=operation, source=self._source, role="planner",
                    arguments=attempt.arguments(),
                )
            )  # fmt: skip
        except RefusalError as refusal:
            return self._rejected(name, refusal.refusal_code, refusal.text)
        except PcmrsError as error:
            return Answer("failed", name, error.code, error.text)
        except Exception:
            log.exception("plan_broke", operation=name)
            return Answer("failed", name, "internal_error", "The daemon's log has the details.")
        if verdict.decision == "accepted":
            self._lock.accept(kind, attempt.number)
        return _answer_of(verdict)

    def _rejected(self, name: str, reason: str, text: str) -> Answer:
        self._refusals.add(self._source, reason, f"{name} was refused: {text}")
        return Answer("rejected", name, reason, text)

    async def _stop(self) -> None:
        stands = await self._core.stop(self._source)
        text = "The robot has not confirmed that it stands."
        self._answer(Answer("accepted", "stop") if stands else Answer("failed", "stop", "hold_not_confirmed", text))


def _answer_of(verdict: Verdict) -> Answer:
    name = f"{verdict.branch}.{verdict.operation}"
    if verdict.decision == "accepted":
        return Answer("accepted", name)
    if verdict.reason is None:
        return Answer(verdict.decision, name, verdict.decision)
    return Answer(verdict.decision, name, verdict.reason.code, verdict.reason.text)
