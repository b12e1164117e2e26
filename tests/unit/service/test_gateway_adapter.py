"""Poses and joints for clients of the gateway: what is seen now, and a posture that is taken at rest only."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.background import BackgroundTasks
from pcmrs.devices.poses import PoseFeed
from pcmrs.gateway.periodic_timer import beats_of
from pcmrs.gateway.pose_files import PoseFileWriter
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.gateway.streams import Streams
from pcmrs.messages import BodyPose, DeviceEvent, JointState, Reason
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.testing.clock import ManualClock
from pcmrs.workflows.data import PlacementData, Registered, as_message
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings

SEEN = {
    "body_ref": Transform.from_rotvec([0.1, 0.2, 1.3], [0.1, 0.0, 0.2]),
    "coil": Transform.from_rotvec([0.0, 0.0, 0.9], [0.0, 0.3, 0.0]),
}


MOUNTING = Mounting.read(CalibrationSettings())
MAX_AGE = 0.2


def show(feed: PoseFeed, clock: ManualClock, number: int, *bodies: str) -> None:
    """The tracker sees these of the bodies in a frame."""
    now = clock.monotonic()
    for body, pose in SEEN.items():
        x, y, z, w = pose.quat_xyzw.tolist()
        feed.update(
            BodyPose(
                body=body,
                frame_number=number,
                captured=now,
                sent=now,
                valid=body in bodies,
                position=cast(tuple[float, float, float], tuple(pose.translation.tolist())),
                quat_wxyz=(w, x, y, z),
            )
        )


REGISTRATION = Transform.from_rotvec([0.08, -0.03, -0.23], [0.4, 1.1, -0.7])
"""``body_ref_from_image``, far from the identity."""


def registered_core(feed: PoseFeed, registration: Transform | None) -> GatewayAdapter:
    found = None
    if registration is not None:
        pose = as_message(registration)
        found = Registered(
            id="r",
            body_ref_from_image=pose,
            residual=0.0,
            rms=0.0,
            landmarks=(),
            digitized=(),
            patient="",
            calibration="",
        )
    dispatcher = SimpleNamespace(
        procedure=SimpleNamespace(data=PlacementData(registered=found)),
        snapshot=lambda: SimpleNamespace(branches={}),
    )
    cell = SimpleNamespace(poses=feed, mounting=MOUNTING)
    return GatewayAdapter(cast(Any, dispatcher), cast(Any, cell), cast(Any, None))


@pytest.mark.parametrize("hidden", SEEN)
async def test_a_log_of_poses_has_a_gap_while_tool_or_body_is_not_seen(hidden: str) -> None:
    clock = ManualClock()
    feed = PoseFeed(clock, MAX_AGE)
    core = registered_core(feed, REGISTRATION)
    assert core.tracked() is None
    show(feed, clock, 1, *SEEN)
    assert registered_core(feed, None).tracked() is None, "without a registration nothing is known in the image"
    tracked = core.tracked()
    assert tracked is not None
    tip = SEEN["coil"] @ MOUNTING.tool_marker_from_tool_tip
    assert distance(tracked.tracker_from_image @ tracked.image_from_tool, tip) < 1e-9
    assert distance(tracked.tracker_from_tool, tip) < 1e-9
    assert distance(core.seen()["coil"], tip) < 1e-9
    await clock.advance(MAX_AGE + 0.01)
    show(feed, clock, 2, *(SEEN.keys() - {hidden}))
    assert core.tracked() is None, "an old pose is none"
    await clock.advance(0.01)
    show(feed, clock, 3, *SEEN)
    assert core.tracked() is not None


async def test_a_pose_log_has_the_poses_of_the_stream(tmp_path: Path) -> None:
    clock, tasks = ManualClock(), BackgroundTasks()
    streamed: list[str] = []
    feed = PoseFeed(clock, MAX_AGE)
    core = registered_core(feed, REGISTRATION)
    streams = Streams(
        core, beats_of(clock), GatewayConfig(), lambda text, _, port: streamed.extend([text] * (port == 8079)), tasks
    )
    log = PoseFileWriter(core, clock, tmp_path, tasks).log_poses()
    for number in range(1, 103):
        show(feed, clock, number, *SEEN)
        streams.start_poses()
        await clock.advance(0.05)
    rows = [line.split(",") for line in (await log).read_text().splitlines()]
    await tasks.close()

    body_ref, marker = SEEN["body_ref"], SEEN["coil"]
    tool_from_marker = MOUNTING.tool_marker_from_tool_tip.inverse()
    expected = {
        "body_tool": REGISTRATION.inverse() @ body_ref.inverse() @ marker @ tool_from_marker.inverse(),
        "pol_body": body_ref @ REGISTRATION,
        "pol_tool": marker @ tool_from_marker.inverse(),
    }
    assert [name for name, *_ in rows] == list(expected) * 101
    for name, *values in rows:
        numbers = [float(value) for value in values]
        found = Transform.from_quat_xyzw(numbers[:3], numbers[3:])
        assert distance(found, expected[name]) < 2e-6, name
        assert rotation_angle(found, expected[name]) < 1e-5, name
    mm_and_quat = [float(number) for number in streamed[0].removeprefix("__msg_pose_").split("_")]
    in_stream = Transform.from_quat_xyzw([value / 1000.0 for value in mm_and_quat[:3]], mm_and_quat[3:])
    assert distance(in_stream, expected["body_tool"]) < 1e-7
    assert set(streamed) == {streamed[0]}


JOINTS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


class Reporting:
    """Dispatcher whose rows are durable when the test says so.

    Attributes:
        durable: Set when they are.
        broken: Reason if the journal has failed.
    """

    def __init__(self, placement: str, idle: bool) -> None:
        self.idle = idle
        self.broken: Reason | None = None
        self.procedure = SimpleNamespace(joint=lambda: {"robot": "1", "placement": placement})
        self.durable = asyncio.Event()
        self.durable.set()

    async def report(self, _event: DeviceEvent) -> None:
        await self.durable.wait()


@pytest.mark.parametrize("broken", [False, True])
async def test_initial_joints_are_acknowledged_when_durable(broken: bool) -> None:
    zero = [0.0] * 7
    state = JointState(captured=1.0, sent=1.0, positions=JOINTS, velocities=zero, torques=zero, moving=False)
    cell = SimpleNamespace(joints=state, initial_joints=None)
    dispatcher = Reporting("retracted", idle=True)
    dispatcher.durable.clear()
    core = GatewayAdapter(cast(Any, dispatcher), cast(Any, cell), cast(Any, None))

    reply = asyncio.create_task(core.remember_initial_joints())
    await asyncio.sleep(0.01)
    assert not reply.done()
    assert cell.initial_joints is None
    dispatcher.broken = Reason(code="journal_error", text="The disk is full.") if broken else None
    dispatcher.durable.set()
    assert await reply == (None if broken else JOINTS)
    assert cell.initial_joints == (None if broken else JOINTS)


@pytest.mark.parametrize(
    ("placement", "idle", "taken"),
    [
        pytest.param("retracted", True, JOINTS, id="at rest and clear"),
        pytest.param("standoff", True, None, id="near the body"),
        pytest.param("retracted", False, None, id="on the way to the body: states change when a motion has ended"),
    ],
)
async def test_only_a_posture_at_rest_and_clear_of_the_body_is_kept(
    placement: str, idle: bool, taken: list[float] | None
) -> None:
    zero = [0.0] * 7
    state = JointState(captured=1.0, sent=1.0, positions=JOINTS, velocities=zero, torques=zero, moving=not idle)
    cell = SimpleNamespace(joints=state, initial_joints=None)
    core = GatewayAdapter(cast(Any, Reporting(placement, idle)), cast(Any, cell), cast(Any, None))

    assert await core.remember_initial_joints() == taken
    assert cell.initial_joints == taken
