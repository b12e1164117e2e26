"""The feed follows a cell, and says why it cannot: it reconnects, and reports no health that is old."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.background import background_task
from pcmrs.console._live_feed import CHECK_PERIOD, RECONNECT_PERIOD, RENEW_PERIOD, LiveFeed
from pcmrs.errors import BusError, UnknownOutcomeError
from pcmrs.messages import BodyPose, JournalPage, JournalQuery, Snapshot
from pcmrs.messages._snapshot import LeaseState
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView, Setup
from pcmrs.service.health.report import report
from pcmrs.spatial import Transform
from pcmrs.testing.clock import settle
from tests.support.health_facts import WELL
from tests.unit.bus.bus_cells import snapshot
from tests.unit.console.shown_cell import body, setup


class Daemon:
    """What a feed asks of a client; `reached` and `answers` can be taken away."""

    user = "local"

    def __init__(self) -> None:
        self.reached = self.answers = True
        self.dialled = 0
        self.leases: list[str] = []
        self.followed: list[str] = []
        self.gathers = 0
        self.events: asyncio.Queue[Snapshot] = asyncio.Queue()
        self.pose: Callable[[BodyPose], None] = lambda _: None

    @asynccontextmanager
    async def dial(self) -> AsyncIterator[Any]:
        self.dialled += 1
        if not self.reached:
            raise BusError("No daemon answers.")
        yield self

    def listen(self, key: str, _kind: type[Any], handler: Callable[[Any], None]) -> Callable[[], Any]:
        if key.startswith("state/pose"):
            self.pose = handler
        self.followed.append(key)

        async def end() -> None:
            self.followed.remove(key)

        return end

    async def watch(self) -> AsyncGenerator[Snapshot, None]:
        while True:
            yield await self.events.get()

    async def setup(self) -> Setup:
        return setup()

    async def health(self) -> Health:
        if not self.answers:
            raise UnknownOutcomeError("It is silent.")
        return report(WELL)

    async def gathered(self) -> ProcedureDataView:
        self.gathers += 1
        return ProcedureDataView(landmarks=[])

    async def journal(self, _: JournalQuery) -> JournalPage:
        return JournalPage(rows=[])

    async def lease(self, operation: str) -> None:
        self.leases.append(operation)


@asynccontextmanager
async def following(daemon: Daemon) -> AsyncIterator[LiveFeed]:
    """A feed with one open page."""
    feed = LiveFeed(daemon.dial)
    feed.page_opened("a")
    async with background_task(feed.run()):
        await asyncio.sleep(0.1)
        yield feed


async def test_the_newest_state_is_known_and_each_change_counts() -> None:
    daemon = Daemon()
    async with following(daemon) as feed:
        assert feed.setup == setup()
        assert (feed.trouble, feed.client is not None) == ("", True)
        before = feed.version
        daemon.events.put_nowait(snapshot(7))
        daemon.pose(body("coil", Transform.identity()))
        await asyncio.sleep(0.1)
        assert feed.snapshot == snapshot(7)
        assert feed.version > before
        assert feed.poses["coil"].body == "coil"
        assert feed.age("coil") is not None
        assert feed.age("joints") is None


async def test_it_dials_until_the_daemon_is_there() -> None:
    daemon = Daemon()
    daemon.reached = False
    async with following(daemon) as feed:
        await asyncio.sleep(3 * RECONNECT_PERIOD)
        assert daemon.dialled == 4
        assert (feed.client, feed.trouble) == (None, "No daemon answers.")
        with pytest.raises(UnknownOutcomeError, match="No daemon answers"):
            await feed.hold("acquire")
        daemon.reached = True
        await asyncio.sleep(RECONNECT_PERIOD)
        assert feed.client is not None


async def test_a_daemon_that_is_silent_twice_is_gone() -> None:
    daemon = Daemon()
    daemon.events.put_nowait(snapshot(1))
    async with following(daemon) as feed:
        assert feed.health is not None
        daemon.answers = False
        await asyncio.sleep(CHECK_PERIOD)
        assert feed.health is None, "an old report is not shown"
        assert feed.client is not None, "once may be a busy machine"
        await asyncio.sleep(CHECK_PERIOD)
        assert feed.client is None
        assert feed.trouble == "It is silent."
        assert feed.snapshot == snapshot(1), "the last state stays"


async def test_a_lease_is_renewed_only_while_it_is_held() -> None:
    daemon = Daemon()
    async with following(daemon) as feed:
        await feed.hold("acquire")
        await asyncio.sleep(2 * RENEW_PERIOD)
        assert daemon.leases == ["acquire"], "the daemon has not said yet who holds it"
        daemon.events.put_nowait(replace(snapshot(1), lease=LeaseState(holder="local")))
        await asyncio.sleep(2 * RENEW_PERIOD)
        assert daemon.leases == ["acquire", "renew", "renew"]
        await feed.hold("release")
        await asyncio.sleep(2 * RENEW_PERIOD)
        assert daemon.leases[3:] == ["release"]


async def test_streams_and_data_are_followed_while_a_page_is_open() -> None:
    daemon = Daemon()
    async with following(daemon) as feed:
        assert sorted(daemon.followed) == ["state/epoch", "state/joints", "state/pose/*"]
        feed.page_opened("b")
        feed.page_closed("a")
        await settle()
        assert len(daemon.followed) == 3, "another page is open"
        feed.page_closed("b")
        await settle()
        before = daemon.gathers
        daemon.events.put_nowait(snapshot(2))
        await settle()
        assert (daemon.followed, daemon.gathers, feed.snapshot) == ([], before, snapshot(2))
        feed.page_opened("c")
        await settle()
        assert (len(daemon.followed), daemon.gathers) == (3, before + 1)


async def test_lease_is_not_renewed_when_the_last_page_is_closed() -> None:
    daemon = Daemon()
    async with following(daemon) as feed:
        await feed.hold("acquire")
        daemon.events.put_nowait(replace(snapshot(1), lease=LeaseState(holder="local")))
        feed.page_closed("a")
        await asyncio.sleep(3 * RENEW_PERIOD)
        assert daemon.leases == ["acquire"]
        feed.page_opened("b")
        await asyncio.sleep(RENEW_PERIOD)
        assert daemon.leases == ["acquire", "renew"]
