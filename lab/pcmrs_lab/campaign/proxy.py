"""Proxies that stand between two processes and spoil the link between them, without any right on the machine."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, Literal, cast

from pcmrs.clock import SystemClock
from pcmrs_lab.campaign.network_impairment import NetworkImpairment

Address = tuple[str, int]
Direction = Literal["towards", "back"]

SLICE = 0.02
"""A narrow stream is passed on in pieces of so many seconds, and a cut one is looked at as often."""

CHUNK = 65536
ON_THE_WAY = 256
"""Pieces of a stream that may be under way at once; the sender of more waits."""
CLOCK = SystemClock()


@asynccontextmanager
async def udp_proxy(server: Address, weather: NetworkImpairment) -> AsyncIterator[Address]:
    """Passes datagrams to `server` and back as the weather has it; every client has a socket of its own there.

    Yields:
        Where clients send to.
    """
    transport, front = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Front(server, weather), local_addr=("127.0.0.1", 0)
    )
    try:
        yield transport.get_extra_info("sockname")[:2]
    finally:
        await front.close()


@asynccontextmanager
async def tcp_proxy(server: Address, weather: NetworkImpairment) -> AsyncIterator[Address]:
    """Passes connections to `server` on; a cut direction stalls, as a wire does: nothing is closed.

    Yields:
        Where clients connect to.
    """
    pipes: set[asyncio.Task[None]] = set()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(*server)
        except OSError:
            writer.close()
            return
        ways: list[tuple[asyncio.StreamReader, asyncio.StreamWriter, Direction]] = [
            (reader, far_writer, "towards"),
            (far_reader, writer, "back"),
        ]
        for source, sink, direction in ways:
            pipe = asyncio.get_running_loop().create_task(_pass_on(source, sink, weather, direction))
            pipes.add(pipe)
            pipe.add_done_callback(pipes.discard)

    listener = await asyncio.start_server(connected, "127.0.0.1", 0)
    try:
        yield listener.sockets[0].getsockname()[:2]
    finally:
        listener.close()
        for pipe in list(pipes):
            pipe.cancel()
        await asyncio.gather(*pipes, return_exceptions=True)


async def _pass_on(
    source: asyncio.StreamReader, sink: asyncio.StreamWriter, weather: NetworkImpairment, direction: Direction
) -> None:
    """Each piece arrives after its delay, and none before an earlier one."""
    on_the_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(ON_THE_WAY)
    arrives = 0.0
    try:
        async with asyncio.TaskGroup() as pipe:
            pipe.create_task(_deliver(on_the_way, sink, weather, direction))
            while True:
                data = await source.read(_most(weather))
                if (rate := weather.narrow) is not None:
                    await CLOCK.sleep(len(data) / rate)
                now = CLOCK.monotonic()
                arrives = max(arrives, now + weather.wait(now))
                await on_the_way.put((arrives, data))
                if not data:
                    break
    except* ConnectionError:
        pass  # one end has gone: that is nothing of the proxy's, and the other end learns of it, as over a wire
    finally:
        sink.close()


async def _deliver(
    on_the_way: asyncio.Queue[tuple[float, bytes]],
    sink: asyncio.StreamWriter,
    weather: NetworkImpairment,
    direction: Direction,
) -> None:
    """Writes what arrives, until the piece without data that ends a stream."""
    while True:
        arrives, data = await on_the_way.get()
        await CLOCK.sleep(max(0.0, arrives - CLOCK.monotonic()))
        while not weather.passes(direction):
            await CLOCK.sleep(SLICE)
        if not data:
            return
        sink.write(data)
        await sink.drain()
        weather.passed[direction] += len(data)


def _most(weather: NetworkImpairment) -> int:
    return CHUNK if (rate := weather.narrow) is None else max(1, int(rate * SLICE))


class _Front(asyncio.DatagramProtocol):
    """The socket that clients send to."""

    def __init__(self, server: Address, weather: NetworkImpairment) -> None:
        self._server = server
        self._weather = weather
        self._carriers: dict[Address, asyncio.Task[None]] = {}
        self._waiting: dict[Address, asyncio.Queue[bytes]] = {}
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        client: Address = addr[:2]
        if not self._weather.passes("towards"):
            return
        if client not in self._carriers:
            self._waiting[client] = asyncio.Queue()
            self._carriers[client] = asyncio.get_running_loop().create_task(self._carry(client))
        self._waiting[client].put_nowait(data)

    def back(self, data: bytes, client: Address) -> None:
        """Passes an answer on to its client."""
        if self._weather.passes("back"):
            self._later(lambda: self._transport.sendto(data, client))

    async def close(self) -> None:
        """Closes all sockets."""
        for carrier in self._carriers.values():
            carrier.cancel()
        await asyncio.gather(*self._carriers.values(), return_exceptions=True)
        self._transport.close()

    async def _carry(self, client: Address) -> None:
        """Passes on what one client sends, from a socket of its own, so that answers find their way back."""
        loop, waiting = asyncio.get_running_loop(), self._waiting[client]
        behind, _ = await loop.create_datagram_endpoint(lambda: _Behind(self, client), remote_addr=self._server)
        try:
            while True:
                self._later(partial(behind.sendto, await waiting.get()))
        finally:
            behind.close()

    def _later(self, send: Callable[[], None]) -> None:
        loop = asyncio.get_running_loop()
        for delay in self._weather.delays(loop.time()):
            if delay:
                loop.call_later(delay, self._send, send)
            else:
                self._send(send)

    def _send(self, send: Callable[[], None]) -> None:
        if not self._transport.is_closing():
            send()


class _Behind(asyncio.DatagramProtocol):
    """The socket by which one client's datagrams reach the server."""

    def __init__(self, front: _Front, client: Address) -> None:
        self._front = front
        self._client = client

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        self._front.back(data, self._client)

    def error_received(self, _: Exception) -> None:
        """The server's port is closed; the client learns of that as it would: by silence."""
