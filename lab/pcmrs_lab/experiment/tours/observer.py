"""Stores what a running cell publishes, so that it can be compared with the commands."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Container
from contextlib import aclosing, asynccontextmanager, suppress
from typing import TypeVar

from pcmrs.background import background_task
from pcmrs.client import Client
from pcmrs.messages import Snapshot, Verdict

T = TypeVar("T")

HISTORY = 200
"""Number of snapshots and verdicts that are stored."""

POLLING = 0.005


class Observer:
    """Store of snapshots and verdicts. Use `observing`.

    Attributes:
        ran: Every ``branch.operation`` that was ever shown as running.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._snapshots: OrderedDict[int, Snapshot] = OrderedDict()
        self._verdicts: OrderedDict[str, Verdict] = OrderedDict()
        self._running: set[str] = set()
        self._changed = asyncio.Condition()
        self.ran: set[str] = set()

    def joint_at(self, verdict: Verdict) -> tuple[str, ...] | None:
        """Return the joint state that a decision led to; None if it was not published."""
        shown = self._snapshots.get(verdict.sequence)
        return None if shown is None else tuple(shown.branches.values())

    def has(self, verdict: Verdict) -> bool:
        """Return whether a verdict, and with it all earlier ones, has been published."""
        return verdict.id in self._verdicts

    def verdicts_beside(self, known: Container[str]) -> list[Verdict]:
        """Return the verdicts on commands that are not among the known ones, in order."""
        return [verdict for command_id, verdict in self._verdicts.items() if command_id not in known]

    async def shows(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition on the published messages holds."""
        await self._until(lambda: condition() or None)

    async def running(self, command_id: str) -> None:
        """Wait until a command is shown as running."""
        await self.shows(lambda: command_id in self._running)

    async def verdict_on(self, branch: str, operation: str, known: Container[str]) -> Verdict:
        """Wait for a verdict on an operation whose id is not among the known ones, and return it.

        Args:
            branch: Branch of the operation.
            operation: Operation.
            known: Ids of known verdicts.
        """

        def found() -> Verdict | None:
            new = self.verdicts_beside(known)
            return next((v for v in new if (v.branch, v.operation) == (branch, operation)), None)

        return await self._until(found)

    async def settled(self, sequence: int = 0) -> Snapshot:
        """Wait until nothing runs and all messages up to a commit are published, and return the state.

        Args:
            sequence: Number of the commit.
        """
        while True:
            state = await self._client.state(timeout=10.0)
            if not state.running and state.sequence >= sequence:
                break
            await asyncio.sleep(POLLING)
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await self.shows(lambda: max(self._snapshots, default=0) >= state.sequence)
        return state

    async def _until(self, found: Callable[[], T | None]) -> T:
        async with self._changed:
            while True:
                result = found()
                if result is not None:
                    return result
                await self._changed.wait()

    async def listen(self) -> None:
        """Store the published messages; never return."""
        async with aclosing(self._client.watch()) as events:
            async for event in events:
                if isinstance(event, Snapshot):
                    self._take_snapshot(event)
                elif isinstance(event, Verdict):
                    _store(self._verdicts, event.id, event)
                async with self._changed:
                    self._changed.notify_all()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        self._running = {running.id for running in snapshot.running}
        self.ran |= {f"{running.branch}.{running.operation}" for running in snapshot.running}
        _store(self._snapshots, snapshot.sequence, snapshot)


K = TypeVar("K")


def _store(stored: OrderedDict[K, T], key: K, value: T) -> None:
    stored[key] = value
    if len(stored) > HISTORY:
        stored.popitem(last=False)


@asynccontextmanager
async def observing(client: Client) -> AsyncIterator[Observer]:
    """Listen to a cell for the length of the context."""
    observer = Observer(client)
    async with background_task(observer.listen()):
        yield observer
