""""""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pyigtl
import pytest
from structlog.testing import capture_logs

from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.drivers.plus import open_devices
from pcmrs.devices.plus import tracker
from pcmrs.devices.plus.frames import MessageReader
from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import OpenDriver, TrackerDriver
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, distance
from pcmrs.testing.clock import SetClock
from pcmrs.testing.waiting import wait_until
from tests.support import openigtlink_bytes as wire

DRIVER: OpenDriver = open_devices  # the type checker proves it

Frame = Sequence[BodyPose]

CLOCK = SystemClock()

POSE = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])

NAMES = ("CoilToTracker", "ReferenceToTracker", "StylusToTracker")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker, "RETRY_AFTER", 0.01)


class FakePlus:
    """A server that sends what the test says, to the client that came last."""

    def __init__(self) -> None:
        self.clients: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
        self.asked: asyncio.Queue[bytes] = asyncio.Queue()

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients.put_nowait(writer)
        self.asked.put_nowait(await reader.readexactly(58 + 12 + 36 + 2))
        await reader.read()
        writer.close()

    @asynccontextmanager
    async def serving(self, port: int = 0) -> AsyncIterator[int]:
        server = await asyncio.start_server(self.accept, "127.0.0.1", port)
        try:
            yield server.sockets[0].getsockname()[1]
        finally:
            server.close()
            while not self.clients.empty():
                self.clients.get_nowait().close()


def frame(stamp: float, *names: str) -> bytes:
    return b"".join(wire.transform(name, matrix_mm(POSE), stamp) for name in names or NAMES)


@asynccontextmanager
async def opened(port: int, clock: Clock = CLOCK) -> AsyncIterator[AsyncIterator[Frame]]:
    async with open_devices(["tracker"], {"plus": {"port": port}}, clock) as devices:
        device: TrackerDriver = devices["tracker"]
        yield device.frames()


async def beginning(frames: AsyncIterator[Frame]) -> asyncio.Task[Frame]:
    """Begins to read before anything is sent."""

    async def first() -> Frame:
        return await anext(frames)

    task = asyncio.create_task(first())
    await asyncio.sleep(0)
    return task


async def test_a_frame_comes_as_poses_that_the_feed_takes() -> None:
    plus = FakePlus()
    async with plus.serving() as port, opened(port) as frames:
        first = await beginning(frames)
        client = await plus.clients.get()
        client.write(frame(time.time()))
        poses = await first
        assert [pose.body for pose in poses] == ["coil", "body_ref", "pointer"]
        feed = PoseFeed(SystemClock(), max_age=60.0)
        for pose in poses:
            feed.update(pose)
        assert distance(feed.newest("coil"), POSE) < 1e-6
        assert not feed.dropped
        client.close()


async def test_tracking_data_request_has_a_header_that_brings_metadata() -> None:
    plus = FakePlus()
    async with plus.serving() as port, opened(port) as frames:
        first = await beginning(frames)
        asked = await plus.asked.get()
        version, kind, name = wire.HEADER.unpack(asked[:58])[:3]
        assert (version, kind.rstrip(b"\0"), name.rstrip(b"\0")) == (2, b"STT_TDATA", b"PCMRS")
        client = await plus.clients.get()
        content = wire.tracking_data("T", dict.fromkeys(NAMES[:2], matrix_mm(POSE)))
        client.write(wire.with_metadata("TDATA", "T", content, {"ReferenceToTrackerStatus": "MISSING"}, time.time()))
        coil, reference, pointer = await first
        assert (coil.valid, reference.valid, pointer.valid) == (True, False, False)
        assert (reference.reason, pointer.reason) == ("missing", "not_sent")
        client.close()


class VersionOneServer:
    """A server of header version 1: it takes the type of data from where version 1 has it, as OpenIGTLink 2 does."""

    def __init__(self) -> None:
        self.refused: list[bytes] = []

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while not reader.at_eof():
            header = await reader.readexactly(58)
            version, kind = wire.HEADER.unpack(header)[:2]
            body = await reader.readexactly(int.from_bytes(header[42:50], "big"))
            if version == 1 and (kind.rstrip(b"\0"), len(body)) == (b"STT_TDATA", 36):
                content = wire.tracking_data("T", dict.fromkeys(NAMES, matrix_mm(POSE)))
                writer.write(wire.message("TDATA", "T", content, time.time()))
            else:
                self.refused.append(header)


async def test_a_server_of_header_version_1_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker, "ANSWER_WITHIN", 0.05)
    old = VersionOneServer()
    server = await asyncio.start_server(old.accept, "127.0.0.1", 0)
    async with opened(server.sockets[0].getsockname()[1]) as frames:
        async with asyncio.timeout(20.0):
            assert [pose.valid for pose in await anext(frames)] == [True, True, True]
        assert len(old.refused) == 1
    server.close()


async def test_status_with_header_version_2_is_an_answer() -> None:
    """PLUS with a quiet tracker sends only its status; asked with version 1, it would leave out that of the tools."""
    stream = asyncio.StreamReader()
    stream.feed_data(wire.with_metadata("STATUS", "P", b"\0" * 30, {}))
    plus = tracker.PlusTracker("127.0.0.1", 1, {"coil": "CoilToTracker"}, 0.02, CLOCK)
    assert await plus._is_answered(MessageReader(stream, tracker.KINDS))


