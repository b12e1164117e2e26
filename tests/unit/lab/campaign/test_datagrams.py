"""Datagrams that must be refused: nothing accepted, nothing changed, all of it in the journal, or it is found."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from pcmrs.gateway.rejection_log import REFUSED
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import datagrams
from pcmrs_lab.campaign.datagrams import Raw, identical, raw_socket, refusals_after, refused_all, send_accepted
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run
from tests.unit.lab.scripted_client import row, snapshot, verdict


class Link(Raw):
    """A gateway's link: each datagram has a row or an answer as told, and a fence is answered.

    Attributes:
        answer: Of every datagram; empty for none.
        refuses: Number of refusals that a datagram adds to the journal.
        also: What else a datagram does.
    """

    def __init__(self, cell: ScriptedCell, answer: bytes = b"", refuses: int = 1, *, answers: bool = True) -> None:
        super().__init__()
        self.cell, self.answer, self.refuses, self._answers_fences = cell, answer, refuses, answers
        self.sent: list[bytes] = []
        self.also: Callable[[], None] = lambda: None

    def send(self, datagram: bytes) -> None:
        if datagram.startswith(datagrams.FENCE.encode()):
            if self._answers_fences:
                client_id = datagram.partition(b"#")[2].rstrip(b";")
                self.answers.put_nowait(client_id + b"_accepted_toolplan_1;")
            return
        self.sent.append(datagram)
        self.also()
        if self.answer:
            self.answers.put_nowait(self.answer)
        if self.refuses:
            fields = {"reason": "malformed", "count": self.refuses}
            self.cell.client.rows.append(row("device", source="gateway", operation=REFUSED, result={"fields": fields}))


def linked(monkeypatch: pytest.MonkeyPatch, cell: ScriptedCell, **given: Any) -> Link:
    link = Link(cell, **given)

    @asynccontextmanager
    async def opened(*_: Any) -> AsyncIterator[Link]:
        yield link

    monkeypatch.setattr(datagrams, "raw_socket", opened)
    return link


def test_datagrams_that_are_refused_and_journalled_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    link = linked(monkeypatch, cell, answer=b"7_rejected_toolplan_0_malformed;")
    details = run(monkeypatch, refused_all(cell.as_cell, [b"a;", b"b;"]))
    assert link.sent == [b"a;", b"b;"]
    assert (details["refused"], details["sent"], details["reasons"]) == (2, 2, ["malformed"])
    assert details["answers"] == ["7_rejected_toolplan_0_malformed;"] * 2


def test_an_accepted_datagram_is_found_by_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell, answer=b"7_accepted_toolplan_1;")
    with pytest.raises(Unmet, match=r"7_accepted_toolplan_1;.*was the answer to one of"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"]))


def test_accepted_command_without_answer_is_found_in_the_journal(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell).also = lambda: cell.client.rows.append(row(verdict=verdict("toolplan.plan")))
    with pytest.raises(Unmet, match=r"The journal has an accepted toolplan\.plan"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"]))


def test_a_state_that_changed_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell).also = lambda: cell.client.branches.update(toolplan="1")
    with pytest.raises(Unmet, match="The state has changed"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"]))


@pytest.mark.parametrize("refusals", [None, 2])
def test_refusals_that_the_journal_lacks_are_missed(monkeypatch: pytest.MonkeyPatch, refusals: int | None) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell, refuses=0)
    with pytest.raises(Unmet, match=f"The journal does not have {refusals or 3} refusals"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"] * 3, refusals=refusals))


def test_a_link_that_is_dead_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell, answers=False)
    with pytest.raises(Unmet, match="The UDP socket did not answer within 10 s"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"]))


def test_nothing_is_sent_in_a_sham_campaign_and_that_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    link = linked(monkeypatch, cell)
    with sham(), pytest.raises(Unmet, match="does not have 1 refusals"):
        run(monkeypatch, refused_all(cell.as_cell, [b"a;"]))
    assert link.sent == []


def test_a_control_that_is_not_accepted_is_no_control(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ScriptedCell()
    linked(monkeypatch, cell, answer=b"1_accepted_toolplan_1;")
    assert run(monkeypatch, send_accepted(cell.as_cell, b"a_#1;", b"b_#2;")) == "1_accepted_toolplan_1;"
    linked(monkeypatch, cell, answer=b"1_rejected_toolplan_0_busy;")
    with pytest.raises(Unmet, match="by itself was answered b'1_rejected_toolplan_0_busy;'"):
        run(monkeypatch, send_accepted(cell.as_cell, b"a_#1;"))
    linked(monkeypatch, cell)
    with pytest.raises(Unmet, match="by itself was not answered"):
        run(monkeypatch, send_accepted(cell.as_cell, b"a_#1;"))


def test_refusals_are_those_of_dispatcher_and_gateway_together() -> None:
    cell = ScriptedCell()
    cell.client.rows += [
        row(verdict=verdict("toolplan.plan", "rejected", "busy")),
        row("device", operation=REFUSED, result={"fields": {"reason": "malformed", "count": 5}}),
        row(verdict=verdict("toolplan.plan")),
        row("intent", branch="toolplan", operation="plan"),
        row(verdict=verdict("toolplan.plan", "rejected", "busy")),
    ]
    assert [refusals_after(cell.as_cell, after) for after in (0, 1, 2, 5)] == [7, 6, 1, 0]


def test_snapshots_are_compared_byte_for_byte() -> None:
    before = snapshot(placement="placed")
    identical(before, snapshot(placement="placed"))
    with pytest.raises(Unmet, match="The state has changed"):
        identical(before, msgspec.structs.replace(before, sequence=2))


async def test_a_socket_reaches_its_link_and_passes_answers_on() -> None:
    loop = asyncio.get_running_loop()

    class Echo(asyncio.DatagramProtocol):
        def connection_made(self, transport: Any) -> None:
            self.transport = transport

        def datagram_received(self, data: bytes, addr: Any) -> None:
            self.transport.sendto(data[::-1], addr)

    server, _ = await loop.create_datagram_endpoint(Echo, local_addr=("127.0.0.1", 0))
    async with raw_socket(server.get_extra_info("sockname")[:2]) as raw, asyncio.timeout(10.0):
        raw.attack(b"abc")
        assert await raw.answers.get() == b"cba"
    server.close()
