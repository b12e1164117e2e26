"""Raw datagrams at the daemon's UDP sockets, as any program can send them, and the effects that they must not have."""

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
from pcmrs_lab.campaign.sham import inject_unless_sham
from pcmrs_lab.campaign.tries import UNKNOWN, record
from pcmrs_lab.campaign.waiting import until_true

ANSWERS_WITHIN = 10.0
"""Time in which the daemon has processed a datagram, s of the machine."""

FENCE = "stop_visualizexx"
"""Command that changes nothing; its verdict shows that everything sent before has been processed."""

_ids = itertools.count(9_100_000_000)


class Raw(asyncio.DatagramProtocol):
    """Socket that sends any bytes. Use `raw_socket`."""

    def __init__(self) -> None:
        self.answers: asyncio.Queue[bytes] = asyncio.Queue()
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        self.answers.put_nowait(data)

    def error_received(self, _: Exception) -> None:
        """Ignore that no program listens; a caller that waits for an answer reports it."""

    def send(self, datagram: bytes) -> None:
        """Send one datagram."""
        self._transport.sendto(datagram)

    def attack(self, datagram: bytes) -> None:
        """Send one datagram that is the fault; send nothing in a sham campaign."""
        inject_unless_sham(lambda: self.send(datagram))

    async def fence(self) -> list[bytes]:
        """Wait until everything sent before has been processed, and return the answers to it.

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
            raise Unmet(f"The UDP socket did not answer within {ANSWERS_WITHIN:g} s.") from None
        return answers

    def close(self) -> None:
        """Close the socket."""
        self._transport.close()


@asynccontextmanager
async def raw_socket(address: tuple[str, int], port: int = 0) -> AsyncIterator[Raw]:
    """Open a socket to one of the daemon's UDP links for the length of the context.

    Args:
        address: Host and port of the link.
        port: Local port; 0 for a free one.
    """
    loop = asyncio.get_running_loop()
    _, raw = await loop.create_datagram_endpoint(Raw, local_addr=("127.0.0.1", port), remote_addr=address)
    try:
        yield raw
    finally:
        raw.close()


def identical(before: Snapshot, after: Snapshot) -> None:
    """Raise `Unmet` unless two snapshots are equal byte for byte.

    Args:
        before: Snapshot before the fault.
        after: Snapshot after the fault.

    Raises:
        Unmet: The snapshots differ.
    """
    first, second = msgspec.json.encode(before), msgspec.json.encode(after)
    if first != second:
        raise Unmet(f"The state has changed: {first.decode()} became {second.decode()}.")


async def refused_all(cell: RunningCell, datagrams: Sequence[bytes], *, refusals: int | None = None) -> dict[str, Any]:
    """Send datagrams that must be refused; check response R: nothing changes, and the journal has the refusals.

    Args:
        cell: Cell whose planner link receives them.
        datagrams: Datagrams in the order of sending.
        refusals: Expected number of refusals; all by default.

    Returns:
        Details for the report.

    Raises:
        Unmet: Something has changed, was accepted, or is missing in the journal, or the socket does not answer
            afterwards.
    """
    before, rows = await cell.client.state(), cell.last_row()
    answers: list[bytes] = []
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for datagram in datagrams:
            raw.attack(datagram)
        record(UNKNOWN, "UDP")
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


async def send_accepted(cell: RunningCell, *commands: bytes) -> str:
    """Send commands that must be accepted, as a control, and return the last answer.

    Args:
        cell: Cell whose planner link receives them.
        commands: Commands as on the wire, with ids.

    Raises:
        Unmet: A command was not accepted within `ANSWERS_WITHIN`.
    """
    answer = b""
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for command in commands:
            raw.send(command)
            try:
                async with asyncio.timeout(ANSWERS_WITHIN):
                    answer = await raw.answers.get()
            except TimeoutError:
                raise Unmet(f"{command!r} by itself was not answered.") from None
            if b"_accepted_" not in answer:
                raise Unmet(f"{command!r} by itself was answered {answer!r}.")
    return answer.decode(errors="replace")


def refusals_after(cell: RunningCell, after: int) -> int:
    """Return the number of refusals in later rows: the dispatcher's one by one, the gateway's by their count.

    Args:
        cell: Cell with the journal.
        after: Sequence number of the last row before them.
    """
    count = 0
    for row in cell.rows(after=after):
        if row.operation == REFUSED and row.result is not None:
            count += row.result["fields"]["count"]
        elif row.verdict is not None:
            count += row.verdict.decision == "rejected"
    return count


def _reasons(cell: RunningCell, after: int) -> list[str]:
    """Return the reason codes of the refusals in later rows."""
    codes = set()
    for row in cell.rows(after=after):
        if row.operation == REFUSED and row.result is not None:
            codes.add(row.result["fields"]["reason"])
        elif row.verdict is not None and row.verdict.reason is not None:
            codes.add(row.verdict.reason.code)
    return sorted(codes)
