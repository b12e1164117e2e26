"""A real bus in small: what a cell says is heard by a plain Zenoh session as CDR, as the bridge would hear it."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest
import zenoh

from pcmrs.bus import Bus, BusSettings
from pcmrs.clock import SystemClock
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose, JointState, PoseMessage, Target
from pcmrs.recording.frame_tree import FrameTree, Mounting
from pcmrs.ros2 import cdr
from pcmrs.ros2.copying import copy_for_ros2
from pcmrs.ros2.poses import Stamps
from pcmrs.ros2.topics import TF_STATIC, Topic
from pcmrs.spatial import Transform, distance
from pcmrs.workflows.settings import CalibrationSettings
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session, snapshot

ARM = find_arm("iiwa14")
MOUNTING = Mounting.read(CalibrationSettings())
POSTURE = [0.1, -0.4, 0.3, 1.2, -0.2, 0.7, 0.5]
COIL = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])
IMAGE = Transform.from_rotvec([0.0, 0.4, 0.0], [0.0, 0.1, 0.0])
CLOCK = SystemClock()


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


def text_of(payload: bytes) -> str:
    return cdr.decode(payload, cdr.String).data


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(TIMEOUT):
        while not condition():  # noqa: ASYNC110 - what is waited for comes in a thread of Zenoh's
            await asyncio.sleep(0.01)


@asynccontextmanager
async def copied() -> AsyncIterator[tuple[Bus, Ear]]:
    """A cell's bus, and what is heard of it once the copying has begun."""
    settings = new_cell()
    client = msgspec.structs.replace(settings, mode="client")
    async with open_bus(settings) as cell:
        with plain_session(settings) as session:
            ear, ended = Ear(session, settings), asyncio.Event()
            copying = asyncio.create_task(copy_for_ros2(client, ARM, MOUNTING, 1.0, ended))
            await until(lambda: "tf_static" in ear.heard)
            yield cell, ear
            ended.set()
            counts = await copying
            await until(lambda: {topic: len(heard) for topic, heard in ear.heard.items()}.items() <= counts.items())


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


async def test_joints_are_a_joint_state_and_the_flange_a_frame() -> None:
    async with copied() as (cell, ear):
        await say_until(cell, lambda: "flange" in ear.links(), joints)
        wall = CLOCK.wall()
        message = cdr.JointState.deserialize(ear.heard["joint_states"][-1])
        assert [*message.name] == [joint.name for joint in ARM.joints]
        assert (message.position, message.velocity, message.effort) == (POSTURE, [0.1] * 7, [2.0] * 7)
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        assert wall - TIMEOUT < stamp <= wall - 0.01
        parent, base_from_flange = ear.links()["flange"]
        assert parent == message.header.frame_id == "robot_base"
        assert distance(base_from_flange, FrameTree(ARM, MOUNTING).joints(joints())[2]) < 1e-9
        assert ear.encodings == {"application/cdr"}


async def test_tracked_body_is_pose_and_frame_and_unseen_is_neither() -> None:
    async with copied() as (cell, ear):
        await say_until(
            cell,
            lambda: len(ear.heard.get("pose/coil", ())) > 3,
            lambda: pose("pointer", COIL, valid=False, reason="missing"),
            lambda: pose("coil", COIL),
        )
        message = cdr.decode(ear.heard["pose/coil"][0], cdr.PoseStamped)
        at, turn = message.pose.position, message.pose.orientation
        heard = Transform.from_quat_xyzw((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
        assert message.header.frame_id == "tracker"
        assert distance(heard, COIL) < 1e-9
        await until(lambda: "coil" in ear.links())
        assert set(ear.links()) == {"coil"}
        assert "pose/pointer" not in ear.heard


async def test_the_arm_hangs_from_the_tracker_where_the_coil_was_seen() -> None:
    async with copied() as (cell, ear):
        await say_until(cell, lambda: "robot_base" in ear.links(), joints, lambda: pose("coil", COIL))
        links = ear.links()
        static = {
            each.child_frame_id: rigid(each.transform)
            for each in cdr.TFMessage.deserialize(ear.heard["tf_static"][0]).transforms
        }
        by_joints = links["robot_base"][1] @ links["flange"][1] @ static["tool"] @ static["coil_by_robot"]
        assert distance(by_joints, COIL) < 1e-9


async def test_image_is_a_frame_while_there_is_a_registration() -> None:
    async with copied() as (cell, ear):
        x, y, z = IMAGE.translation.tolist()
        w, i, j, k = IMAGE.quat_wxyz.tolist()
        known = PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))
        cell.publish("state/target", Target(body_ref_from_image=known))
        await say_until(cell, lambda: "image" in ear.links(), lambda: pose("body_ref", COIL))
        parent, body_ref_from_image = ear.links()["image"]
        assert parent == "body_ref"
        assert distance(body_ref_from_image, IMAGE) < 1e-9
        cell.publish("state/target", Target())
        await say_until(cell, lambda: newest(ear) == ["body_ref"], lambda: pose("body_ref", COIL))


