"""The session of an attacker counts what reaches the daemon, and sends nothing in a sham campaign."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import counted_session as counting
from pcmrs_lab.campaign.counted_session import CountedSession
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.tries import Try, recorded_tries

OVERHEAD = 10
"""Bytes of the protocol with each message."""


class ScriptedSession:
    """A session whose bytes pass a proxy, as many as the daemon lets pass."""

    def __init__(self) -> None:
        self.impairment = InjectedImpairment()
        self.calls: list[str] = []
        self.most = 1 << 20
        self.replies: list[Any] = []

    def _passes(self, name: str, length: int) -> None:
        self.calls.append(name)
        passed = self.impairment.passed
        passed["towards"] = min(self.most, passed["towards"] + length + OVERHEAD)

    def put(self, key: str, payload: bytes, **_: Any) -> None:
        self._passes("put", len(key) + len(payload))

    def delete(self, key: str) -> None:
        self._passes("delete", len(key))

    def get(self, key: str, *, payload: bytes, attachment: bytes | None, timeout: float) -> list[Any]:
        self._passes("get", len(key) + len(payload))
        return self.replies


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> ScriptedSession:
    monkeypatch.setattr(counting, "ARRIVED_WITHIN", 0.05)
    monkeypatch.setattr(counting, "SETTLED", 0.001)
    return ScriptedSession()


def counted(scripted: ScriptedSession) -> CountedSession:
    return CountedSession(cast(zenoh.Session, scripted), scripted.impairment, "viewer")


async def test_all_that_was_sent_has_arrived_with_overhead(scripted: ScriptedSession) -> None:
    session = counted(scripted)
    await session.put("cmd/eve", b"12345")
    await session.delete("cmd/eve")
    await session.ask("cmd/eve", b"1")
    assert await session.wait_until_arrived() == 12 + 7 + 8 + 3 * OVERHEAD
    assert scripted.calls == ["put", "delete", "get"]


async def test_what_did_not_arrive_was_not_injected(scripted: ScriptedSession) -> None:
    scripted.most = 100
    session = counted(scripted)
    await session.put("cmd/eve", bytes(200))
    with pytest.raises(Unmet, match="not injected: fewer than 207 bytes"):
        await session.wait_until_arrived()
    assert await session.wait_until_arrived(most=100) == 100, "the daemon has closed the link"


async def test_nothing_is_sent_in_a_sham_campaign(scripted: ScriptedSession) -> None:
    session = counted(scripted)
    with sham():
        await session.put("cmd/eve", b"1")
        await session.delete("cmd/eve")
        assert await session.ask("cmd/eve", b"1") == []
        with pytest.raises(Unmet, match="not injected"):
            await session.wait_until_arrived()
    assert scripted.calls == []


async def test_errors_are_no_answers(scripted: ScriptedSession) -> None:
    good = SimpleNamespace(ok=SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: b"yes")))
    scripted.replies = [good, SimpleNamespace(ok=None), good]
    assert await counted(scripted).ask("cmd/eve", b"") == [b"yes", b"yes"]


async def test_the_handshake_is_not_counted(scripted: ScriptedSession) -> None:
    passed = scripted.impairment.passed
    session = counted(scripted)

    async def shake() -> None:
        for _ in range(3):
            passed["towards"] += 500
            await asyncio.sleep(0)

    await asyncio.gather(shake(), session.wait_for_handshake())
    await session.put("cmd/eve", b"1")
    assert await session.wait_until_arrived() == 8 + OVERHEAD


async def test_what_is_sent_is_recorded_as_tried(scripted: ScriptedSession) -> None:
    session = counted(scripted)
    with recorded_tries() as tried:
        await session.put("pcmrs/lab/cell1/stop/eve", b"")
        await session.delete("@/1/router/config/adminspace/enabled")
        with sham():
            await session.ask("svc/journal", b"")
    assert tried == {Try("Stop on the bus", "viewer"), Try("admin space", "viewer")}
