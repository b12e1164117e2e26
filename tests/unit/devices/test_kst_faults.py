"""The KST driver's answer to what goes wrong at the virtual cabinet: the rows B of the fault catalogue."""

import asyncio
from typing import Any

import numpy as np
import pytest

from pcmrs.devices.node import DeviceNode
from pcmrs.devices.remote import RemoteRobot
from pcmrs.errors import DeviceError, DeviceRefusedError, MotionInterruptedError, UnknownOutcomeError
from pcmrs.messages import MotionResult
from tests.support.memory_link import MemoryLink
from tests.unit.devices.contract_robots import HOME, Bench, smooth

pytestmark = [pytest.mark.usefixtures("patient"), pytest.mark.asyncio(loop_scope="module")]


async def under_way(lab: Bench) -> "asyncio.Task[MotionResult]":
    """A slow motion, in its middle."""
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.4, 5.0)))
    await lab.moving()
    return following


async def inject(lab: Bench, fault: str, **arguments: Any) -> None:
    await lab.cell.devices["scene"].inject(fault, arguments)  # type: ignore[union-attr]


async def stands(lab: Bench) -> None:
    """The arm truly stands, on its way."""
    async with asyncio.timeout(5.0):
        while np.abs(lab.cell.world.arm.velocities).max() > 1e-3:
            await lab.clock.sleep(0.02)
    assert np.all(lab.cell.world.arm.positions < HOME + 0.35)


@pytest.mark.parametrize(
    ("fault", "arguments"), [("cut_robot", {"on": True}), ("silence_robot", {"on": True}), ("drop_client", {})]
)
async def test_a_link_that_fails_in_motion(lab: Bench, fault: str, arguments: dict[str, Any]) -> None:
    following = await under_way(lab)
    await inject(lab, fault, **arguments)
    with pytest.raises(UnknownOutcomeError, match="Look at the arm"):
        await following
    event = await lab.told("link_lost")
    assert event.danger
    await stands(lab)
    with pytest.raises(UnknownOutcomeError):
        await lab.robot.joints()
    await inject(lab, fault, **dict.fromkeys(arguments, False))
    await lab.clock.sleep(0.5)
    with pytest.raises(UnknownOutcomeError, match="connect again"):
        await lab.robot.follow(smooth(HOME, HOME))
    state = await lab.robot.connect()
    assert np.allclose(state.positions, lab.cell.world.arm.positions, atol=1e-3)
    assert (await lab.robot.follow(smooth(np.array(state.positions), HOME))).outcome == "done"


async def test_a_cabinet_that_has_gone_silent_confirms_no_hold(lab: Bench) -> None:
    await inject(lab, "silence_robot", on=True)
    with pytest.raises(UnknownOutcomeError):
        await lab.robot.hold()
    await inject(lab, "silence_robot", on=False)
    await lab.told("link_lost")
    await lab.robot.connect()


async def test_a_cabinet_that_has_gone_silent_is_not_released(lab: Bench) -> None:
    link = MemoryLink()
    serving = asyncio.create_task(DeviceNode(link, {"robot": lab.robot}, lab.clock).run())
    await asyncio.sleep(0)
    robot = RemoteRobot(link, lab.clock)
    await robot.stop()
    await inject(lab, "silence_robot", on=True)
    with pytest.raises(UnknownOutcomeError):
        await robot.release_latch()
    robot.take(link.published["dev/robot/beat"][-1].gate)
    assert robot.latched
    await inject(lab, "silence_robot", on=False)
    await lab.told("link_lost")
    await lab.robot.connect()
    await robot.joints()  # the lost link has raised the epoch
    await robot.release_latch()
    assert not robot.latched
    serving.cancel()


async def test_an_interrupted_motion_has_failed(lab: Bench) -> None:
    following = await under_way(lab)
    await inject(lab, "interrupt")
    with pytest.raises(MotionInterruptedError):
        await following
    assert (await lab.told("motion_interrupted")).danger
    await stands(lab)


@pytest.mark.parametrize("how", ["split", "merged", "mixed"])
async def test_split_and_merged_replies_are_no_matter(lab: Bench, how: str) -> None:
    await inject(lab, "frame_replies", how=how)
    assert (await lab.robot.follow(smooth(HOME, HOME + 0.1))).outcome == "done"
    assert lab.events == []
    await inject(lab, "frame_replies", how="whole")


@pytest.mark.parametrize("fault", ["e_stop", "change_mode", "close_brakes"])
async def test_drives_that_go_off_end_the_motion(lab: Bench, fault: str) -> None:
    following = await under_way(lab)
    await inject(lab, fault, on=True)
    with pytest.raises(DeviceRefusedError, match="smartPAD"):
        await following
    assert (await lab.told("device_refused")).danger
    await stands(lab)
    await lab.clock.sleep(0.1)
    here = np.array((await lab.robot.joints()).positions)
    with pytest.raises(DeviceRefusedError):
        await lab.robot.follow(smooth(here, HOME))
    await inject(lab, fault, on=False)
    assert (await lab.robot.follow(smooth(here, HOME))).outcome == "done"


async def test_a_joint_beside_what_is_commanded_holds_the_arm(lab: Bench) -> None:
    following = await under_way(lab)
    await inject(lab, "offset_joint", joint=3, angle=0.05)
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "pose_differs")
    assert (await lab.told("pose_differs")).danger
    await stands(lab)
    await inject(lab, "offset_joint", joint=3, angle=0.0)
    await lab.clock.sleep(0.5)


async def test_an_arm_that_was_moved_by_hand_starts_from_there(lab: Bench) -> None:
    await inject(lab, "drop_client")
    await lab.told("link_lost")
    await inject(lab, "guide_by_hand", joint=1, angle=0.2)
    await lab.clock.sleep(2.0)
    state = await lab.robot.connect()
    assert state.positions[0] == pytest.approx(HOME[0] + 0.2, abs=1e-3)
    with pytest.raises(DeviceError, match="plan it again"):
        await lab.robot.follow(smooth(HOME, HOME + 0.1))
    assert (await lab.robot.follow(smooth(np.array(state.positions), HOME))).outcome == "done"


async def test_a_collision_stops_the_motion(lab: Bench) -> None:
    following = await under_way(lab)
    await inject(lab, "push_tool", force=40.0)
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    event = await lab.told("force_limit")
    assert event.danger
    assert event.fields["force"] > 25.0
    await inject(lab, "push_tool", force=0.0)
    await stands(lab)
