"""A flood of datagrams sends as many as are wanted, all different, and counts the answers."""

from __future__ import annotations

import json
import random
import select
import socket
from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest

from pcmrs.errors import DeviceError
from pcmrs_lab.campaign import flood as flooding
from pcmrs_lab.campaign.flood import FloodResult, flood
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started

ADDRESS = ("127.0.0.1", 4000)
LINE = json.dumps({"datagrams": 100, "answers": 3, "seconds": 4.0}).encode() + b"\n"


class ScriptedSocket:
    """A socket that keeps what is sent, answers each, and is asked for answers until there are none."""

    def __init__(self, *, refuses: bool = False) -> None:
        self.sent: list[bytes] = []
        self._answered = 0
        self._refuses = refuses

    def send(self, payload: bytes) -> int:
        self.sent.append(payload)
        if self._refuses:
            raise ConnectionRefusedError
        return len(payload)

    def recv(self, _: int) -> bytes:
        if self._answered >= len(self.sent):
            raise BlockingIOError
        self._answered += 1
        return b"ok"


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Ends the flood's input after so many reads of it, and lets its time pass only there."""
    now, reads = [0.0], [1 << 30]

    def look(*arguments: Any) -> tuple[list[int], list[int], list[int]]:
        now[0] += arguments[3]
        reads[0] -= 1
        return ([1] if reads[0] <= 0 else []), [], []

    def ended_after(number: int) -> None:
        reads[0] = number

    with monkeypatch.context() as patch:
        patch.setattr(select, "select", look)
        patch.setattr("time.monotonic", lambda: now[0])
        yield ended_after


def sent(rate: float, most: int, *, refuses: bool = False) -> tuple[ScriptedSocket, tuple[int, int, float]]:
    generator = random.Random(1)
    store = [b"%d" % number for number in range(flooding.BATCH)]
    sender = ScriptedSocket(refuses=refuses)
    found = flooding._send(cast(socket.socket, sender), store, generator, rate, most)
    return sender, found


@pytest.mark.usefixtures("time")
@pytest.mark.parametrize("rate", [0.0, 1000.0])
def test_as_many_are_sent_as_are_wanted(rate: float) -> None:
    sender, (count, answers, _) = sent(rate, 150)
    assert (count, answers, len(sender.sent)) == (150, 150, 150)
    assert len(set(sender.sent)) > 120, "those of a number are not sent again and again"


def test_a_rate_is_kept_over_time(time: Callable[[int], None]) -> None:
    time(101)
    _, (count, _, seconds) = sent(1000.0, 0)
    assert seconds == pytest.approx(101 * flooding.BURST)
    assert count == pytest.approx(200, abs=2)


def test_a_flood_without_a_rate_ends_with_its_input(time: Callable[[int], None]) -> None:
    time(3)
    sender, (count, answers, _) = sent(0.0, 0)
    assert count == len(sender.sent) == answers == 3 * flooding.BATCH


@pytest.mark.usefixtures("time")
def test_a_refused_datagram_does_not_end_the_flood() -> None:
    sender, (count, _, _) = sent(0.0, 100, refuses=True)
    assert count == len(sender.sent) == 100


async def test_the_result_is_complete_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild(b"begun\n", LINE)
    started(monkeypatch, child)
    async with flood(ADDRESS, 25.0, 7, most=100) as result:
        assert result.rate == 0.0
    assert (result.datagrams, result.answers, result.rate) == (100, 3, 25.0)
    assert result.ended.is_set()
    assert child.words[3:] == ("127.0.0.1:4000", "--rate", "25.0", "--seed", "7", "--most", "100")


async def test_a_flood_that_ends_by_itself_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b"begun\n" + LINE))
    async with flood(ADDRESS, 0.0, 7, most=100) as result:
        await result.ended.wait()
        assert result.datagrams == 100


async def test_a_flood_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b""))
    with pytest.raises(DeviceError, match="did not start"):
        async with flood(ADDRESS, 0.0, 7):
            pass


async def test_a_flood_that_dies_has_sent_nothing_known(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b"begun\n"))
    async with flood(ADDRESS, 0.0, 7) as result:
        await result.ended.wait()
    assert result.datagrams == 0


async def test_a_sham_flood_sends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch)
    with sham():
        async with flood(ADDRESS, 0.0, 7) as result:
            pass
    assert result.datagrams == FloodResult().datagrams == 0
