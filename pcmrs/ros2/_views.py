"""Translation of the messages of the bus to those of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec
from pycdr2 import IdlStruct

from pcmrs.clock import Clock
from pcmrs.messages import BodyPose, JointState, PoseMessage, Snapshot, Target
from pcmrs.recording.frame_tree import FrameLink, FrameTree, fixed_links
from pcmrs.ros2 import cdr
from pcmrs.ros2._poses import Stamps
from pcmrs.ros2.topics import JOINT_STATES, STATE, TF, TF_STATIC, Topic, pose_topic
from pcmrs.spatial import Frame, Transform
from pcmrs.workflows.mounting import Mounting

RosMessage = tuple[Topic, IdlStruct]


class Views:
    """Translation of received messages.

    The tracker is the root of all frames: the bodies that it sees, and the arm by its base, computed whenever the arm
    stands and the tool is seen; see `pcmrs.recording.frame_tree`. The arm's frames are sent with its joints, the image
    with the reference, while there is a registration: an unknown pose is not sent, so that it grows old in ROS.

    Args:
        names: Names of the arm's joints, base to flange.
        chain: Relates the arm to the tracker.
        mounting: Calibrated poses of what the arm carries.
        clock: The cell's clock.
        rate: Seconds of that clock per second of the machine.
    """

    def __init__(self, names: Sequence[str], chain: FrameTree, mounting: Mounting, clock: Clock, rate: float) -> None:
        self._names = [*names]
        self._chain = chain
        self._mounting = mounting
        self._clock = clock
        self._of_robot, self._of_tracker = Stamps(clock, rate), Stamps(clock, rate)
        self._base: FrameLink | None = None
        self._body_ref_from_image: Transform | None = None

    def fixed(self) -> RosMessage:
        """Return the poses that never change."""
        at = self._clock.wall()
        return TF_STATIC, cdr.TFMessage([cdr.link(*link, at) for link in fixed_links(self._mounting)])

    def joints(self, state: JointState) -> Iterator[RosMessage]:
        """Return the joints and frames of the arm.

        Raises:
            GeometryError: The number of joints is not that of the arm, or one is not finite.
        """
        at = self._of_robot.of(state.captured, state.sent)
        flange = self._chain.joints(state)
        header = cdr.header(Frame.ROBOT_BASE, at)
        yield JOINT_STATES, cdr.RosJointState(header, self._names, state.positions, state.velocities, state.torques)
        links = [flange] if self._base is None else [self._base, flange]
        yield TF, cdr.TFMessage([cdr.link(*link, at) for link in links])

    def pose(self, pose: BodyPose) -> Iterator[RosMessage]:
        """Return the pose of a tracked body; nothing while it is not seen.

        Raises:
            GeometryError: It is not a pose.
        """
        at = self._of_tracker.of(pose.captured, pose.sent)
        if not pose.valid:
            return
        tracker_from_body = _transform(pose)
        if pose.body == Frame.TOOL_MARKER:
            self._base = self._chain.tool(tracker_from_body) or self._base
        links = [cdr.link(Frame.TRACKER, pose.body, tracker_from_body, at)]
        if pose.body == Frame.REFERENCE and self._body_ref_from_image is not None:
            links.append(cdr.link(Frame.REFERENCE, Frame.IMAGE, self._body_ref_from_image, at))
        yield pose_topic(pose.body), cdr.pose_stamped(Frame.TRACKER, tracker_from_body, at)
        yield TF, cdr.TFMessage(links)

    def target(self, target: Target) -> None:
        """Store the registration in force."""
        known = target.body_ref_from_image
        self._body_ref_from_image = None if known is None else _transform(known)

    def snapshot(self, snapshot: Snapshot) -> Iterator[RosMessage]:
        """Return the workflow's state, the latch and what is running, as the JSON of the bus."""
        yield STATE, cdr.String(msgspec.json.encode(snapshot).decode())


def _transform(pose: PoseMessage | BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
