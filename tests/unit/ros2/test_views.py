"""Messages of the bus as messages of ROS 2: joints, poses and frames."""

from __future__ import annotations

from pcmrs.messages import PoseMessage, Target
from pcmrs.recording.frame_tree import FrameTree
from pcmrs.ros2 import cdr
from pcmrs.spatial import Transform, distance
from pcmrs.testing.waiting import wait_until
from tests.unit.bus.bus_cells import TIMEOUT
from tests.unit.ros2.copied_cell import (
    ARM,
    CLOCK,
    COIL,
    MOUNTING,
    POSTURE,
    Ear,
    copied,
    joints,
    pose,
    rigid,
    say_until,
)

IMAGE = Transform.from_rotvec([0.0, 0.4, 0.0], [0.0, 0.1, 0.0])


async def test_joints_are_a_joint_state_and_the_flange_a_frame() -> None:
    async with copied() as (cell, ear):
        await say_until(cell, lambda: "flange" in ear.links(), joints)
        wall = CLOCK.wall()
        message = cdr.RosJointState.deserialize(ear.heard["joint_states"][-1])
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
        await wait_until(lambda: "coil" in ear.links())
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
        by_joints = links["robot_base"][1] @ links["flange"][1] @ static["coil_by_robot"]
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
