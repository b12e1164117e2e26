"""One end of the link between a node and its simulated world: order, backlog and end."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.framing import framed
from pcmrs_sim.process.channel import BACKLOG, Channel
from tests.support.trials import examples

PATIENCE = 10.0  # s


class End:
    """A channel that remembers what arrived."""

    def __init__(self, link: socket.socket) -> None:
        self.taken: list[bytes] = []
        self.ends = 0
        self.channel = Channel(link, self.taken.append, self._end)

    def _end(self) -> None:
        self.ends += 1

    async def until_taken(self, count: int) -> None:
        async with asyncio.timeout(PATIENCE):
            while len(self.taken) < count:  # noqa: ASYNC110
                await asyncio.sleep(0.001)


@pytest.fixture
def link() -> Iterator[tuple[socket.socket, socket.socket]]:
    here, there = socket.socketpair()
    yield here, there
    here.close()
    there.close()


async def test_messages_arrive_whole_and_in_order_both_ways(link: tuple[socket.socket, socket.socket]) -> None:
    one, other = End(link[0]), End(link[1])
    sent = [bytes([number]) * number * 1000 for number in range(100)]
    for message in sent:
        one.channel.send(framed(message))
        other.channel.send(framed(message[::-1]))
    await other.until_taken(100)
    await one.until_taken(100)
    assert other.taken == one.taken == sent
    one.channel.close()
    other.channel.close()


@examples(15)
@given(st.lists(st.binary(max_size=300), min_size=1, max_size=8), st.lists(st.integers(1, 200), max_size=8))
def test_messages_arrive_however_their_bytes_are_cut(messages: list[bytes], cuts: list[int]) -> None:
    async def play() -> list[bytes]:
        here, there = socket.socketpair()
        with there:
            end = End(here)
            data = b"".join(map(framed, messages))
            for cut in cuts:
                there.sendall(data[:cut])
                data = data[cut:]
                end.channel.receive()
            there.sendall(data)
            end.channel.receive()
            end.channel.close()
        return end.taken

    assert asyncio.run(play()) == messages


async def test_a_slow_peer_loses_only_what_may_be_dropped(link: tuple[socket.socket, socket.socket]) -> None:
    one = End(link[0])
    bulk = [framed(bytes([number]) * BACKLOG) for number in range(4)]
    for message in bulk:
        one.channel.send(message)
    one.channel.send(framed(b"late"), droppable=True)
    one.channel.send(framed(b"call"))
    assert one.channel.dropped == 1
    other = End(link[1])  # now the peer reads
    await other.until_taken(5)
    assert [message[:1] for message in other.taken[:4]] == [b"\0", b"\1", b"\2", b"\3"]
    assert other.taken[4:] == [b"call"]
    one.channel.send(framed(b"in time"), droppable=True)
    await other.until_taken(6)
    assert (other.taken[5], one.channel.dropped) == (b"in time", 1)
    one.channel.close()
    other.channel.close()


async def test_the_end_of_the_peer_is_reported_once(link: tuple[socket.socket, socket.socket]) -> None:
    one, other = End(link[0]), End(link[1])
    other.channel.send(framed(b"last"))
    other.channel.close()
    async with asyncio.timeout(PATIENCE):
        while not one.ends:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    one.channel.receive()
    assert (one.taken, one.ends) == ([b"last"], 1)
    one.channel.send(framed(b"nobody is there"))
    assert one.channel.dropped == 1
    assert other.ends == 0, "who closes the link needs no report"
