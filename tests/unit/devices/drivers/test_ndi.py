"""The NDI driver with its real library and reader process: absent, late and misbehaving trackers, and configuration."""

from __future__ import annotations

import asyncio
import itertools
from contextlib import aclosing
from pathlib import Path
from typing import Any

import pytest
import structlog

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.ndi import open_devices
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.errors import ConfigurationError
from pcmrs.testing.waiting import wait_until
from pcmrs_sim.cell import running_cell
from pcmrs_sim.ndi.server import serve_ndi
from pcmrs_sim.ndi.system import NdiSystem
from tests.unit.devices.ndi_reader import frames_of, ndi_tracker, readers, served_ndi, true_marker


async def test_corrupted_answer_is_no_pose_and_tracking_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    perform, asked = NdiSystem.answer, itertools.count()

    def corrupted(self: NdiSystem, line: bytes) -> bytes:
        answer = perform(self, line)
        if line.startswith(b"BX") and next(asked) == 20:
            return answer[:30] + bytes((answer[30] ^ 1,)) + answer[31:]
        return answer

    monkeypatch.setattr(NdiSystem, "answer", corrupted)
    async with served_ndi() as (cell, device), ndi_tracker(device=device) as tracker:
        truth = true_marker(cell).translation.tolist()
        for frame in await frames_of(tracker, 30):
            assert next(list(pose.position) for pose in frame if pose.body == "coil") == pytest.approx(truth, abs=1e-3)
        assert next(asked) > 20


async def test_tools_come_from_files_in_any_order(tmp_path: Path) -> None:
    for body in ("pointer", "coil"):
        (tmp_path / f"{body}.rom").write_bytes(placeholder(body))
    files = {body: str(tmp_path / f"{body}.rom") for body in ("pointer", "coil")}
    async with served_ndi() as (_, device), ndi_tracker(device=device, tools=files) as tracker:
        (frame,) = await frames_of(tracker, 1)
    assert [(pose.body, pose.valid) for pose in frame] == [("pointer", False), ("coil", True)]


async def test_absent_tracker_is_logged_and_retried_at_growing_pauses() -> None:
    async with served_ndi() as (_, device):
        pass  # nobody listens there any more
    with structlog.testing.capture_logs() as logs:
        async with ndi_tracker(device=device) as tracker:
            reading = asyncio.create_task(frames_of(tracker, 1))
            await wait_until(lambda: len(logs) >= 2)
            assert "nothing listens there" in tracker.trouble
            assert not reading.done()
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
    assert [entry["event"] for entry in logs] == ["tracker_not_there"] * 2
    assert [entry["again_in"] for entry in logs] == [0.5, 1.0]
    assert readers() == []


async def test_missing_serial_port_is_reported() -> None:
    async with ndi_tracker(device="/dev/pts/none") as tracker:
        reading = asyncio.create_task(frames_of(tracker, 1))
        await wait_until(lambda: "not been reached yet" not in tracker.trouble)
        assert "The tracker at /dev/pts/none: this cannot be opened as a serial port." in tracker.trouble
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    assert readers() == []


async def test_a_tracker_that_comes_later_is_found() -> None:
    async with served_ndi() as (cell, device):
        pass
    host, port = device.rsplit(":", 1)
    async with ndi_tracker(device=device) as tracker:
        reading = asyncio.create_task(frames_of(tracker, 3))
        await wait_until(lambda: "nothing listens" in tracker.trouble)
        async with running_cell({}, SystemClock()) as cell, serve_ndi(cell, host, int(port)):
            assert len(await reading) == 3
            assert tracker.trouble == ""


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"device": "10.0.0.1:8765"}, r"ndi\.tools is empty"),
        ({"device": "/dev/ttyUSB0"}, r"ndi\.tools is empty"),
        ({"device": "127.0.0.1"}, r"ndi\.device is '127\.0\.0\.1'; it must be host:port"),
        ({"device": "127.0.0.1:999999"}, "1 to 65535"),
        ({"device": "127.0.0.1:0"}, "1 to 65535"),
        ({"device": ":8765"}, "must be host:port"),
        ({"tools": {"coil": "/no/such.rom"}}, "cannot be read"),
        ({"tools": {"coil/../x": "/no/such.rom"}}, r"The table \[ndi\]"),
        ({"latency": -1.0}, r"The table \[ndi\]"),
        ({"baud": 12345}, r"The table \[ndi\]"),
        ({"speed": 1}, r"The table \[ndi\]"),
    ],
)
async def test_a_wrong_table_is_refused_before_anything_is_opened(table: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with ndi_tracker(**table):
            pass


async def test_only_a_tracker_is_served() -> None:
    with pytest.raises(ConfigurationError, match="robot"):
        async with open_devices(("tracker", "robot"), {}, SystemClock()):
            pass


async def test_the_tracker_beeps_while_it_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    systems: list[NdiSystem] = []
    perform = NdiSystem.answer

    def known(self: NdiSystem, line: bytes) -> bytes:
        if self not in systems:
            systems.append(self)
        return perform(self, line)

    monkeypatch.setattr(NdiSystem, "answer", known)
    async with served_ndi() as (_, device), ndi_tracker(device=device) as tracker:
        tracker.beep(1)  # nobody is there yet
        async with aclosing(tracker.frames()) as frames:
            await anext(frames)
            for count in (3, 2, 5):
                tracker.beep(count)
            async for _ in frames:
                if len(heard := [each for system in systems for each in system.beeps]) >= 3:
                    break
        assert heard == [3, 2, 5]
