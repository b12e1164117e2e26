"""A stream and its slow readers."""

from __future__ import annotations

import asyncio

from pcmrs.devices.stream import BACKLOG, Stream
from pcmrs.testing.clock import settle


async def test_a_slow_reader_loses_the_oldest_and_that_is_counted() -> None:
    stream, seen = Stream[int](), list[int]()

    async def read() -> None:
        seen.extend([value async for value in stream.read()])

    reading = asyncio.create_task(read())
    await settle()
    for number in range(BACKLOG + 5):
        stream.publish(number)
    assert stream.dropped == 5
    await settle()
    stream.close()
    await reading
    assert seen == list(range(5, BACKLOG + 5))