async def test_poses_without_a_time_stamp_are_refused_and_said() -> None:
    plus = FakePlus()
    async with plus.serving() as port, open_devices(["tracker"], {"plus": {"port": port}}, CLOCK) as devices:
        client = await plus.clients.get()
        client.write(frame(0.0) + frame(0.0))
        await wait_until(lambda: "no time stamp" in devices["tracker"].trouble)


async def test_an_incomplete_frame_does_not_wait_for_the_next_one() -> None:
    plus = FakePlus()
    async with plus.serving() as port, opened(port) as frames:
        first = await beginning(frames)
        client = await plus.clients.get()
        client.write(frame(time.time(), "CoilToTracker"))
        assert [pose.valid for pose in await first] == [True, False, False]
        client.close()


async def test_damaged_and_foreign_messages_are_passed_over() -> None:
    plus = FakePlus()
    async with plus.serving() as port, opened(port) as frames:
        first = await beginning(frames)
        client = await plus.clients.get()
        with capture_logs() as logs:
            client.write(frame(time.time())[:-1] + b"x" + wire.message("IMAGE", "I", b"x" * 100_000))
            client.write(frame(time.time() + 0.001))
            poses = await first
            while not all(pose.valid for pose in poses):  # the damaged one left its frame incomplete
                poses = await anext(frames)
        assert len(logs) == 1
        client.close()


async def test_absent_server_is_waited_for_and_found_when_it_returns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plus, tried, complain = FakePlus(), asyncio.Semaphore(0), tracker.PlusTracker._log_failure

    def complain_and_tell(*args: Any) -> None:
        complain(*args)
        tried.release()

    monkeypatch.setattr(tracker.PlusTracker, "_log_failure", complain_and_tell)
    async with plus.serving() as port:
        pass
    with capture_logs() as logs:
        async with opened(port) as frames:
            first = await beginning(frames)
            await tried.acquire()
            numbers = []
            for _ in range(2):
                async with plus.serving(port):
                    client = await plus.clients.get()
                    client.write(frame(time.time()))
                    numbers.append((await first)[0].frame_number)
                    first = await beginning(frames)
                    client.close()
            first.cancel()
            await asyncio.gather(first, return_exceptions=True)
    assert numbers == [1, 2]
    assert len(logs) == 1  # at most one in ten seconds
    assert f"127.0.0.1:{port}" in logs[0]["server"]


async def test_silent_server_is_reconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker, "SILENCE", 0.01)
    plus = FakePlus()
    with capture_logs() as logs:
        async with asyncio.timeout(10.0), plus.serving() as port, opened(port) as frames:
            first = await beginning(frames)
            silent = [await plus.clients.get() for _ in range(3)]  # the server itself closes none of them
            assert not first.done(), "a frame without any body"
            first.cancel()
            await asyncio.gather(first, return_exceptions=True)
            for each in silent:
                each.close()
    assert [each["reason"] for each in logs] == ["it does not answer, or sends nothing"]


@pytest.mark.parametrize(("name", "advance"), [("ProbeToTracker", 0.001), ("CoilToTracker", 0.0)])
async def test_server_with_other_tools_or_frozen_clock_is_reconnected(
    monkeypatch: pytest.MonkeyPatch, name: str, advance: float
) -> None:
    """The reason is logged."""
    monkeypatch.setattr(tracker, "SILENCE", 0.2)
    plus, stamp = FakePlus(), time.time()
    with capture_logs() as logs:
        async with plus.serving() as port, opened(port):
            client = await plus.clients.get()
            while plus.clients.empty():
                stamp += advance
                client.write(frame(stamp, name))
                await asyncio.sleep(0.001)
            client.close()
    assert "stamps do not advance" in logs[0]["reason"]


@pytest.fixture
def keep_signals() -> Any:
    """The library's server puts handlers of its own on the signals of the process."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.fixture
def library_server(keep_signals: None) -> Any:
    servers: list[Any] = []

    def serve() -> Any:
        servers.append(pyigtl.OpenIGTLinkServer(port=0))
        return servers[-1]

    yield serve
    for server in servers:
        server.stop()


async def test_the_library_s_own_server_is_understood(library_server: Callable[[], Any]) -> None:
    server = library_server()
    async with opened(server.server_address[1]) as frames:
        first = await beginning(frames)
        stamp = time.time()
        for name in NAMES:
            server.send_message(pyigtl.TransformMessage(matrix_mm(POSE), device_name=name, timestamp=stamp), wait=False)
        poses = await first
        while not all(pose.valid for pose in poses):
            poses = await anext(frames)
        np.testing.assert_allclose(poses[0].position, POSE.translation, atol=1e-6)


async def test_poses_continue_if_the_clock_of_both_sides_is_set(library_server: Callable[[], Any]) -> None:
    server, clock = library_server(), SetClock()
    feed = PoseFeed(clock, max_age=60.0)
    async with opened(server.server_address[1], clock) as frames:
        for step in (0.0, 3600.0, -3600.0, 0.1, -0.1):
            clock.ahead += step
            following, stamp = await beginning(frames), clock.wall()
            for name in NAMES:
                message = pyigtl.TransformMessage(matrix_mm(POSE), device_name=name, timestamp=stamp)
                server.send_message(message, wait=False)
            coil = (await following)[0]
            assert 0.0 <= coil.sent - coil.captured < 1.0
            feed.update(coil)
    assert not feed.dropped
