"""What a recording holds, read by another program's library; its limits; and a disk that is full."""

from __future__ import annotations

import asyncio
import errno
import math
import random
import shutil
from collections import namedtuple
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader

from pcmrs.bus.codec import pack
from pcmrs.messages import (
    BlueprintTag,
    DeviceEvent,
    DeviceHealth,
    Epoch,
    PoseMessage,
    Reason,
    Snapshot,
    Target,
    Verdict,
)
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, StimulationShown
from pcmrs.recording.file import CountingFile
from pcmrs.recording.series import Limits, files_of, path_of
from pcmrs.service.health.report import report
from pcmrs.testing.waiting import wait_until
from tests.support.health_facts import WELL
from tests.unit.recording.recording_bench import ARM, decoded, joints, pose, recording

SNAPSHOT = Snapshot(
    sequence=3,
    branches={"robot": "1"},
    flags={"ready": True},
    running=[],
    latched=False,
    blueprint=BlueprintTag(id="w", version="1", hash="0"),
)
REGISTRATION = PoseMessage(position=(0.01, -0.02, 0.2), quat_wxyz=(0.0, 0.0, 1.0, 0.0))
TARGET = Target(
    plan="p",
    pose=PoseMessage(position=(0.0, 0.01, 0.1), quat_wxyz=(0.0, 1.0, 0.0, 0.0)),
    body_ref_from_image=REGISTRATION,
)
VERDICT = Verdict(
    id="1",
    branch="robot",
    operation="connect",
    decision="rejected",
    state="0",
    sequence=1,
    reason=Reason(code="latched", text="Stop is latched."),
)
EVENT = DeviceEvent(device="robot", code="force_limit", text="Too much force.", danger=True)
GATHERED = ProcedureDataView(
    landmarks=[
        LandmarkShown(name="nasion", planned=(0.0, 0.1, 0.0), digitized=(0.0, 0.1, 0.001)),
        LandmarkShown(name="inion", planned=(0.0, -0.1, 0.0)),
    ],
    body_ref_from_image=REGISTRATION,
    residual=0.001,
    stimulation=StimulationShown(ceiling=90.0, hunt={"pulses": [{"intensity": 50.0, "responded": True}]}),
)
EPOCH = Epoch(pulse=7, muscle="fdi", rate_hz=5000.0, start=-0.1, samples=[1e-6, -2e-6])
HEALTH = report(WELL)


