"""A client of the virtual cabinet that knows nothing of our driver."""

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, suppress

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.server import serve_kst

DONE, NAK = b"done\n", b"nak\n"
NUMBER = rb"-?\d+\.\d+(E-?\d+)?_"
ROUNDING = 6e-5  # rad: of five decimals and of an arm at rest
DEADLINE = 20.0  # of a reply; longer than any motion here


class KstClient:
    """Sends lines and reads replies."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    def send(self, *lines: str) -> None:
        self._writer.write("".join(f"{line}\n" for line in lines).encode())

    def raw(self, data: bytes) -> None:
        self._writer.write(data)

    async def reply(self) -> bytes:
        async with asyncio.timeout(DEADLINE):
            return await self._reader.readline()

    async def ask(self, line: str, replies: int = 1) -> bytes:
        """All replies to a line, one after the other."""
        self.send(line)
        return b"".join([await self.reply() for _ in range(replies)])

    async def values(self, line: str) -> list[float]:
        reply = await self.ask(line)
        return [float(token) for token in reply.decode().removesuffix("_\n").split("_")]

    async def joints(self) -> list[float]:
        return await self.values("getJointsPositions")

    async def rest(self) -> bytes:
        """Everything that still comes, when the client will say no more."""
        self._writer.write_eof()
        return await self.until_closed()

    async def until_closed(self) -> bytes:
        async with asyncio.timeout(DEADLINE):
            return await self._reader.read()

    def close(self) -> None:
        self._writer.close()


def line(name: str, values: Iterable[float]) -> str:
    """A request as the toolbox writes it."""
    return f"{name}_" + "".join(f"{value:0.5f}_" for value in values)


@asynccontextmanager
async def connected(host: str, port: int) -> AsyncIterator[KstClient]:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        yield KstClient(reader, writer)
    finally:
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


@asynccontextmanager
async def client_of(cell: CellSimulation) -> AsyncIterator[KstClient]:
    async with serve_kst(cell, port=0) as (host, port), connected(host, port) as client:
        yield client


async def at_rest(cell: CellSimulation) -> None:
    """Returns when the arm rests."""
    async with asyncio.timeout(DEADLINE):
        while not cell.world.arm.at_rest:
            await cell.clock.sleep(0.01)
