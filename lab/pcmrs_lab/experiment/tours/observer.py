"""What a running cell shows by itself, kept for whoever has to compare it with what was asked."""

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

KEPT = 200
"""Snapshots and verdicts that are remembered."""

POLLING = 0.005


class Observer:
    """Remembers snapshots and verdicts. Use `observing`.

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
        """The joint state that a decision led to, where it was shown."""
        shown = self._snapshots.get(verdict.sequence)
        return None if shown is None else tuple(shown.branches.values())

    def has(self, verdict: Verdict) -> bool:
        """Whether a verdict has been shown, and with it all before it."""
        return verdict.id in self._verdicts

    def verdicts_beside(self, known: Container[str]) -> list[Verdict]:
        """Verdicts on commands that are not among the known ones, in order."""
        return [verdict for command_id, verdict in self._verdicts.items() if command_id not in known]

    async def shows(self, condition: Callable[[], bool]) -> None:
        """Returns when a condition on what has been shown holds."""
        await self._until(lambda: condition() or None)

    async def begun(self, command_id: str) -> None:
        """Returns when a command is shown as running."""
        await self.shows(lambda: command_id in self._running)

    async def verdict_on(self, branch: str, operation: str, known: Container[str]) -> Verdict:
        """The next verdict on an operation whose id is not among the known ones."""

        def found() -> Verdict | None:
            new = self.verdicts_beside(known)
            return next((v for v in new if (v.branch, v.operation) == (branch, operation)), None)

        return await self._until(found)

    async def settled(self, sequence: int = 0) -> Snapshot:
        """The state once nothing runs and everything up to it has been shown."""
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
        """Takes what is shown; never ends."""
        async with aclosing(self._client.watch()) as events:
            async for event in events:
                if isinstance(event, Snapshot):
                    self._take_snapshot(event)
                elif isinstance(event, Verdict):
                    _remember(self._verdicts, event.id, event)
                async with self._changed:
                    self._changed.notify_all()

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        self._running = {running.id for running in snapshot.running}
        self.ran |= {f"{running.branch}.{running.operation}" for running in snapshot.running}
        _remember(self._snapshots, snapshot.sequence, snapshot)


K = TypeVar("K")


def _remember(kept: OrderedDict[K, T], key: K, value: T) -> None:
    kept[key] = value
    if len(kept) > KEPT:
        kept.popitem(last=False)


@asynccontextmanager
async def observing(client: Client) -> AsyncIterator[Observer]:
    """Listens to a cell for the length of the context."""
    observer = Observer(client)
    async with background_task(observer.listen()):
        yield observer
