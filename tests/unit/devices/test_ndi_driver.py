"""The NDI driver with its real library and reader process, against trackers that misbehave."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import structlog

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.ndi import NdiTracker, open_devices
from pcmrs.devices.ndi.process import MODULE
from pcmrs.devices.ndi.reader import without_sign_extension
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.devices.ndi.wire import Failed, Job, TrackerReady, Unpacker, pack
from pcmrs.errors import ConfigurationError
from pcmrs.messages import BodyPose
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.ndi.server import serve_ndi, serve_ndi_pty
from pcmrs_sim.ndi.system import NdiSystem

DEADLINE = 30.0


@asynccontextmanager
async def _tracker(**table: Any) -> AsyncIterator[NdiTracker]:
    async with asyncio.timeout(DEADLINE), open_devices(("tracker",), {"ndi": table}, SystemClock()) as devices:
        yield devices["tracker"]


async def _frames(tracker: NdiTracker, count: int) -> list[Sequence[BodyPose]]:
    async with aclosing(tracker.frames()) as frames:
        return [await anext(frames) for _ in range(count)]


async def _until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 (what is waited for has no event)
        await asyncio.sleep(0.01)


def _readers() -> list[int]:
    """Process ids of the reader processes that this test has begun."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                command, parent = (
                    (entry / "cmdline").read_bytes(),
                    (entry / "stat").read_text().rsplit(")")[1].split()[1],
                )
            except OSError:
                continue
            if MODULE.encode() in command and int(parent) == os.getpid():
                found.append(int(entry.name))
    return found


@asynccontextmanager
async def _served() -> AsyncIterator[tuple[CellSimulation, str]]:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        yield cell, f"{host}:{port}"


async def test_a_tracker_without_bx_is_asked_in_text(monkeypatch: pytest.MonkeyPatch) -> None:
    perform = NdiSystem.answer
    monkeypatch.setattr(NdiSystem, "answer", lambda self, line: perform(self, line.replace(b"BX", b"QX")))
    async with _served() as (cell, device), _tracker(device=device) as tracker:
        frames = await _frames(tracker, 5)
    coil = next(pose for pose in frames[-1] if pose.body == "coil")
    truth = cell.world.tracker_from_coil().translation
    assert coil.valid
    assert list(coil.position) == pytest.approx(truth.tolist(), abs=1e-3)
    assert all(round(1e5 * value, 6).is_integer() for value in coil.position), "text has hundredths of a millimetre"


async def test_corrupted_answer_is_no_pose_and_tracking_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    perform, asked = NdiSystem.answer, itertools.count()

    def corrupted(self: NdiSystem, line: bytes) -> bytes:
        answer = perform(self, line)
        if line.startswith(b"BX") and next(asked) == 20:
            return answer[:30] + bytes((answer[30] ^ 1,)) + answer[31:]
        return answer

    monkeypatch.setattr(NdiSystem, "answer", corrupted)
    async with _served() as (cell, device), _tracker(device=device) as tracker:
        truth = cell.world.tracker_from_coil().translation.tolist()
        for frame in await _frames(tracker, 30):
            assert next(list(pose.position) for pose in frame if pose.body == "coil") == pytest.approx(truth, abs=1e-3)
        assert next(asked) > 20


async def test_tools_come_from_files_in_any_order(tmp_path: Path) -> None:
    for body in ("pointer", "coil"):
        (tmp_path / f"{body}.rom").write_bytes(placeholder(body))
    files = {body: str(tmp_path / f"{body}.rom") for body in ("pointer", "coil")}
    async with _served() as (_, device), _tracker(device=device, tools=files) as tracker:
        (frame,) = await _frames(tracker, 1)
    assert [(pose.body, pose.valid) for pose in frame] == [("pointer", False), ("coil", True)]


async def test_absent_tracker_is_logged_and_retried_at_growing_pauses() -> None:
    async with _served() as (_, device):
        pass  # nobody listens there any more
    with structlog.testing.capture_logs() as logs:
        async with _tracker(device=device) as tracker:
            reading = asyncio.create_task(_frames(tracker, 1))
            await _until(lambda: len(logs) >= 2)
            assert "nothing listens there" in tracker.trouble
            assert not reading.done()
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
    assert [entry["event"] for entry in logs] == ["tracker_not_there"] * 2
    assert [entry["again_in"] for entry in logs] == [0.5, 1.0]
    assert _readers() == []


