"""Recordings made by tests: a bus of their own, what is said on it, and what another reader finds in the file."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import mcap.decoder
import msgspec
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from pcmrs.bus import Bus, BusSettings, Empty
from pcmrs.bus.codec import pack
from pcmrs.bus.seal import Seal, new_key, new_run
from pcmrs.clock import SystemClock
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BodyPose, JointState
from pcmrs.recording._foxglove_messages import FoxgloveView
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.series import Limits, files_of
from pcmrs.recording.subscriber import RawSample, Subscriber
from pcmrs.recording.topics import TOPICS
from pcmrs.recording.views import RecordingViews
from pcmrs.recording.writer import PERIOD, RecordingPlan, RecordingReport, RecordingWriter
from pcmrs.testing.daemon import free_port
from pcmrs.testing.waiting import wait_until
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings

TIMEOUT = 20.0
PROBE = "state/robot"
"""A key that nobody else uses: what is said there shows that the recorder hears."""
ARM = ARMS["iiwa14"]
MOUNTING = Mounting.read(CalibrationSettings())


class Recording:
    """A recorder at work on a bus.

    Attributes:
        bus: Where to say something.
    """

    def __init__(self, bus: Bus, subscriber: Subscriber, recorder: RecordingWriter) -> None:
        self.bus = bus
        self._recorder = recorder
        self._ended = asyncio.Event()
        self._task = asyncio.create_task(recorder.run(subscriber, self._ended))

    async def end(self) -> RecordingReport:
        """Ends the recording as Ctrl-C does."""
        self._ended.set()
        return await self.report()

    async def report(self) -> RecordingReport:
        """What the recording came to, when it ends."""
        async with asyncio.timeout(TIMEOUT):
            return await self._task

    async def written(self, count: int) -> None:
        """Waits until so many messages have been recorded."""
        await wait_until(lambda: self._recorder.messages >= count)

    async def hears(self) -> int:
        """Says something until the recorder has heard it, and returns how many messages there are then."""
        async with asyncio.timeout(TIMEOUT):
            while not self._recorder.messages:
                self.bus.publish(PROBE, Empty())
                await asyncio.sleep(0.05)
        await asyncio.sleep(2 * PERIOD)  # what else has been said by now
        return self._recorder.messages


@asynccontextmanager
async def recording(
    first: Path, limits: Limits | None = None, topics: Sequence[str] = TOPICS
) -> AsyncIterator[Recording]:
    """Records a bus of the test's own into `first`."""
    router = BusSettings(mode="router", endpoint=f"tcp/127.0.0.1:{free_port()}", site="test", cell="recorded")
    clock = SystemClock()
    plan = RecordingPlan(first, limits or Limits(), {"cell": router.cell, "site": router.site}, lambda: files_of(first))
    key = new_key()
    bus = await Bus.open(router, Seal(key + new_run(), daemon=True))
    try:
        subscriber = await Subscriber.open(msgspec.structs.replace(router, mode="client"), topics, clock, Seal(key))
        work = Recording(bus, subscriber, RecordingWriter(plan, RecordingViews(ARM, MOUNTING, 1.0), clock))
        try:
            yield work
        finally:
            await work.end()
            await subscriber.close()
    finally:
        await bus.close()


def joints(positions: Sequence[float] = ARM.home, **fields: Any) -> JointState:
    """A measured posture, at rest."""
    zeros = [0.0] * len(positions)
    values: dict[str, Any] = {"captured": 1.0, "sent": 1.0, "velocities": zeros, "torques": zeros} | fields
    return JointState(positions=list(positions), **values)


def pose(body: str, number: int = 1, **fields: Any) -> BodyPose:
    """A body that the tracker sees, captured 30 ms before it is sent."""
    values: dict[str, Any] = {"captured": 1.0, "sent": 1.03, "valid": True, "position": (0.1, 0.2, 1.5)} | fields
    return BodyPose(body=body, frame_number=number, **values)


def decoded(path: Path) -> list[tuple[str, str, int, Any]]:
    """Topic, schema, time in ns and decoded message of all messages, by the `mcap` package and protobuf."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory(), _Json()])
        return [
            (channel.topic, schema.name if schema else "", message.log_time, content)
            for schema, channel, message, content in reader.iter_decoded_messages()
        ]


class _Json(mcap.decoder.DecoderFactory):
    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        return msgspec.json.decode if message_encoding == "json" else None


MESSAGES = 160
BEGUN = 10**18
SPACING = 10**6
"""ns since 1970, and between two messages."""


def written(path: Path) -> list[bytes]:
    """Writes a recording of a few chunks; returns the payloads in order."""
    topics, views, noise = Topics(), RecordingViews(ARM, MOUNTING, 1.0), random.Random(1)
    file = RecordingFile(path, topics, {"cell": "x"})
    payloads = []
    for number in range(MESSAGES):
        message = joints([noise.random() for _ in ARM.joints]) if number % 2 else pose("coil", number)
        heard = RawSample("state/joints" if number % 2 else "state/pose/coil", pack(message), float(number))
        topics.write_raw(heard.key, heard.at, heard.payload, BEGUN + number * SPACING)
        for topic, view in views.of(heard, BEGUN + number * SPACING):
            topics.write(topic, view, BEGUN + number * SPACING)
        payloads.append(heard.payload)
    file.close()
    assert file.error is None
    return payloads


def read_back(shown: Sequence[tuple[str, FoxgloveView]], path: Path) -> list[tuple[str, Any]]:
    """Writes views to a new file, and returns topic and decoded message of each."""
    topics = Topics()
    file = RecordingFile(path, topics, {})
    for topic, view in shown:
        topics.write(topic, view, BEGUN)
    file.close()
    return [(topic, content) for topic, _, _, content in decoded(path)]
