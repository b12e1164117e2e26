from __future__ import annotations

import asyncio
import csv
import errno
import math
import os
import resource
import time
from contextlib import aclosing
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from structlog.testing import capture_logs

from pcmrs.background import BackgroundTasks
from pcmrs.errors import RefusalError
from pcmrs.gateway.periodic_timer import PeriodicTask, beats_of, kernel_beats
from pcmrs.gateway.pose_files import PoseFileWriter, placement_text
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.gateway.streams import Streams, point_message, pose_message, unity_message
from pcmrs.spatial import Transform
from tests.unit.gateway.gateway_fakes import POSE, WITHIN, FakeCore, ManualClock

_rotvecs = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
_points = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
SWAP_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def test_messages_are_in_mm_with_five_decimals() -> None:
    assert pose_message(POSE) == "__msg_pose_10.00000_20.00000_30.00000_0.50000_0.50000_0.50000_0.50000"
    assert point_message(np.array([0.1, -0.2, 1e-6])) == "__msg_point_100.00000_-200.00000_0.00100"


@given(_points, _rotvecs)
def test_unity_sees_the_mirrored_pose(position: tuple[float, ...], rotvec: tuple[float, ...]) -> None:
    pose = Transform.from_rotvec(position, rotvec)
    numbers = [float(token) for token in unity_message("crnt_", pose).removeprefix("crnt_").split("_")]
    np.testing.assert_allclose(numbers[:3], SWAP_YZ @ pose.translation, atol=1e-7)
    np.testing.assert_allclose(
        Rotation.from_quat(numbers[3:]).as_matrix(), SWAP_YZ @ pose.rotation @ SWAP_YZ, atol=1e-6
    )


