"""The client for programs without asyncio does the same as the other one."""

import asyncio

import pytest

from pcmrs.client import PlainClient
from pcmrs.errors import PayloadError
from tests.unit.bus.bus_cells import TIMEOUT, snapshot
from tests.unit.client.small_daemon import connected


async def test_without_asyncio_a_client_does_the_same() -> None:
    async with connected() as (daemon, _):
        settings = daemon.bus.settings

        def work() -> list[object]:
            with PlainClient.connect(settings.endpoint, settings.site, settings.cell, user="ben") as cell:
                first = cell.state()
                decision = cell.call("robot.connect").decision
                daemon.bus.publish("state/fsm", snapshot(7))
                event = next(cell.watch())
                shown = cell.until(lambda shown: shown.sequence == 7, TIMEOUT)
                with pytest.raises(PayloadError):
                    cell.call("nonsense")
                cell.stop()
                return [first, decision, event, shown, cell.next_step("robot.connect").next]

        assert await asyncio.to_thread(work) == [
            snapshot(0), "accepted", snapshot(7), snapshot(7), "robot.connect",
        ]  # fmt: skip
        assert daemon.commands[0].source == "bus:ben"
        assert {*daemon.stops} == {"bus:ben"}
