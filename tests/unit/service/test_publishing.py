"""Queries below ``svc/``: the journal a page at a time, read beside the event loop; and health, told by itself."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from pcmrs.bus import Bus
from pcmrs.devices.link import Link
from pcmrs.dispatcher import Dispatcher
from pcmrs.journal import Journal, JournalReader, JournalRow
from pcmrs.messages import BlueprintTag, JournalPage, JournalQuery, NextStepRequest
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView, Setup
from pcmrs.service.health.report import report
from pcmrs.service.publishing import HEALTH_PERIOD, LARGEST_PAGE, PAGE_BYTES, answer_queries, publish_health
from pcmrs.testing.clock import ManualClock, settle
from tests.support.health_facts import WELL
from tests.unit.dispatcher.dispatcher_fakes import Bench

ROW = JournalRow(
    kind="event",
    wall=1.7e9,
    monotonic=1.0,
    boot_id="boot",
    session_id="session",
    blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)


class Served:
    """A bus that remembers what is served and published."""

    def __init__(self) -> None:
        self.handlers: dict[str, Callable[[str, Any], Awaitable[Any]]] = {}
        self.published: list[tuple[str, Any]] = []

    def publish(self, key: str, message: Any) -> None:
        self.published.append((key, message))

    def serve(self, key: str, _kind: type, handler: Callable[[str, Any], Awaitable[Any]], *, reading: bool) -> None:
        assert reading, "what only reads takes turns"
        self.handlers[key] = handler

    async def page(self, **query: int) -> list[int]:
        page = await self.handlers["svc/journal"]("svc/journal", JournalQuery(**query))
        assert isinstance(page, JournalPage)
        return [row["sequence"] for row in page.rows]


def no_health() -> Health:
    raise AssertionError


def no_setup() -> Setup:
    raise AssertionError


def no_data() -> ProcedureDataView:
    raise AssertionError


async def test_the_journal_is_paged_from_its_beginning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readers: set[int] = set()
    read = JournalReader.read

    def noted_read(self: JournalReader, **filters: Any) -> Any:
        readers.add(threading.get_ident())
        return read(self, **filters)

    monkeypatch.setattr(JournalReader, "read", noted_read)
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    await journal.append([ROW] * (LARGEST_PAGE + 2))
    served = Served()
    answer_queries(cast(Bus, served), cast("Dispatcher[Any, Any]", None), journal.reader, no_health, no_setup, no_data)
    assert await served.page(limit=3) == [1, 2, 3]
    assert await served.page(after=3, limit=2) == [4, 5]
    assert await served.page(limit=10 * LARGEST_PAGE) == list(range(1, LARGEST_PAGE + 1))
    assert await served.page(after=LARGEST_PAGE) == [LARGEST_PAGE + 1, LARGEST_PAGE + 2]
    assert await served.page(after=10 * LARGEST_PAGE) == []
    assert await served.page(before=10 * LARGEST_PAGE, limit=2) == [LARGEST_PAGE + 1, LARGEST_PAGE + 2]
    assert await served.page(before=4, after=1, limit=5) == [2, 3]
    assert threading.get_ident() not in readers
    await journal.close()


async def test_a_page_ends_where_its_rows_are_too_long_together(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    long = msgspec.structs.replace(ROW, arguments={"text": "x" * (PAGE_BYTES // 3)})
    await journal.append([ROW, long, long, long, ROW])
    served = Served()
    answer_queries(cast(Bus, served), cast("Dispatcher[Any, Any]", None), journal.reader, no_health, no_setup, no_data)
    assert await served.page() == [1, 2, 3]
    assert await served.page(after=3) == [4, 5]
    assert await served.page(before=6) == [3, 4, 5]
    assert await served.page(before=3) == [1, 2]
    await journal.append([msgspec.structs.replace(ROW, arguments={"text": "x" * PAGE_BYTES})])
    assert await served.page(after=5) == [6], "one row at least"
    await journal.close()


async def test_health_is_published_at_once_and_periodically() -> None:
    bus, clock = Served(), ManualClock()
    told = (report(msgspec.structs.replace(WELL, uptime=float(n))) for n in range(9))
    task = asyncio.create_task(publish_health(cast(Link, bus), lambda: next(told), clock))
    await settle()
    assert [health.uptime for _, health in bus.published] == [0.0]
    await clock.advance(HEALTH_PERIOD)
    assert [(key, health.uptime) for key, health in bus.published] == [("state/health", 0.0), ("state/health", 1.0)]
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_next_step_is_that_of_the_dispatcher() -> None:
    served, dispatcher = Served(), cast("Dispatcher[Any, Any]", Bench().dispatcher)
    answer_queries(cast(Bus, served), dispatcher, cast(JournalReader, None), no_health, no_setup, no_data)
    asked = served.handlers["svc/next"]
    assert await asked("svc/next", NextStepRequest()) == dispatcher.next_step()
    assert (await asked("svc/next", NextStepRequest(operation="robot.disconnect"))).next == "robot.connect"
    await dispatcher.close()
