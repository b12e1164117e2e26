"""A slow consumer: what it reads, when it is stopped, and what its report says that it lost."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import consumer as consuming
from pcmrs_lab.campaign.consumer import ConsumerReport, Manner, consume, consumer
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import ScriptedBus, ScriptedCell
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started

FOUND = ConsumerReport(sent=10, received=4, counted=6)
LINE = msgspec.json.encode(FOUND) + b"\n"


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Signals that a consumer gets besides those that end it."""
    signals: list[int] = []
    monkeypatch.setattr("os.kill", lambda _pid, number: signals.append(number))
    monkeypatch.setattr(consuming, "process_state", lambda _: "T" if signal.SIGSTOP in signals else "S")
    return signals


@pytest.mark.parametrize(
    ("manner", "word", "was"), [("frozen", "idle", "T"), ("busy", "busy", "S"), ("idle", "idle", "S")]
)
async def test_a_consumer_is_kept_in_its_manner_until_resumed(
    monkeypatch: pytest.MonkeyPatch, sent: list[int], manner: Manner, word: str, was: str
) -> None:
    child = ScriptedChild(b"ready\n" + LINE)
    started(monkeypatch, child)
    async with consumer(ScriptedCell().as_cell, manner) as resume:
        assert sent == ([signal.SIGSTOP] if manner == "frozen" else [])
        assert child.typed == b""
        assert await resume() == msgspec.structs.replace(FOUND, was=was)
    assert child.words[3:] == ("tcp/127.0.0.1:9", "cell1", word)
    assert child.typed == b"\n"
    assert child.signals == [signal.SIGCONT, signal.SIGKILL], "one that is stopped can be ended, too"


@pytest.mark.parametrize("manner", ["frozen", "busy"])
async def test_a_consumer_of_a_sham_campaign_reads_on(
    monkeypatch: pytest.MonkeyPatch, sent: list[int], manner: Manner
) -> None:
    child = ScriptedChild(b"ready\n")
    started(monkeypatch, child)
    with sham():
        async with consumer(ScriptedCell().as_cell, manner):
            pass
    assert (sent, child.words[-1]) == ([], "idle")


@pytest.mark.usefixtures("sent")
async def test_a_consumer_that_has_ended_is_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b""), ScriptedChild(b"ready\n"))
    with pytest.raises(Unmet, match="has ended"):
        async with consumer(ScriptedCell().as_cell, "idle"):
            pass
    async with consumer(ScriptedCell().as_cell, "idle") as resume:
        with pytest.raises(Unmet, match="has ended"):
            await resume()


def test_what_did_not_arrive_is_lost() -> None:
    assert FOUND.lost == 6


class PosesOnABus(ScriptedBus):
    """A bus on which these frames arrive before the consumer is resumed, and these after it."""

    def __init__(self, before: tuple[int, ...], after: tuple[int, ...]) -> None:
        super().__init__()
        self._before, self._after = before, after

    def subscribe(self, key: str, kind: type, handler: Callable[[str, Any], None]) -> Any:
        for number in self._before:
            handler(key, SimpleNamespace(frame_number=number))
        return super().subscribe(key, kind, handler)

    def resumed(self) -> str:
        for number in self._after:
            self.handlers[consuming.POSES]("", SimpleNamespace(frame_number=number))
        self.counts["bus.replaced"] += 3
        return "\n"

    async def close(self) -> None:
        pass


@pytest.mark.parametrize("manner", ["busy", "idle"])
async def test_poses_are_counted_from_the_last_before_it_stopped(monkeypatch: pytest.MonkeyPatch, manner: str) -> None:
    bus = PosesOnABus((5, 6), (10, 12))
    bus.counts["bus.replaced"] = 9

    async def opened(_: Any) -> ScriptedBus:
        return bus

    monkeypatch.setattr("pcmrs.bus.Bus.open", opened)
    monkeypatch.setattr(consuming, "SETTLING", 0.0)
    monkeypatch.setattr(sys.stdin, "readline", bus.resumed, raising=False)
    monkeypatch.setattr(consuming, "_print_line", lambda line: None)
    report = await asyncio.wait_for(consume("tcp/127.0.0.1:9", "cell1", manner), 5.0)
    assert report == ConsumerReport(sent=7, received=3, counted=3)
    assert not bus.handlers
