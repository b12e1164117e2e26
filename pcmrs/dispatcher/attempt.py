"""A command on its way through the dispatcher, and when two of them are in each other's way."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from pcmrs.fsm import Blueprint, Closure, Denial, OperationSpec
from pcmrs.messages import Command, Reason, Running, Verdict


@dataclass(frozen=True, slots=True)
class Locks:
    """Branches an operation may change, and branches that must not change under it."""

    writes: frozenset[str]
    reads: frozenset[str]

    def conflicts(self, other: Locks) -> bool:
        """Whether the two cannot be held together."""
        return bool(self.writes & (other.writes | other.reads) or self.reads & other.writes)


@dataclass(eq=False)
class Attempt:
    """One accepted-for-consideration command until its verdict.

    Attributes:
        arrived: When it arrived, s of the event loop's clock.
        worldly: It takes steps in the world.
        since: Number of the newest commit that its checks and steps have seen.
        begun: Its steps have begun, so that cancelling its task reaches them.
        ending: Its steps have ended and it is being committed: too late to stop.
        committing: It waits for nothing but its commit.
        stopped: Why it was stopped by Stop or a danger event.
        planning: What its checks wait for, where a planner asks them.
        patience: Ends its wait, where that is limited.
    """

    command: Command
    spec: OperationSpec
    payload: Any
    verdict: asyncio.Future[Verdict]
    locks: Locks
    arrived: float
    worldly: bool
    since: int = 0
    task: asyncio.Task[None] | None = None
    progress: float = 0.0
    begun: bool = False
    ending: bool = False
    committing: bool = False
    stopped: Reason | None = None
    planning: asyncio.Future[Reason | None] | None = None
    patience: asyncio.TimerHandle | None = None

    @property
    def moves(self) -> bool:
        """Whether it moves the robot."""
        return self.spec.moves

    @property
    def acts(self) -> bool:
        """Whether it moves the robot or acts on the patient otherwise."""
        return self.spec.moves or self.spec.affects_patient

    @property
    def name(self) -> str:
        """Branch and operation, as users write it."""
        return f"{self.command.branch}.{self.command.operation}"

    @property
    def shown(self) -> Running:
        """What the snapshot shows of it."""
        command = self.command
        return Running(branch=command.branch, operation=command.operation, id=command.id, progress=self.progress)

    def replaces(self, other: Attempt) -> bool:
        """Whether both report the same event: the newer one says all that the other does."""
        mine, theirs = self.command, other.command
        return self.spec.event and (mine.source, self.name, mine.arguments) == (
            theirs.source,
            other.name,
            theirs.arguments,
        )

    def end_wait(self) -> None:
        """It waits no longer: it starts, or is turned away."""
        if self.patience is not None:
            self.patience.cancel()

    def stop(self, reason: Reason) -> None:
        """Cancels its planning or its steps; harmless once they have ended."""
        if self.stopped is not None:
            return
        self.stopped = reason
        if self.planning is not None:
            self.planning.cancel()
        if self.begun and not self.ending and self.task is not None:
            self.task.cancel()

    def end_steps(self) -> None:
        """Its steps have ended: what follows is not cancelled, nor mistaken for cancelled by a timeout."""
        self.ending = True
        if self.task is not None and self.task.cancelling():
            self.task.uncancel()


def locks_for(blueprint: Blueprint, command: Command, answer: Closure | Denial) -> Locks:
    """Locks of an allowed command; of a denied one, the branches that might change the answer."""
    if isinstance(answer, Closure):
        return Locks(answer.writes, answer.reads)
    examined = {command.branch}
    parent = blueprint.branches[command.branch].parent
    while parent is not None:
        examined.add(parent.branch)
        parent = blueprint.branches[parent.branch].parent
    spec = blueprint.branches[command.branch].operations[command.operation]
    return Locks(frozenset(examined), frozenset(spec.requires) - examined)
