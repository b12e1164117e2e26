"""What a cell publishes during a tour is kept in its order, and waited for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import cast

import msgspec

from pcmrs.client import Client, Event
from pcmrs.messages import Running, Snapshot
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.experiment.tours.observer import HISTORY, Observer, observing
from tests.unit.lab.scripted_client import snapshot, verdict


class PublishingCell:
    """A cell that publishes what a test puts into its queue, and whose present state is `now`."""

    def __init__(self) -> None:
        self.now = snapshot(placement="retracted", sequence=1)
        self.published: asyncio.Queue[Event] = asyncio.Queue()

    async def state(self, timeout: float) -> Snapshot:
        return self.now

    async def watch(self) -> AsyncGenerator[Event, None]:
        while True:
            yield await self.published.get()

    def running(self, *names: str) -> Snapshot:
        parts = [name.split(".") for name in names]
        running = [Running(branch=branch, operation=operation, id=f"id-{operation}") for branch, operation in parts]
        return msgspec.structs.replace(self.now, running=running)

    async def publish(self, *events: Event) -> None:
        for event in events:
            self.published.put_nowait(event)
        for _ in range(5 * len(events)):
            await asyncio.sleep(0)


def client(cell: PublishingCell) -> Client:
    return cast(Client, cell)


async def test_verdicts_are_in_order_and_known_ones_are_left_out() -> None:
    cell = PublishingCell()
    first, second = verdict("robot.connect", id="a"), verdict("placement.home", id="b", sequence=2)
    async with observing(client(cell)) as observer:
        await cell.publish(first, second)
        assert observer.verdicts_beside(()) == [first, second]
        assert observer.verdicts_beside({"a"}) == [second]
        assert (observer.has(second), observer.has(verdict(id="c"))) == (True, False)


async def test_the_joint_state_is_that_of_the_commit() -> None:
    cell = PublishingCell()
    async with observing(client(cell)) as observer:
        await cell.publish(snapshot(placement="standoff", sequence=2), snapshot(placement="placed", sequence=3))
        assert observer.joint_at(verdict(sequence=2)) == ("standoff",)
        assert observer.joint_at(verdict(sequence=9)) is None, "it was overtaken, or not published yet"


async def test_operations_that_have_ended_were_still_seen_running() -> None:
    cell = PublishingCell()
    async with observing(client(cell)) as observer:
        await cell.publish(cell.running("placement.approach"))
        await observer.running("id-approach")
        await cell.publish(cell.now)
        waiting = asyncio.create_task(observer.running("id-approach"))
        await asyncio.sleep(0)
        assert not waiting.done()
        waiting.cancel()
        assert observer.ran == {"placement.approach"}


async def test_a_verdict_is_waited_for_that_is_not_known_yet() -> None:
    cell = PublishingCell()
    known, new = verdict("robot.link_lost", id="a"), verdict("robot.link_lost", id="b")
    async with observing(client(cell)) as observer:
        waiting = asyncio.create_task(observer.verdict_on("robot", "link_lost", {"a"}))
        await cell.publish(known, verdict("robot.connect", id="c"))
        assert not waiting.done()
        await cell.publish(new)
        assert await waiting == new


def test_cell_is_settled_when_nothing_runs_and_all_is_published() -> None:
    async def settle() -> tuple[Snapshot, float]:
        cell, loop = PublishingCell(), asyncio.get_running_loop()
        done = msgspec.structs.replace(cell.now, sequence=7)
        cell.now = cell.running("placement.approach")
        loop.call_later(0.5, setattr, cell, "now", done)
        loop.call_later(0.8, cell.published.put_nowait, done)
        async with observing(client(cell)) as observer:
            return await observer.settled(7), loop.time()

    state, time = run_on_simulated_loop(settle())
    assert (state.sequence, state.running) == (7, [])
    assert time == 0.8


def test_state_never_published_is_taken_as_it_was_answered() -> None:
    async def settle() -> int:
        cell = PublishingCell()
        async with observing(client(cell)) as observer:
            return (await observer.settled()).sequence

    assert run_on_simulated_loop(settle()) == 1


async def test_only_the_newest_messages_are_kept() -> None:
    cell = PublishingCell()
    observer = Observer(client(cell))
    listening = asyncio.create_task(observer.listen())
    await cell.publish(*(verdict(id=str(number)) for number in range(HISTORY + 5)))
    assert [each.id for each in observer.verdicts_beside(())][:1] == ["5"]
    listening.cancel()
    await asyncio.gather(listening, return_exceptions=True)