async def test_messages_are_in_the_file_as_foxglove_and_as_raw_bytes(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    said = [
        ("state/joints", joints(velocities=[0.1] * 7)),
        ("state/pose/coil", pose("coil")),
        ("state/pose/body_ref", pose("body_ref")),
        ("state/pose/pointer", pose("pointer", valid=False, reason="hidden")),
        ("state/fsm", SNAPSHOT),
        ("state/target", TARGET),
        ("state/data", GATHERED),
        ("state/epoch", EPOCH),
        ("state/health", HEALTH),
        ("state/event", VERDICT),
        ("state/event", EVENT),
        ("dev/robot/state", DeviceHealth(device="robot", connected=True)),
    ]
    async with recording(file) as work:
        before = await work.hears()
        for count, (key, message) in enumerate(said, before + 1):
            work.bus.publish(key, message)
            await work.written(count)
        report = await work.end()

    assert report.files == [str(file)]
    assert (report.messages, report.dropped, report.error) == (before + len(said), 0, None)
    found = decoded(file)
    on_bus = [(topic.removeprefix("bus/"), content.payload) for topic, _, _, content in found if topic[:4] == "bus/"]
    assert on_bus[before:] == [(key, pack(message)) for key, message in said]
    schemas = {topic: schema for topic, schema, _, _ in found if not topic.startswith("bus/")}
    assert schemas == {
        "/tf/calibration": "foxglove.FrameTransforms",
        "/tf/arm": "foxglove.FrameTransforms",
        "/tf/bodies": "foxglove.FrameTransforms",
        "/tf/robot_base": "foxglove.FrameTransforms",
        "/tf/image": "foxglove.FrameTransforms",
        "/joints": "foxglove.JointStates",
        "/state": "pcmrs.Snapshot",
        "/data": "pcmrs.Gathered",
        "/epoch": "pcmrs.Epoch",
        "/daemon": "pcmrs.Health",
        "/health": "pcmrs.DeviceHealth",
        "/target": "foxglove.PoseInFrame",
        "/log": "foxglove.Log",
    }
    shown = {topic: content for topic, _, _, content in found}
    assert [joint.name for joint in shown["/joints"].joints] == [joint.name for joint in ARM.joints]
    assert [joint.velocity for joint in shown["/joints"].joints] == [0.1] * 7
    assert shown["/state"]["branches"] == {"robot": "1"}
    for topic, message in (("/data", GATHERED), ("/epoch", EPOCH), ("/daemon", HEALTH)):
        kind = type(message)  # a field without a value is missing in the file
        assert msgspec.convert(dict.fromkeys(kind.__struct_fields__) | shown[topic], kind) == message
    assert shown["/target"].frame_id == "image"
    (joined,) = shown["/tf/image"].transforms
    assert (joined.parent_frame_id, joined.child_frame_id) == ("body_ref", "image")
    assert (joined.translation.x, joined.translation.y, joined.translation.z) == REGISTRATION.position
    assert [(content.level, content.message) for topic, _, _, content in found if topic == "/log"] == [
        (3, "rejected, robot is in 0: latched: Stop is latched."),
        (4, "force_limit: Too much force."),
    ]


async def test_times_are_of_the_measurement_and_map_to_monotonic_time(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    async with recording(file) as work:
        before = await work.hears()
        work.bus.publish("state/pose/body_ref", pose("body_ref", captured=7.0, sent=7.25))
        await work.written(before + 1)

    found = decoded(file)
    ((_, _, came, transforms),) = [each for each in found if each[0] == "/tf/bodies"]
    measured = transforms.transforms[0].timestamp
    assert came - (measured.seconds * 1_000_000_000 + measured.nanos) == pytest.approx(0.25e9, abs=1.0)
    with file.open("rb") as opened:
        (metadata,) = make_reader(opened).iter_metadata()
    origin = metadata.metadata
    assert origin["cell"] == "recorded"
    for topic, _, log_time, content in found:
        if topic.startswith("bus/"):
            since = content.monotonic - float(origin["monotonic"])
            assert (log_time - int(origin["log_time_ns"])) / 1e9 == pytest.approx(since, abs=1e-6)


async def test_files_rotate_and_each_can_be_understood_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest ones are removed as soon as a file is complete, also between two maintenances."""
    monkeypatch.setattr("pcmrs.recording.writer.MAINTENANCE_PERIOD", math.inf)
    first = tmp_path / "run.mcap"
    limits = Limits(file_bytes=20_000, total_bytes=300_000)
    noise = random.Random(0)
    async with recording(first, limits) as work, asyncio.timeout(60):
        await work.hears()
        work.bus.publish("state/fsm", SNAPSHOT)
        work.bus.publish("state/target", TARGET)
        work.bus.publish("state/data", GATHERED)
        work.bus.publish("state/health", HEALTH)
        while len(files_of(first)) < 3 or path_of(first, 1).exists():
            text = noise.randbytes(2000).hex()  # does not compress well
            work.bus.publish("state/event", DeviceEvent(device="x", code="filler", text=text))
            await asyncio.sleep(0.01)
        report = await work.end()

    assert report.removed >= 1
    assert report.files == [str(path) for path in files_of(first)]
    kept = [path for path in files_of(first) if path != path_of(first, 1)]
    assert sum(path.stat().st_size for path in kept[:-1]) <= 300_000
    for path in kept:
        topics = {topic for topic, _, _, _ in decoded(path)}  # said before this file
        assert {"/tf/calibration", "/tf/image", "/target", "/state", "/data", "/daemon"} <= topics
    log = [content.message for path in kept for topic, _, _, content in decoded(path) if topic == "/log"]
    assert any(text.startswith("run.0001.mcap") and "was removed" in text for text in log)


async def test_full_disk_ends_the_recording_with_an_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was written stays."""
    first = tmp_path / "run.mcap"
    usage = namedtuple("usage", "total used free")
    events: asyncio.Queue[DeviceEvent] = asyncio.Queue()
    async with recording(first, Limits(keep_free_bytes=1e6)) as work:
        work.bus.subscribe("daemon/event", DeviceEvent, lambda _, event: events.put_nowait(event))
        before = await work.hears()
        work.bus.publish("state/fsm", SNAPSHOT)
        await work.written(before + 1)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10, 10, 999_999))
        report = await work.report()
        event = await asyncio.wait_for(events.get(), 20)

    assert report.error is not None
    assert "1 MB are kept for the journal" in report.error
    assert (event.code, event.danger) == ("recording_ended", False)
    assert "/state" in [topic for topic, _, _, _ in decoded(first)]


async def test_failed_write_ends_the_recording_without_a_writer_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    first = tmp_path / "run.mcap"
    async with recording(first) as work:
        before = await work.hears()
        work.bus.publish("state/fsm", SNAPSHOT)
        await work.written(before + 1)
        await wait_until(lambda: first.stat().st_size > 1000)  # written, and flushed
        whole = first.stat().st_size

        def full(self: CountingFile, act: object) -> None:
            self.error = self.error or OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(CountingFile, "_attempt", full)
        work.bus.publish("state/event", EVENT)
        report = await work.report()

    assert report.error is not None
    assert "No space left on device" in report.error
    assert first.stat().st_size >= whole
    assert "error logging message" not in capfd.readouterr().err
