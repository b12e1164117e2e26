"""Locks of branches: which commands run, which wait, and which are rejected."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pcmrs.fsm import Blueprint, Closure, Denial, OperationSpec
from pcmrs.messages import Command, Reason, Running, TouchPrompt, Verdict


@dataclass(frozen=True, slots=True)
class Locks:
    """Branches that an operation may change, and branches that must not change while it runs."""

    writes: frozenset[str]
    reads: frozenset[str]

    def conflicts(self, other: Locks) -> bool:
        """Return whether the two cannot be held together."""
        return bool(self.writes & (other.writes | other.reads) or self.reads & other.writes)


@dataclass(eq=False)
class PendingCommand:
    """A command from its admission to its verdict.

    Attributes:
        arrived: Time of its arrival, s of the event loop's clock.
        side_effecting: Its steps act on the world.
        since: Number of the newest commit that its checks and steps have seen.
        started: Its steps have started, so that cancelling its task reaches them.
        ending: Its steps have ended and it is being committed: too late to stop.
        committing: It waits for its commit only.
        stopped: Why it was stopped by Stop or a danger event.
        planning: The planner's answer that its checks wait for; None if they do not wait.
        patience: Timer that ends its wait, if that is limited.
    """

    command: Command
    spec: OperationSpec
    payload: Any
    verdict: asyncio.Future[Verdict]
    locks: Locks
    arrived: float
    side_effecting: bool
    since: int = 0
    task: asyncio.Task[None] | None = None
    progress: float = 0.0
    prompt: TouchPrompt | None = None
    started: bool = False
    ending: bool = False
    committing: bool = False
    stopped: Reason | None = None
    planning: asyncio.Future[Reason | None] | None = None
    wait_timer: asyncio.TimerHandle | None = None

    @property
    def moves(self) -> bool:
        """True if it moves the robot."""
        return self.spec.moves

    @property
    def acts(self) -> bool:
        """True if it moves the robot or acts on the patient otherwise."""
        return self.spec.moves or self.spec.affects_patient

    @property
    def name(self) -> str:
        """Branch and operation, as users write it."""
        return f"{self.command.branch}.{self.command.operation}"

    @property
    def shown(self) -> Running:
        """The command as the snapshot shows it."""
        command = self.command
        return Running(
            branch=command.branch,
            operation=command.operation,
            id=command.id,
            progress=self.progress,
            prompt=self.prompt,
        )

    def replaces(self, other: PendingCommand) -> bool:
        """Return whether both report the same event: the newer report contains the older one."""
        mine, theirs = self.command, other.command
        return self.spec.event and (mine.source, self.name, mine.arguments) == (
            theirs.source,
            other.name,
            theirs.arguments,
        )

    def end_wait(self) -> None:
        """Cancel the timer of its wait: it starts, or is rejected."""
        if self.wait_timer is not None:
            self.wait_timer.cancel()

    def stop(self, reason: Reason) -> None:
        """Cancel its planning or its steps; harmless once they have ended."""
        if self.stopped is not None:
            return
        self.stopped = reason
        if self.planning is not None:
            self.planning.cancel()
        if self.started and not self.ending and self.task is not None:
            self.task.cancel()

    def end_steps(self) -> None:
        """Mark its steps as ended: its commit is not cancelled, nor mistaken for cancelled by a timeout."""
        self.ending = True
        if self.task is not None and self.task.cancelling():
            self.task.uncancel()


def locks_for(blueprint: Blueprint, command: Command, answer: Closure | Denial) -> Locks:
    """Return the locks of an allowed command; of a denied one, the branches that might change the answer.

    Args:
        blueprint: The workflow.
        command: The command.
        answer: Answer of the states to it.
    """
    if isinstance(answer, Closure):
        return Locks(answer.writes, answer.reads)
    examined = {command.branch}
    parent = blueprint.branches[command.branch].parent
    while parent is not None:
        examined.add(parent.branch)
        parent = blueprint.branches[parent.branch].parent
    spec = blueprint.branches[command.branch].operations[command.operation]
    return Locks(frozenset(examined), frozenset(spec.requires) - examined)


MAX_WAITING = 32
"""Limit of commands that wait for locks; one more is rejected. Events are not counted: each waits once at most."""


class LockManager:
    """Grant all locks of a command at once, in order of arrival; events go ahead of commands.

    Args:
        revokers: Branches whose change revokes a plan.

    Attributes:
        running: Commands that hold their locks.
        waiting: Commands that are admitted again when others end, in order of arrival.
    """

    def __init__(self, revokers: frozenset[str]) -> None:
        self.running: list[PendingCommand] = []
        self.waiting: list[PendingCommand] = []
        self._revokers = revokers

    @property
    def moving(self) -> bool:
        """True while a motion runs or waits."""
        return any(pending.moves for pending in (*self.running, *self.waiting))

    def blocked(self, pending: PendingCommand) -> bool:
        """Return whether it conflicts with a running command, or with a waiting one that goes ahead of it."""
        return any(self._conflicting_with(pending))

    def why_not_wait(self, pending: PendingCommand) -> Reason | None:
        """Return why a blocked command is rejected; None if it waits, as events always do.

        No command that moves or acts on the patient waits, nor does a plan change while something moves. Only a motion
        may wait for events without side effects: they end as soon as the disk has them.
        """
        if pending.spec.event or (pending.moves and self._may_wait(pending)):
            return None
        changes_plan = pending.locks.writes & self._revokers
        if pending.spec.blocked_when_latched or (changes_plan and self.moving):
            return self.busy(pending)
        if sum(not other.spec.event for other in self.waiting) >= MAX_WAITING:
            text = f"{MAX_WAITING} commands wait already, which is the limit: ask again later."
            return Reason(code="queue_full", text=text, fields={"limit": MAX_WAITING})
        return None

    def busy(self, pending: PendingCommand) -> Reason:
        """Return the reason that a command does not wait for the others."""
        busy = [other.name for other in self.running]
        text = f"{pending.name} does not wait for {' and '.join(busy) or 'others'}: ask again when it has ended."
        return Reason(code="busy", text=text, fields={"running": busy})

    def wait(self, pending: PendingCommand) -> PendingCommand | None:
        """Queue a command; return the waiting report of the same event that it replaces, if any: the newest counts."""
        replaced = next((other for other in self.waiting if pending.replaces(other)), None)
        if replaced is not None:
            self.waiting.remove(replaced)
        self.waiting.append(pending)
        return replaced

    def take_waiting(self) -> list[PendingCommand]:
        """Empty the queue and return its commands, events first."""
        waiting, self.waiting = self.waiting, []
        return sorted(waiting, key=lambda pending: not pending.spec.event)

    def withdraw(self, verdict: asyncio.Future[Verdict]) -> PendingCommand | None:
        """Take the command with this verdict out of the queue and return it; None if it does not wait."""
        found = next((pending for pending in self.waiting if pending.verdict is verdict), None)
        if found is not None:
            self.waiting.remove(found)
        return found

    def drain_commands(self) -> list[PendingCommand]:
        """Take all commands but events out of the queue and return them; events report what has happened already."""
        taken = [pending for pending in self.waiting if not pending.spec.event]
        self.waiting = [pending for pending in self.waiting if pending.spec.event]
        return taken

    def _may_wait(self, motion: PendingCommand) -> bool:
        if any(other.moves for other in self.waiting):
            return False
        return all(other.spec.event and not other.side_effecting for other in self._conflicting_with(motion))

    def _conflicting_with(self, pending: PendingCommand) -> Iterable[PendingCommand]:
        ahead = (other for other in self.waiting if other.spec.event or not pending.spec.event)
        return (other for other in (*self.running, *ahead) if pending.locks.conflicts(other.locks))
