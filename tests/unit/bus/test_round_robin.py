"""Requests that only read take turns: a few at a time, whoever asks most."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from pcmrs.bus import Bus, Empty
from pcmrs.bus._round_robin import AT_ONCE, WAITING
from pcmrs.errors import DeviceError
from pcmrs.messages import Message
from tests.unit.bus.bus_cells import open_pair

TIMEOUT = 10.0


class Read(Message, frozen=True):
    """A reply."""

    user: str


class Reading:
    """What stands behind the keys: it answers when it is let."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.at_once = self.most = 0
        self.let = asyncio.Event()

    async def answer(self, key: str, _: Empty) -> Read:
        user = key.rpartition("/")[2]
        self.begun.append(user)
        self.at_once += 1
        self.most = max(self.most, self.at_once)
        await self.let.wait()
        self.at_once -= 1
        return Read(user=user)


@asynccontextmanager
async def served() -> AsyncIterator[tuple[Reading, Bus, Bus]]:
    reading = Reading()
    async with open_pair() as (server, client):
        server.serve("svc/setup/*", Empty, reading.answer, reading=True)
        yield reading, server, client


def ask(bus: Bus, user: str, many: int) -> list[asyncio.Task[Read]]:
    return [asyncio.create_task(bus.request(f"svc/setup/{user}", Empty(), Read, TIMEOUT)) for _ in range(many)]


async def test_a_few_are_served_at_a_time_and_who_asks_little_is_next() -> None:
    async with served() as (reading, server, client):
        flood = ask(client, "eve", AT_ONCE + 20)
        async with asyncio.timeout(TIMEOUT):
            while server.counters()["bus.waiting"] < 20:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        (little,) = ask(client, "anna", 1)
        async with asyncio.timeout(TIMEOUT):
            while server.counters()["bus.waiting"] < 21:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert reading.begun == ["eve"] * AT_ONCE
        reading.let.set()
        assert (await little).user == "anna"
        await asyncio.gather(*flood)
        assert reading.begun.index("anna") <= AT_ONCE + 1
        assert reading.most <= AT_ONCE


async def test_request_beyond_the_queue_is_refused_with_the_limit() -> None:
    async with served() as (reading, server, client):
        flood = ask(client, "eve", AT_ONCE + WAITING + 5)
        async with asyncio.timeout(TIMEOUT):
            done, _ = await asyncio.wait(flood, return_when=asyncio.FIRST_COMPLETED)
            while len(done) < 5:
                done = {each for each in flood if each.done()}
                await asyncio.sleep(0.01)
        error = done.pop().exception()
        assert isinstance(error, DeviceError)
        assert (error.fields["reason"], str(WAITING) in error.text) == ("busy", True)
        reading.let.set()
        replies = await asyncio.gather(*flood, return_exceptions=True)
        assert sum(isinstance(each, Read) for each in replies) == AT_ONCE + WAITING
        assert server.counters()["bus.refused"] == 5
