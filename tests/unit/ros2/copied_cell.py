"""A real bus in small: what a cell says, and what a plain Zenoh session hears of it as CDR, as the bridge would."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import zenoh

from pcmrs.bus import Bus, BusSettings
from pcmrs.clock import SystemClock
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose, JointState
from pcmrs.ros2 import cdr
from pcmrs.ros2.copying import copy_for_ros2
from pcmrs.spatial import Transform
from pcmrs.testing.waiting import wait_until
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session

ARM = find_arm("iiwa14")
MOUNTING = Mounting.read(CalibrationSettings())
POSTURE = [0.1, -0.4, 0.3, 1.2, -0.2, 0.7, 0.5]
CLOCK = SystemClock()
COIL = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])


class Ear:
    """A plain session on all that a bridge may hear."""

    def __init__(self, session: zenoh.Session, settings: BusSettings) -> None:
        self.prefix = f"pcmrs/{settings.site}/{settings.cell}/ros2/"
        self.heard: dict[str, list[bytes]] = {}
        self.encodings: set[str] = set()
        self._session = session
        self._subscriber: Any = session.declare_subscriber(f"{self.prefix}**", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        self.encodings.add(str(sample.encoding))
        topic = str(sample.key_expr).removeprefix(self.prefix)
        self.heard.setdefault(topic, []).append(sample.payload.to_bytes())

    def links(self) -> dict[str, tuple[str, Transform]]:
        """Child to parent and ``parent_from_child``, the newest of each on /tf."""
        found = {}
        for payload in self.heard.get("tf", ()):
            for each in cdr.TFMessage.deserialize(payload).transforms:
                found[each.child_frame_id] = (each.header.frame_id, rigid(each.transform))
        return found

    def tokens(self) -> set[str]:
        replies = self._session.liveliness().get("@/*/@ros2_lv/**")
        return {str(reply.ok.key_expr).partition("/@ros2_lv/")[2] for reply in replies if reply.ok}


def rigid(moved: cdr.RigidTransform) -> Transform:
    at, turn = moved.translation, moved.rotation
    return Transform.from_quat_xyzw((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


@asynccontextmanager
async def copied() -> AsyncIterator[tuple[Bus, Ear]]:
    """A cell's bus, and what is heard of it once the copying has begun."""
    settings = new_cell()
    client = msgspec.structs.replace(settings, mode="client")
    async with open_bus(settings) as cell:
        with plain_session(settings) as session:
            ear, ended = Ear(session, settings), asyncio.Event()
            copying = asyncio.create_task(copy_for_ros2(client, ARM, MOUNTING, 1.0, ended))
            await wait_until(lambda: "tf_static" in ear.heard)
            yield cell, ear
            ended.set()
            counts = await copying
            await wait_until(
                lambda: {topic: len(heard) for topic, heard in ear.heard.items()}.items() <= counts.items()
            )


def joints(**changed: Any) -> JointState:
    now = CLOCK.monotonic()
    told: dict[str, Any] = {
        "captured": now - 0.01,
        "sent": now,
        "positions": POSTURE,
        "velocities": [0.1] * 7,
        "torques": [2.0] * 7,
    }
    return JointState(**told | changed)


def pose(body: str, tracker_from_body: Transform, **changed: Any) -> BodyPose:
    now = CLOCK.monotonic()
    x, y, z = tracker_from_body.translation.tolist()
    told: dict[str, Any] = {"captured": now - 0.03, "sent": now, "valid": True, "position": (x, y, z)}
    told["quat_wxyz"] = tuple(tracker_from_body.quat_wxyz.tolist())
    return BodyPose(body=body, frame_number=1, **told | changed)


async def say_until(cell: Bus, condition: Callable[[], object], *said: Callable[[], BodyPose | JointState]) -> None:
    """Streams are sent again and again; the first ones may come before anybody has subscribed."""
    async with asyncio.timeout(TIMEOUT):
        while not condition():
            say(cell, *said)
            await asyncio.sleep(0.02)


def say(cell: Bus, *said: Callable[[], BodyPose | JointState]) -> None:
    for message in (each() for each in said):
        cell.publish(f"state/pose/{message.body}" if isinstance(message, BodyPose) else "state/joints", message)
