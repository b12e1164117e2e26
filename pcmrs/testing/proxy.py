"""Proxies between two processes that impair the link between them, without special rights on the machine."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, Literal, cast

from pcmrs.clock import SystemClock
from pcmrs.testing.impairment import NetworkImpairment

__all__ = ["tcp_proxy", "udp_proxy"]

Address = tuple[str, int]
Direction = Literal["towards", "back"]

SLICE = 0.02
"""Length of the pieces in which a limited stream is passed on, and period at which a cut one is checked, s."""

CHUNK = 65536
ON_THE_WAY = 256
"""Largest number of pieces of a stream in transit; the sender of more waits."""
CLOCK = SystemClock()


@asynccontextmanager
async def udp_proxy(server: Address, impairment: NetworkImpairment) -> AsyncIterator[Address]:
    """Pass datagrams to `server` and back with an impairment; every client has a separate socket there.

    Args:
        server: Host and port of the server.
        impairment: Behaviour of the link.

    Yields:
        Host and port to which clients send.
    """
    transport, front = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Front(server, impairment), local_addr=("127.0.0.1", 0)
    )
    try:
        yield transport.get_extra_info("sockname")[:2]
    finally:
        await front.close()


@asynccontextmanager
async def tcp_proxy(server: Address, impairment: NetworkImpairment) -> AsyncIterator[Address]:
    """Pass connections to `server` with an impairment; a cut direction stalls like a wire, and nothing is closed.

    Args:
        server: Host and port of the server.
        impairment: Behaviour of the link.

    Yields:
        Host and port to which clients connect.
    """
    pipes: set[asyncio.Task[None]] = set()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(*server)
        except OSError:
            writer.close()
            return
        directions: list[tuple[asyncio.StreamReader, asyncio.StreamWriter, Direction]] = [
            (reader, far_writer, "towards"),
            (far_reader, writer, "back"),
        ]
        for source, sink, direction in directions:
            pipe = asyncio.get_running_loop().create_task(_pass_on(source, sink, impairment, direction))
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
    source: asyncio.StreamReader, sink: asyncio.StreamWriter, impairment: NetworkImpairment, direction: Direction
) -> None:
    """Pass a stream on: each piece arrives after its delay, and none before an earlier one."""
    on_the_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(ON_THE_WAY)
    arrives = 0.0
    try:
        async with asyncio.TaskGroup() as pipe:
            pipe.create_task(_deliver(on_the_way, sink, impairment, direction))
            while True:
                data = await source.read(_most(impairment))
                if (rate := impairment.narrow) is not None:
                    await CLOCK.sleep(len(data) / rate)
                now = CLOCK.monotonic()
                arrives = max(arrives, now + impairment.wait(now))
                await on_the_way.put((arrives, data))
                if not data:
                    break
    except* ConnectionError:
        pass  # one end has gone, which is not an error of the proxy; the other end notices it as over a wire
    finally:
        sink.close()


async def _deliver(
    on_the_way: asyncio.Queue[tuple[float, bytes]],
    sink: asyncio.StreamWriter,
    impairment: NetworkImpairment,
    direction: Direction,
) -> None:
    """Write the pieces that arrive, until the empty piece that ends a stream."""
    while True:
        arrives, data = await on_the_way.get()
        await CLOCK.sleep(max(0.0, arrives - CLOCK.monotonic()))
        while not impairment.passes(direction):
            await CLOCK.sleep(SLICE)
        if not data:
            return
        sink.write(data)
        await sink.drain()
        impairment.passed[direction] += len(data)


def _most(impairment: NetworkImpairment) -> int:
    return CHUNK if (rate := impairment.narrow) is None else max(1, int(rate * SLICE))


class _Front(asyncio.DatagramProtocol):
    """Socket to which clients send."""

    def __init__(self, server: Address, impairment: NetworkImpairment) -> None:
        self._server = server
        self._impairment = impairment
        self._carriers: dict[Address, asyncio.Task[None]] = {}
        self._waiting: dict[Address, asyncio.Queue[bytes]] = {}
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        client: Address = addr[:2]
        if not self._impairment.passes("towards"):
            return
        if client not in self._carriers:
            self._waiting[client] = asyncio.Queue()
            self._carriers[client] = asyncio.get_running_loop().create_task(self._carry(client))
        self._waiting[client].put_nowait(data)

    def back(self, data: bytes, client: Address) -> None:
        """Pass an answer on to its client."""
        if self._impairment.passes("back"):
            self._later(lambda: self._transport.sendto(data, client))

    async def close(self) -> None:
        """Close all sockets."""
        for carrier in self._carriers.values():
            carrier.cancel()
        await asyncio.gather(*self._carriers.values(), return_exceptions=True)
        self._transport.close()

    async def _carry(self, client: Address) -> None:
        """Pass on the datagrams of one client, from a separate socket, so that answers find their way back."""
        loop, waiting = asyncio.get_running_loop(), self._waiting[client]
        behind, _ = await loop.create_datagram_endpoint(lambda: _Behind(self, client), remote_addr=self._server)
        try:
            while True:
                self._later(partial(behind.sendto, await waiting.get()))
        finally:
            behind.close()

    def _later(self, send: Callable[[], None]) -> None:
        loop = asyncio.get_running_loop()
        for delay in self._impairment.delays(loop.time()):
            if delay:
                loop.call_later(delay, self._send, send)
            else:
                self._send(send)

    def _send(self, send: Callable[[], None]) -> None:
        if not self._transport.is_closing():
            send()


class _Behind(asyncio.DatagramProtocol):
    """Socket through which one client's datagrams reach the server."""

    def __init__(self, front: _Front, client: Address) -> None:
        self._front = front
        self._client = client

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        self._front.back(data, self._client)

    def error_received(self, _: Exception) -> None:
        """Ignore that the server's port is closed; the client notices silence, as without a proxy."""