class Sent:
    """Collects what a stream sends, by port."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, int]] = []
        self._grown = asyncio.Event()

    def __call__(self, text: str, host: str, port: int) -> None:
        self.messages.append((text, port))
        self._grown.set()

    async def wait(self, count: int) -> None:
        async with asyncio.timeout(WITHIN):
            while len(self.messages) < count:
                self._grown.clear()
                await self._grown.wait()

    def to(self, port: int) -> list[str]:
        return [text.split("_")[0] if port == 8051 else text for text, to in self.messages if to == port]


async def test_pose_stream_keeps_its_rate_and_sends_unity_plans_once() -> None:
    core, clock, sent, tasks = FakeCore(), ManualClock(), Sent(), BackgroundTasks()
    config = GatewayConfig(stream_rate_hz=100.0)
    streams = Streams(core, beats_of(clock), config, sent, tasks)
    began = clock.now
    streams.start_poses()
    streams.start_poses()
    await sent.wait(51)
    assert clock.now - began == pytest.approx((len(sent.to(8079)) - 1) * 0.01, abs=0.011)
    assert sent.to(8051) == ["trgt"]  # not registered: no current pose, no registration
    core.branches["registration"] = "111"
    core.target = Transform.identity()
    sent.messages.clear()
    await sent.wait(20)
    assert set(sent.to(8051)) == {"crnt", "trgt"}
    assert sent.to(8051).count("trgt") == 1
    streams.stop_poses()
    sent.messages.clear()
    streams.start_tip()
    await sent.wait(3)
    assert {port for _, port in sent.messages} == {8083}
    streams.stop_tip()
    await tasks.close()


async def test_a_stream_outlives_a_network_that_is_down() -> None:
    sent, tasks = Sent(), BackgroundTasks()
    failures = 3

    def send(text: str, host: str, port: int) -> None:
        nonlocal failures
        failures -= 1
        if failures >= 0:
            raise OSError(101, "Network is unreachable")
        sent(text, host, port)

    streams = Streams(FakeCore(), beats_of(ManualClock()), GatewayConfig(), send, tasks)
    with capture_logs() as logged:
        streams.start_tip()
        await sent.wait(2)
    assert [entry["reason"] for entry in logged] == ["[Errno 101] Network is unreachable"]
    await tasks.close()


async def test_a_display_without_a_port_is_sent_nothing() -> None:
    sent, tasks = Sent(), BackgroundTasks()
    config = GatewayConfig(mixed_reality=LinkConfig())
    streams = Streams(FakeCore(), beats_of(ManualClock()), config, sent, tasks)
    streams.start_poses()
    await sent.wait(10)
    assert {port for _, port in sent.messages} == {8079}
    await tasks.close()


async def test_an_unknown_pose_is_left_out() -> None:
    core, sent, tasks = FakeCore(), Sent(), BackgroundTasks()
    core.pose = None
    streams = Streams(core, beats_of(ManualClock()), GatewayConfig(), sent, tasks)
    streams.start_poses()
    await sent.wait(1)
    assert sent.to(8079) == []
    await tasks.close()


@given(_points, _rotvecs)
def test_a_saved_placement_reads_back(position: tuple[float, ...], rotvec: tuple[float, ...]) -> None:
    planned = Transform.from_rotvec(position, rotvec)
    content = yaml.safe_load(placement_text(planned, POSE))
    assert list(content) == ["PLANNED_POSE", "MEASURED_POSE"]
    read = content["PLANNED_POSE"]
    np.testing.assert_allclose([read["TRANSLATION"][axis] for axis in "xyz"], planned.translation, atol=1e-15)
    np.testing.assert_allclose([read["ROTATION"][axis] for axis in "xyzw"], planned.quat_xyzw, atol=1e-15)


async def test_a_pose_log_holds_five_seconds_at_twenty_hertz(tmp_path: Path) -> None:
    clock, tasks = ManualClock(), BackgroundTasks()
    pose_files = PoseFileWriter(FakeCore(), clock, tmp_path / "session", tasks)
    began = clock.now
    log = pose_files.log_poses()
    with pytest.raises(RefusalError, match="being taken"):
        pose_files.log_poses()
    path = await log
    assert clock.now - began == pytest.approx(5.0)
    rows = list(csv.reader(path.read_text().splitlines()))
    assert [row[0] for row in rows] == ["body_tool", "pol_body", "pol_tool"] * 101
    assert {len(row) for row in rows} == {8}
    assert list(path.parent.iterdir()) == [path]
    await tasks.close()


async def test_a_placement_without_a_measured_pose_is_not_saved(tmp_path: Path) -> None:
    core = FakeCore()
    pose_files = PoseFileWriter(core, ManualClock(), tmp_path, BackgroundTasks())
    assert (await pose_files.save_placement()).suffix == ".yaml"
    core.pose = None
    with pytest.raises(RefusalError, match="no fresh measured pose"):
        await pose_files.save_placement()


async def test_a_record_gets_its_name_when_the_disk_has_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, synced = os.fsync, []

    def look(descriptor: int) -> None:
        sync(descriptor)
        synced.append((os.fstat(descriptor).st_size, [path.suffix for path in tmp_path.iterdir()]))

    monkeypatch.setattr(os, "fsync", look)
    path = await PoseFileWriter(FakeCore(), ManualClock(), tmp_path, BackgroundTasks()).save_placement()
    assert synced == [(path.stat().st_size, [".part"])]
    assert path.suffix == ".yaml"


async def test_ticks_missed_in_a_stall_are_not_made_up_for() -> None:
    clock, tasks, times = ManualClock(), BackgroundTasks(), []
    enough = asyncio.Event()

    def tick() -> None:
        times.append(clock.now)
        clock.now += 1.0 if len(times) == 2 else 0.0
        if len(times) == 8:
            enough.set()

    repetition = PeriodicTask(beats_of(clock), 10.0, tick, tasks)
    repetition.start()
    await enough.wait()
    repetition.stop()
    await tasks.close()
    assert times[2] == pytest.approx(times[1] + 1.0), "the stall is over"
    assert np.diff(times[2:8]) == pytest.approx(0.1)


async def test_real_time_beats_keep_their_rate_and_missed_ones_are_one() -> None:
    period, missed = 0.01, 20
    began, count = time.monotonic(), 0
    async with aclosing(kernel_beats(period)) as beats:
        async for _ in beats:
            count += 1
            if count == 5:
                time.sleep((missed + 1) * period)  # noqa: ASYNC251 (a loop that is busy elsewhere)
            if count == 10:
                break
    assert time.monotonic() - began > (count - 2 + missed) * period


def open_files() -> list[str]:
    return sorted(each.name for each in Path("/proc/self/fd").iterdir())


async def test_beats_that_end_leave_no_timer_behind() -> None:
    before = open_files()
    tasks = BackgroundTasks()
    repetition = PeriodicTask(kernel_beats, 1000.0, lambda: None, tasks)
    for _ in range(3):
        repetition.start()
        await asyncio.sleep(0.01)
        repetition.stop()
        await tasks.close()
    assert open_files() == before


async def test_where_no_timer_can_be_made_the_beats_say_so() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        with pytest.raises(OSError, match="timerfd") as failed:
            await anext(kernel_beats(0.01))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert failed.value.errno == errno.EMFILE


async def test_rate_beyond_the_timer_does_not_end_the_beats() -> None:
    async with asyncio.timeout(30.0), aclosing(kernel_beats(1.0 / math.inf)) as beats:
        for _ in range(3):
            await anext(beats)
