"""Faults of the tracker on their way through every driver to the feed of poses: no pose, and the cell goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import aclosing
from typing import Any

import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers import ndi
from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.poses import PoseFeed
from pcmrs_sim.cell import running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.ndi.server import serve_ndi
from tests.unit.devices.contract_trackers import TRACKERS, WITHOUT_DYNAMICS

pytest.importorskip("ndicapy")

DEADLINE = 30.0
LIMITS = PoseLimits(error=1e-3, speed=2.0, turn=20.0, steady=10)
MAX_AGE = 0.25

UNBELIEVED: list[tuple[str, dict[str, Any]]] = [
    ("occlude", {"body": "coil"}),
    ("frame_frozen", {}),
    ("pose_nan", {"body": "coil"}),
    ("pose_not_unit", {"body": "coil"}),
    ("not_measured", {"body": "coil", "reason": "partially_out"}),
    ("bad_fit", {"body": "coil"}),
    ("phantom_marker", {"body": "coil"}),
    ("tool_swap", {"first": "coil", "second": "body_ref"}),
    ("wrong_tool", {"body": "coil"}),
    ("stamp_reversed", {}),
    ("tracker_unplugged", {}),
    ("tracker_absent", {}),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "driver",
    [pytest.param(each, marks=pytest.mark.nightly if each == "ndi-serial" else ()) for each in TRACKERS],
)
async def test_no_pose_is_accepted_until_the_fault_ends(driver: str) -> None:
    clock = SystemClock()
    feed = PoseFeed(clock, MAX_AGE, LIMITS)

    async def until(condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(DEADLINE):
            while not condition():  # noqa: ASYNC110 (a feed tells nobody)
                await asyncio.sleep(0.02)

    async with TRACKERS[driver]() as (tracker, cell):

        async def read() -> None:
            async with aclosing(tracker.frames()) as frames:  # type: ignore[type-var]
                async for frame in frames:
                    for pose in frame:
                        feed.update(pose)

        reading = asyncio.create_task(read())
        await until(lambda: feed.seen("coil"))
        for fault, arguments in UNBELIEVED:
            inject(cell, fault, arguments | {"on": True})
            await until(lambda: not feed.seen("coil"))
            await asyncio.sleep(0.5)
            assert not feed.seen("coil"), fault
            inject(cell, fault, arguments | {"on": False})
            await until(lambda: feed.seen("coil"))
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)


async def test_nothing_is_tracked_while_a_tool_is_not_as_defined() -> None:
    async with (
        asyncio.timeout(DEADLINE),
        running_cell(WITHOUT_DYNAMICS, SystemClock()) as cell,
        serve_ndi(cell) as (host, port),
        ndi.open_devices(("tracker",), {"ndi": {"device": f"{host}:{port}"}}, SystemClock()) as devices,
        aclosing(devices["tracker"].frames()) as frames,
    ):
        inject(cell, "wrong_tool", {"body": "coil", "on": True})
        first = asyncio.ensure_future(anext(frames))
        while "PINIT" not in devices["tracker"].trouble:  # noqa: ASYNC110 (it has no event)
            await asyncio.sleep(0.05)
        assert not first.done()
        inject(cell, "wrong_tool", {"body": "coil", "on": False})
        assert {pose.body for pose in await first} == {"coil", "body_ref", "pointer", "witness"}
