"""A UDP socket without a network: what a daemon makes of each datagram is what a test says."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from pcmrs.gateway.rejection_log import REFUSED
from pcmrs_lab.campaign.sham import inject_unless_sham
from tests.unit.lab.campaign.scripted_cell import ScriptedCell
from tests.unit.lab.scripted_client import row


class ScriptedRaw:
    """A socket to one cell.

    Attributes:
        takes: Called with each datagram: its answer, empty for none.
        sent: Datagrams, in order.
    """

    def __init__(self, cell: ScriptedCell) -> None:
        self.cell = cell
        self.takes: Callable[[bytes], bytes] = lambda _: b""
        self.sent: list[bytes] = []
        self.answers: asyncio.Queue[bytes] = asyncio.Queue()

    def send(self, datagram: bytes) -> None:
        self.sent.append(datagram)
        answer = self.takes(datagram)
        if answer:
            self.answers.put_nowait(answer)

    def attack(self, datagram: bytes) -> None:
        inject_unless_sham(lambda: self.send(datagram))

    async def fence(self) -> list[bytes]:
        found = []
        while not self.answers.empty():
            found.append(self.answers.get_nowait())
        return found

    def refuse(self, reason: str = "bad_signature") -> None:
        """Reports a refusal as the gateway does."""
        fields = {"fields": {"count": 1, "reason": reason}}
        self.cell.client.rows.append(row("device", operation=REFUSED, source="gateway", result=fields))

    @asynccontextmanager
    async def open(self, *_: Any) -> AsyncIterator[ScriptedRaw]:
        yield self
