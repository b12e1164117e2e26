"""Poses that a plain Zenoh session puts where the bridge would, as frames of the cell's tracker."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
import zenoh

from pcmrs.clock import SystemClock
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import TrackerDriver
from pcmrs.messages import BodyPose
from pcmrs.ros2 import cdr
from pcmrs.ros2.driver import open_devices
from pcmrs.spatial import Transform, distance
from pcmrs.testing.clock import SetClock
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session

Frame = dict[str, BodyPose]
POSE = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])
BODIES = ("coil", "body_ref", "pointer")
CLOCK = SystemClock()


@dataclass
class Room:
    """A tracker, and ROS as its bridge shows it."""

    tracker: TrackerDriver
    session: zenoh.Session
    prefix: str
    frames: asyncio.Queue[Frame] = field(default_factory=asyncio.Queue)

    def put(self, *bodies: str, at: float | None = None, payload: bytes | None = None, frame: str = "tracker") -> None:
        """Publishes a pose of each body with one stamp, by default the wall's time a moment ago."""
        stamp = CLOCK.wall() - 0.01 if at is None else at
        data = cdr.pose_stamped(frame, POSE, stamp).serialize() if payload is None else payload
        for body in bodies or BODIES:
            self.session.put(f"{self.prefix}/ros2/tracker/{body}", data)

    async def until(self, condition: Callable[[Frame], bool], put: Callable[[], None]) -> Frame:
        """Puts again and again until there is such a frame."""
        async with asyncio.timeout(TIMEOUT):
            while True:
                put()
                await asyncio.sleep(0.02)
                while not self.frames.empty():
                    if condition(frame := self.frames.get_nowait()):
                        return frame

    async def until_troubled(self, with_text: str, put: Callable[[], None]) -> None:
        async with asyncio.timeout(TIMEOUT):
            while with_text not in self.tracker.trouble:
                put()
                await asyncio.sleep(0.02)

    async def read(self) -> None:
        async with aclosing(self.tracker.frames()) as frames:  # type: ignore[type-var]
            async for frame in frames:
                self.frames.put_nowait({pose.body: pose for pose in frame})


@asynccontextmanager
async def room(**own: Any) -> AsyncIterator[Room]:
    settings = new_cell()
    cell = {"endpoint": settings.endpoint, "site": settings.site, "name": settings.cell}
    async with open_bus(settings) as bus, open_devices(["tracker"], {"cell": cell, "ros2": own}, CLOCK) as devices:
        with plain_session(settings) as session:
            found = Room(devices["tracker"], session, bus.prefix)
            reading = asyncio.create_task(found.read())
            yield found
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)


def seen(frame: Mapping[str, BodyPose]) -> bool:
    return all(pose.valid for pose in frame.values())


async def test_poses_of_one_stamp_are_a_frame_that_the_feed_takes() -> None:
    async with room() as ros:
        assert "/tracker/coil" in ros.tracker.trouble
        frame = await ros.until(seen, ros.put)
        assert list(frame) == list(BODIES)
        assert ros.tracker.trouble == ""
        feed = PoseFeed(CLOCK, max_age=60.0)
        for pose in frame.values():
            assert 0.0 <= pose.sent - pose.captured < 1.0
            feed.update(pose)
        assert distance(feed.newest("coil"), POSE) < 1e-9
        assert not feed.dropped


async def test_a_body_whose_pose_does_not_come_is_not_seen() -> None:
    async with room(names={"coil": "tool", "body_ref": "head"}) as ros:
        frame = await ros.until(lambda frame: frame["coil"].valid, lambda: ros.put("tool"))
        assert (frame["body_ref"].valid, frame["body_ref"].reason) == (False, "not_sent")


@pytest.mark.parametrize(
    ("quat_xyzw", "x", "reason"),
    [
        ((0.0, 0.0, 0.0, 0.0), 0.0, "not_unit"),
        ((0.0, 0.0, 0.0, 1.1), 0.0, "not_unit"),
        ((0.0, 0.0, 0.0, 1.0), math.nan, "not_finite"),
        ((0.0, math.inf, 0.0, 1.0), 0.0, "not_finite"),
    ],
)
async def test_invalid_pose_is_an_unseen_body(quat_xyzw: tuple[float, ...], x: float, reason: str) -> None:
    async with room() as ros:

        def put() -> None:
            at = CLOCK.wall() - 0.01
            bad = cdr.Pose(cdr.Point(x, 0.0, 0.0), cdr.Quaternion(*quat_xyzw))
            ros.put("coil", payload=cdr.PoseStamped(cdr.header("tracker", at), bad).serialize())
            ros.put("body_ref", "pointer", at=at)

        frame = await ros.until(lambda frame: frame["coil"].reason == reason, put)
        assert not frame["coil"].valid


@pytest.mark.parametrize(
    ("put", "says"),
    [
        (lambda ros: ros.put(at=CLOCK.wall() - 1.0), "synchronise the clocks"),
        (lambda ros: ros.put(at=CLOCK.wall() + 1.0), "ahead of this machine's clock"),
        (lambda ros: ros.put(frame="camera"), "'camera', not in 'tracker'"),
        (lambda ros: ros.put(payload=b"{}"), "Not a PoseStamped"),
        (lambda ros: ros.put(payload=cdr.String("hello").serialize()), "Not a PoseStamped"),
    ],
    ids=["old", "ahead", "frame", "bytes", "type"],
)
async def test_unusable_poses_are_reported_until_good_ones_come(put: Callable[[Room], None], says: str) -> None:
    async with room() as ros:
        await ros.until_troubled(says, lambda: put(ros))
        assert all(not seen(ros.frames.get_nowait()) for _ in range(ros.frames.qsize()))
        await ros.until(seen, ros.put)
        assert ros.tracker.trouble == ""


async def test_stamps_that_go_back_give_no_frames() -> None:
    async with room() as ros:
        first = await ros.until(seen, ros.put)
        before = CLOCK.wall() - 0.1
        for _ in range(3):
            ros.put(at=before)
        later = await ros.until(seen, ros.put)
        assert later["coil"].frame_number > first["coil"].frame_number
        assert later["coil"].captured > first["coil"].captured
        await ros.until_troubled("No poses come from ROS 2", lambda: None)
        again = await ros.until(seen, ros.put)
        assert again["coil"].frame_number > later["coil"].frame_number


async def test_ros_cannot_speak_of_bodies_that_are_not_configured() -> None:
    async with room(names={"coil": "coil"}) as ros:
        assert list(await ros.until(seen, lambda: ros.put("coil", "witness"))) == ["coil"]


async def test_poses_continue_if_the_clocks_of_both_sides_are_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SetClock()
    monkeypatch.setattr(sys.modules[__name__], "CLOCK", clock)
    async with room() as ros:
        await ros.until(seen, ros.put)
        for step in (3600.0, -3600.0, 0.1, -0.1):
            clock.ahead += step
            frame = await ros.until(seen, ros.put)
            assert 0.0 <= frame["coil"].sent - frame["coil"].captured < 1.0
