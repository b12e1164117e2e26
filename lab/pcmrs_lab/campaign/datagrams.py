"""Bytes at the daemon's UDP sockets, as anybody can send them, and what must not come of them."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, cast

import msgspec

from pcmrs.gateway.rejection_log import REFUSED
from pcmrs.messages import Snapshot
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.sham import bring_about
from pcmrs_lab.campaign.waiting import until_true

ANSWERS_WITHIN = 10.0
"""The daemon has come to a datagram within this, s of the machine."""

FENCE = "stop_visualizexx"
"""A command that changes nothing: its verdict says that what was sent before has been looked at."""

_ids = itertools.count(9_100_000_000)


class Raw(asyncio.DatagramProtocol):
    """A socket that sends whatever it is given. Use `raw_socket`."""

    def __init__(self) -> None:
        self.answers: asyncio.Queue[bytes] = asyncio.Queue()
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        self.answers.put_nowait(data)

    def error_received(self, _: Exception) -> None:
        """Nobody listens there; whoever waits for an answer says so."""

    def send(self, datagram: bytes) -> None:
        """Sends one datagram."""
        self._transport.sendto(datagram)

    def attack(self, datagram: bytes) -> None:
        """Sends one datagram that is the fault."""
        bring_about(lambda: self.send(datagram))

    async def fence(self) -> list[bytes]:
        """Waits until everything sent before has been looked at; returns the answers to that.

        Raises:
            Unmet: The daemon does not answer any more.
        """
        client_id = str(next(_ids))
        self.send(f"{FENCE}_#{client_id};".encode())
        answers: list[bytes] = []
        try:
            async with asyncio.timeout(ANSWERS_WITHIN):
                while not (answer := await self.answers.get()).startswith(f"{client_id}_".encode()):
                    answers.append(answer)
        except TimeoutError:
            raise Unmet(f"The socket does not answer within {ANSWERS_WITHIN:g} s any more.") from None
        return answers

    def close(self) -> None:
        """Closes the socket."""
        self._transport.close()


@asynccontextmanager
async def raw_socket(address: tuple[str, int], port: int = 0) -> AsyncIterator[Raw]:
    """A socket towards one of the daemon's UDP links, at a port of its own or a free one."""
    loop = asyncio.get_running_loop()
    _, raw = await loop.create_datagram_endpoint(Raw, local_addr=("127.0.0.1", port), remote_addr=address)
    try:
        yield raw
    finally:
        raw.close()


def identical(before: Snapshot, after: Snapshot) -> None:
    """Raises `Unmet` unless two snapshots are the same, byte for byte."""
    first, second = msgspec.json.encode(before), msgspec.json.encode(after)
    if first != second:
        raise Unmet(f"The state has changed: {first.decode()} became {second.decode()}.")


async def refused_all(cell: RunningCell, datagrams: Sequence[bytes], *, refusals: int | None = None) -> dict[str, Any]:
    """Sends datagrams that must be refused, response R: nothing changes, and the journal has the refusals.

    Args:
        cell: Whose planner link takes them.
        datagrams: In this order.
        refusals: So many of them are refused; all by default.

    Returns:
        Details for the report.

    Raises:
        Unmet: Something has changed, was accepted, or is not in the journal, or the socket is deaf afterwards.
    """
    before, rows = await cell.client.state(), cell.last_row()
    answers: list[bytes] = []
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for datagram in datagrams:
            raw.attack(datagram)
        answers = await raw.fence()
    accepted = [answer for answer in answers if b"_accepted_" in answer]
    if accepted:
        raise Unmet(f"{accepted[0]!r} was the answer to one of {datagrams!r}.")
    identical(before, await cell.client.state())
    decided = [row for row in cell.rows(after=rows) if row.verdict is not None and row.verdict.decision == "accepted"]
    if decided:
        raise Unmet(f"The journal has an accepted {decided[0].branch}.{decided[0].operation}.")
    wanted = len(datagrams) if refusals is None else refusals
    await until_true(lambda: refusals_after(cell, rows) >= wanted, f"The journal does not have {wanted} refusals")
    return {
        "refused": refusals_after(cell, rows),
        "sent": len(datagrams),
        "answers": [answer.decode(errors="replace") for answer in answers][:8],
        "reasons": _reasons(cell, rows),
    }


async def taken(cell: RunningCell, *commands: bytes) -> str:
    """Sends commands by themselves that must be accepted, and returns the last one's answer: a control.

    Args:
        cell: Whose planner link takes them.
        commands: As they are on the wire, with ids.

    Raises:
        Unmet: One was not accepted within `ANSWERS_WITHIN`.
    """
    answer = b""
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for command in commands:
            raw.send(command)
            try:
                async with asyncio.timeout(ANSWERS_WITHIN):
                    answer = await raw.answers.get()
            except TimeoutError:
                raise Unmet(f"{command!r} by itself is not answered.") from None
            if b"_accepted_" not in answer:
                raise Unmet(f"{command!r} by itself was answered {answer!r}.")
    return answer.decode(errors="replace")


def refusals_after(cell: RunningCell, after: int) -> int:
    """How many refusals later rows tell of: the dispatcher's one by one, the gateway's by their number."""
    count = 0
    for row in cell.rows(after=after):
        if row.operation == REFUSED and row.result is not None:
            count += row.result["fields"]["count"]
        elif row.verdict is not None:
            count += row.verdict.decision == "rejected"
    return count


def _reasons(cell: RunningCell, after: int) -> list[str]:
    """Codes of the refusals that later rows tell of."""
    codes = set()
    for row in cell.rows(after=after):
        if row.operation == REFUSED and row.result is not None:
            codes.add(row.result["fields"]["reason"])
        elif row.verdict is not None and row.verdict.reason is not None:
            codes.add(row.verdict.reason.code)
    return sorted(codes)
