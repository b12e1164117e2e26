"""A cell's state is published for ROS 2 on its own bus, also for late subscribers."""

from __future__ import annotations

import json

import msgspec

from pcmrs.clock import SystemClock
from pcmrs.ros2 import cdr
from pcmrs.ros2.topics import TF_STATIC, Topic
from pcmrs.testing.waiting import wait_until
from tests.unit.bus.bus_cells import open_bus, snapshot
from tests.unit.ros2.copied_cell import COIL, copied, joints, pose, say_until

CLOCK = SystemClock()


def text_of(payload: bytes) -> str:
    return cdr.decode(payload, cdr.String).data


async def test_state_is_the_snapshot_as_json_also_for_late_subscribers() -> None:
    async with copied() as (cell, ear):
        cell.publish("state/fsm", snapshot(7))
        await wait_until(lambda: "state" in ear.heard)
        told = json.loads(text_of(ear.heard["state"][-1]))
        assert told == msgspec.to_builtins(snapshot(7))
        late = msgspec.structs.replace(cell.settings, mode="client")
        found: list[str] = []
        async with open_bus(late) as bus:
            bus.subscribe_encoded("ros2/state", text_of, lambda _, text: found.append(text))
            await wait_until(lambda: found)
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