async def test_missing_serial_port_is_reported() -> None:
    async with _tracker(device="/dev/pts/none") as tracker:
        reading = asyncio.create_task(_frames(tracker, 1))
        await _until(lambda: "not been reached yet" not in tracker.trouble)
        assert "The tracker at /dev/pts/none: this cannot be opened as a serial port." in tracker.trouble
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    assert _readers() == []


async def test_a_tracker_that_comes_later_is_found() -> None:
    async with _served() as (cell, device):
        pass
    host, port = device.rsplit(":", 1)
    async with _tracker(device=device) as tracker:
        reading = asyncio.create_task(_frames(tracker, 3))
        await _until(lambda: "nothing listens" in tracker.trouble)
        async with running_cell({}, SystemClock()) as cell, serve_ndi(cell, host, int(port)):
            assert len(await reading) == 3
            assert tracker.trouble == ""


async def test_reader_that_is_killed_or_suspended_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.devices.ndi.process.FRAME_TIME", 0.5)
    reasons = {
        signal.SIGKILL: "the reader ended with exit status -9",
        signal.SIGSTOP: "the reader has reported nothing for 0.5 s",
        signal.SIGALRM: "it does not answer",
        signal.SIGSEGV: "an answer was corrupted",
    }
    with structlog.testing.capture_logs() as logs:
        async with _served() as (_, device), _tracker(device=device) as tracker, aclosing(tracker.frames()) as frames:
            assert await anext(frames)
            for ending in reasons:
                (reader,) = _readers()
                os.kill(reader, ending)
                while _readers() in ([], [reader]):
                    await anext(frames)
                assert await anext(frames)
    assert _readers() == []
    told = [entry["reason"] for entry in logs if entry["event"] == "tracker_not_there"]
    assert told == [f"The tracker at {device}: {why}. Check that it is on, and its cable." for why in reasons.values()]


async def test_the_reader_ends_with_its_parent() -> None:
    async with asyncio.timeout(DEADLINE), _served() as (_, device):
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        assert reader.stdin is not None
        assert reader.stdout is not None
        reader.stdin.write(pack(Job(device, 115200, {"coil": placeholder("coil")})))
        assert await reader.stdout.readexactly(4)
        reader.stdin.close()
        assert await reader.stdout.read()
        assert await reader.wait() == 0


async def test_serial_reader_finds_its_tracker_and_ends_with_its_input() -> None:
    async with asyncio.timeout(DEADLINE), running_cell({}, SystemClock()) as cell, serve_ndi_pty(cell) as device:
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        reported, _ = await reader.communicate(pack(Job(device, 115200, {"coil": placeholder("coil")})))
    assert isinstance(Unpacker().feed(reported)[0], TrackerReady)
    assert reader.returncode == 0


async def test_reader_reports_a_serial_port_that_cannot_be_opened() -> None:
    async with asyncio.timeout(DEADLINE):
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        reported, _ = await reader.communicate(pack(Job("/dev/pts/none", 115200, {"coil": placeholder("coil")})))
    assert Unpacker().feed(reported) == [Failed("this cannot be opened as a serial port")]
    assert reader.returncode == 0


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
        async with _tracker(**table):
            pass


async def test_only_a_tracker_is_served() -> None:
    with pytest.raises(ConfigurationError, match="robot"):
        async with open_devices(("tracker", "robot"), {}, SystemClock()):
            pass


@pytest.mark.parametrize(
    ("word", "known"),
    [(0x31, 0x31), (0x8031, 0x8031), (0xFFFFFFFFFFFFFFB1, 0xB1), (0xFFFFFFFFFFFF8131, 0x8131), (2**32 - 1, 2**32 - 1)],
)
def test_a_status_word_is_freed_from_the_signs_of_its_bytes(word: int, known: int) -> None:
    assert without_sign_extension(word) == known
