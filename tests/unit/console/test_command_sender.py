"""A command of the page ends in a notification, whatever becomes of it, and in a verdict only if there is one."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest
from nicegui import core

from pcmrs.console._command_sender import CommandSender
from pcmrs.errors import CommandRefusedError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import Reason, Verdict
from tests.unit.console.detached_page import ENGLISH, DetachedPage

REJECTED = Verdict(
    id="1", branch="robot", operation="connect", decision="rejected", state="0", sequence=1,
    reason=Reason(code="busy", text="It moves."),
)  # fmt: skip


class Daemon:
    """A client that answers everything with one verdict or error."""

    def __init__(self, answer: Verdict | PcmrsError) -> None:
        self.answer = answer
        self.asked: list[tuple[str, Mapping[str, Any]]] = []

    async def call(self, name: str, arguments: Mapping[str, Any]) -> Verdict:
        self.asked.append((name, arguments))
        if isinstance(self.answer, PcmrsError):
            raise self.answer
        return self.answer

    async def stop(self) -> None:
        await self.call("stop", {})

    async def hold(self, operation: str) -> None:
        await self.call(operation, {})


def sender(daemon: Daemon | None) -> CommandSender:
    feed: Any = SimpleNamespace(client=daemon, trouble="The cable is cut.", hold=getattr(daemon, "hold", None))
    return CommandSender(feed, ENGLISH)


@pytest.fixture(autouse=True)
async def running(page: DetachedPage) -> None:
    core.loop = asyncio.get_running_loop()


async def test_a_verdict_is_returned_and_shown_with_its_reason(page: DetachedPage) -> None:
    daemon = Daemon(REJECTED)
    with page.client:
        assert await sender(daemon).ask("robot.connect", {"index": 1}) == REJECTED
    assert daemon.asked == [("robot.connect", {"index": 1})]
    (shown,) = page.notified
    assert "robot.connect" in shown
    assert shown.endswith("It moves.")


async def test_a_placement_says_by_what_noise_it_counts(page: DetachedPage) -> None:
    said = "noise 0.11 mm and 0.06°: placements within 0.22 mm and 0.12° count"
    placed = Verdict(
        id="1", branch="placement", operation="confirm", decision="accepted", state="placed", sequence=1,
        result={"tolerance": {"text": said, "mm": 0.22}},
    )  # fmt: skip
    with page.client:
        await sender(Daemon(placed)).ask("placement.confirm", {})
    (shown,) = page.notified
    assert shown.endswith(said)


async def test_an_unknown_outcome_is_no_verdict_but_is_shown(page: DetachedPage) -> None:
    with page.client:
        assert await sender(Daemon(UnknownOutcomeError("It is silent."))).ask("robot.connect", {}) is None
    assert page.notified == [f"It is silent. {ENGLISH('unknown_look')}"]


async def test_without_daemon_nothing_is_sent_and_the_reason_shown(page: DetachedPage) -> None:
    with page.client:
        assert await sender(None).ask("robot.connect", {}) is None
        await sender(None).stop()
    assert len(page.notified) == 2
    assert all("The cable is cut." in text for text in page.notified)


async def test_a_failed_stop_or_lease_is_shown(page: DetachedPage) -> None:
    daemon = Daemon(CommandRefusedError("anna holds it."))
    with page.client:
        await sender(daemon).stop()
        await sender(daemon).hold("acquire")
    assert [name for name, _ in daemon.asked] == ["stop", "acquire"]
    assert page.notified == ["anna holds it."] * 2
