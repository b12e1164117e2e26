"""Poses and joints for clients of the gateway: what is seen now, and a posture that is taken at rest only."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.devices.poses import PoseFeed
from pcmrs.messages import BodyPose, JointState
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.spatial import Transform, distance
from pcmrs.testing.clock import ManualClock
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


@pytest.mark.parametrize("hidden", SEEN)
async def test_a_log_of_poses_has_a_gap_while_tool_or_body_is_not_seen(hidden: str) -> None:
    clock = ManualClock()
    feed = PoseFeed(clock, MAX_AGE)
    cell = SimpleNamespace(poses=feed, mounting=MOUNTING)
    core = GatewayAdapter(cast(Any, None), cast(Any, cell), cast(Any, None))
    assert core.tracked() is None
    show(feed, clock, 1, *SEEN)
    tracked = core.tracked()
    assert tracked is not None
    tip = SEEN["coil"] @ MOUNTING.tool_marker_from_tool_tip
    assert distance(tracked["tracker_from_body"] @ tracked["body_from_tool"], tip) < 1e-9
    assert distance(tracked["tracker_from_tool"], tip) < 1e-9
    assert distance(core.seen()["coil"], tip) < 1e-9
    await clock.advance(MAX_AGE + 0.01)
    show(feed, clock, 2, *(SEEN.keys() - {hidden}))
    assert core.tracked() is None, "an old pose is none"
    await clock.advance(0.01)
    show(feed, clock, 3, *SEEN)
    assert core.tracked() is not None


JOINTS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


@pytest.mark.parametrize(
    ("placement", "idle", "taken"),
    [
        pytest.param("retracted", True, JOINTS, id="at rest and clear"),
        pytest.param("standoff", True, None, id="near the body"),
        pytest.param("retracted", False, None, id="on the way to the body: states change when a motion has ended"),
    ],
)
def test_only_a_posture_at_rest_and_clear_of_the_body_is_kept(
    placement: str, idle: bool, taken: list[float] | None
) -> None:
    zero = [0.0] * 7
    state = JointState(captured=1.0, sent=1.0, positions=JOINTS, velocities=zero, torques=zero, moving=not idle)
    cell = SimpleNamespace(joints=state, initial_joints=None)
    procedure = SimpleNamespace(joint=lambda: {"robot": "1", "placement": placement})
    dispatcher = SimpleNamespace(procedure=procedure, idle=idle, report_later=lambda _: None)
    core = GatewayAdapter(cast(Any, dispatcher), cast(Any, cell), cast(Any, None))

    assert core.remember_initial_joints() == taken
    assert cell.initial_joints == taken
