"""The same faults at every robot driver: the simulated arm itself, and the KST driver over the virtual cabinet."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import DeviceError, DeviceRefusedError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import MotionResult
from tests.unit.devices.contract_robots import HOME, LOOP_OF_DRIVER, Bench, smooth

pytestmark = [pytest.mark.usefixtures("patient"), pytest.mark.asyncio(loop_scope="module")]
LOOPS, NIGHTLY_LOOPS = LOOP_OF_DRIVER, ("kst",)
NEVER_LATER = 20.0
"""Everything has an answer within this, s."""


async def inject(lab: Bench, fault: str, **arguments: Any) -> None:
    await lab.cell.devices["scene"].inject(fault, arguments)  # type: ignore[union-attr]


async def ended(lab: Bench, fault: str, **arguments: Any) -> MotionResult | PcmrsError:
    """How a slow motion ends when a fault comes about in its middle; the arm stands then, on its way."""
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.4, 6.0)))
    await lab.moving()
    await inject(lab, fault, **arguments)
    result: MotionResult | PcmrsError
    try:
        async with asyncio.timeout(NEVER_LATER):
            result = await following
    except PcmrsError as error:
        result = error
    async with asyncio.timeout(NEVER_LATER):
        while np.abs(lab.cell.world.arm.velocities).max() > 1e-3:
            await lab.clock.sleep(0.02)
    assert np.all(lab.cell.world.arm.positions < HOME + 0.38)
    return result


async def goes_on(lab: Bench) -> None:
    """The arm moves again, from where it is."""
    here = np.array((await lab.robot.connect()).positions)
    assert (await lab.robot.follow(smooth(here, HOME, 2.0))).outcome == "done"


@pytest.mark.parametrize("fault", ["cut_robot", "drop_client"])
async def test_a_link_that_ends_in_motion(lab: Bench, fault: str) -> None:
    begin: dict[str, Any] = {"on": True} if fault == "cut_robot" else {}
    assert isinstance(await ended(lab, fault, **begin), UnknownOutcomeError)
    with pytest.raises(PcmrsError, match=r"not connected|not answer|lost"):
        await lab.robot.follow(smooth(HOME, HOME))
    await inject(lab, fault, **dict.fromkeys(begin, False))
    await lab.clock.sleep(0.5)
    await goes_on(lab)


async def test_failed_application_is_reported_and_disconnects(lab: Bench) -> None:
    await inject(lab, "drop_client")
    event = await lab.told("link_lost")
    assert event.danger
    for call in (lab.robot.joints, lab.robot.begin_servo):
        with pytest.raises((DeviceError, UnknownOutcomeError)):
            await call()
    await goes_on(lab)


async def test_a_robot_that_never_answers(lab: Bench) -> None:
    await inject(lab, "silence_robot", on=True)
    for call in (lab.robot.joints, lab.robot.hold):
        async with asyncio.timeout(NEVER_LATER):
            await lab.clock.sleep(2.0)
            with pytest.raises(UnknownOutcomeError):
                await call()
    await inject(lab, "silence_robot", on=False)
    await lab.clock.sleep(0.5)
    await goes_on(lab)


async def test_a_motion_that_is_interrupted_has_not_been_done(lab: Bench) -> None:
    result = await ended(lab, "interrupt")
    if isinstance(result, MotionResult):
        assert (result.outcome, result.reason) == ("stopped", "interrupted")
    else:
        assert result.code == "motion_interrupted"
    await goes_on(lab)


@pytest.mark.parametrize("fault", ["e_stop", "change_mode", "close_brakes"])
async def test_without_drives_the_motion_ends_and_none_begins(lab: Bench, fault: str) -> None:
    result = await ended(lab, fault, on=True)
    assert isinstance(result, DeviceError) or result.outcome == "stopped"  # type: ignore[union-attr]
    async with asyncio.timeout(NEVER_LATER):
        while not any(event.danger for event in lab.events):
            await lab.clock.sleep(0.02)
    await lab.clock.sleep(0.1)
    here = np.array((await lab.robot.joints()).positions)
    with pytest.raises(DeviceError):
        await lab.robot.follow(smooth(here, HOME, 2.0))
    await inject(lab, fault, on=False)
    await goes_on(lab)


@pytest.mark.parametrize(
    ("fault", "begin", "end", "reason"),
    [
        ("offset_joint", {"joint": 3, "angle": 0.05}, {"joint": 3, "angle": 0.0}, "pose_differs"),
        ("push_tool", {"force": 40.0}, {"force": 0.0}, "force_limit"),
    ],
)
async def test_deviation_or_excess_force_is_braked_with_an_alarm(
    lab: Bench, fault: str, begin: dict[str, Any], end: dict[str, Any], reason: str
) -> None:
    result = await ended(lab, fault, **begin)
    assert isinstance(result, MotionResult)
    assert (result.outcome, result.reason) == ("stopped", reason)
    assert (await lab.told(reason)).danger
    await inject(lab, fault, **end)
    await lab.clock.sleep(1.0)
    await goes_on(lab)


async def test_after_a_refused_connection_nobody_is_connected(lab: Bench) -> None:
    await lab.robot.disconnect()
    await inject(lab, "refuse_robot", on=True)
    for _ in range(2):
        with pytest.raises(DeviceRefusedError):
            await lab.robot.connect()
    with pytest.raises(DeviceError, match="not connected"):
        await lab.robot.joints()
    await inject(lab, "refuse_robot", on=False)
    await goes_on(lab)


async def test_a_set_point_of_an_earlier_connection_moves_nothing(lab: Bench) -> None:
    with suppress(DeviceError):  # of a session that the deadman ends on a busy machine
        async with lab.robot.servo() as stream:
            stream.send(HOME + 0.005, [0.0] * 7)
            await lab.clock.sleep(0.05)
    lab.events.clear()
    await inject(lab, "late_set_point", on=True)
    await inject(lab, "drop_client")
    await lab.told("link_lost")
    await inject(lab, "guide_by_hand", joint=1, angle=0.2)
    await lab.clock.sleep(2.5)
    state = await lab.robot.connect()
    await lab.clock.sleep(1.0)
    assert np.allclose((await lab.robot.joints()).positions, state.positions, atol=1e-3)
    assert lab.cell.world.arm.positions[0] > HOME[0] + 0.19, "it stays where it was brought by hand"
    await inject(lab, "late_set_point", on=False)


async def test_command_that_arrives_twice_moves_the_arm_once(lab: Bench) -> None:
    """A cabinet that answers twice is not trusted any more; set points that repeat themselves are dropped."""
    await inject(lab, "double_commands", on=True)
    with suppress(UnknownOutcomeError):
        assert (await lab.robot.follow(smooth(HOME, HOME + 0.1, 1.0))).outcome == "done"
    await lab.clock.sleep(1.0)
    positions = lab.cell.world.arm.positions
    assert np.all(positions < HOME + 0.1 + 1e-3)
    await inject(lab, "double_commands", on=False)
    await goes_on(lab)