def newest(ear: Ear) -> list[str]:
    return [each.child_frame_id for each in cdr.TFMessage.deserialize(ear.heard["tf"][-1]).transforms]


async def test_state_is_the_snapshot_as_json_also_for_late_subscribers() -> None:
    async with copied() as (cell, ear):
        cell.publish("state/fsm", snapshot(7))
        await until(lambda: "state" in ear.heard)
        told = json.loads(text_of(ear.heard["state"][-1]))
        assert told == msgspec.to_builtins(snapshot(7))
        late = msgspec.structs.replace(cell.settings, mode="client")
        found: list[str] = []
        async with open_bus(late) as bus:
            bus.subscribe_encoded("ros2/state", text_of, lambda _, text: found.append(text))
            await until(lambda: found)
        assert json.loads(found[0])["sequence"] == 7


async def test_topics_are_announced_as_bridges_announce_them() -> None:
    """As in a trace of two bridges (their issue 213): ``…/@ros2_lv/MP/rosout/rcl_interfaces§msg§Log/:1:1:0,1000``."""
    async with copied() as (cell, ear):
        await say_until(cell, lambda: "pose/coil_2" in ear.heard, lambda: pose("coil-2", COIL))
        room = ear.prefix.replace("/", "§")
        assert ear.tokens() == {
            f"MP/{room}joint_states/sensor_msgs§msg§JointState/:1:0:0,10",
            f"MP/{room}tf/tf2_msgs§msg§TFMessage/:1:0:0,10",
            f"MP/{room}tf_static/tf2_msgs§msg§TFMessage/:1:1:0,1",
            f"MP/{room}state/std_msgs§msg§String/:1:1:0,1",
            f"MP/{room}pose§coil_2/geometry_msgs§msg§PoseStamped/:1:0:0,10",
        }
    rosout = Topic("rosout", "rcl_interfaces/msg/Log").token("ccad", "cell")
    assert rosout == "@/ccad/@ros2_lv/MP/cell§ros2§rosout/rcl_interfaces§msg§Log/:1:0:0,10"
    assert TF_STATIC.token("ccad", "cell").endswith(":1:1:0,1")


async def test_joints_of_another_arm_are_not_copied_and_nothing_ends() -> None:
    async with copied() as (cell, ear):
        await say_until(
            cell,
            lambda: len(ear.heard.get("pose/coil", ())) > 3,
            lambda: joints(positions=[0.0] * 6),
            lambda: pose("coil", COIL),
        )
        assert "joint_states" not in ear.heard


class FrozenClock(SystemClock):
    """A clock that the test sets."""

    now, unix = 100.0, 1e9

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return self.unix


def test_delayed_messages_keep_their_times_of_measurement() -> None:
    """Another machine's clock, 7 s behind ours; the second message comes 0.2 s late, together with the third."""
    clock = FrozenClock()
    stamps = Stamps(clock, 1.0)
    found = []
    for captured, arrives in ((0.0, 0.05), (0.1, 0.35), (0.2, 0.35)):
        clock.now, clock.unix = 100.0 + arrives, 1e9 + arrives
        found.append(stamps.of(93.0 + captured, 93.0 + captured + 0.03) - 1e9)
    assert found == pytest.approx([0.02, 0.12, 0.22], abs=1e-6)


@pytest.mark.parametrize("captured", [math.nan, math.inf, -math.inf, 94.0])
def test_implausible_sender_time_is_replaced_by_the_arrival(captured: float) -> None:
    clock = FrozenClock()
    assert Stamps(clock, 1.0).of(captured, 93.0) == pytest.approx(1e9, abs=1e-6)
