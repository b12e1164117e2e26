"""The KST driver against a scripted cabinet: connections, motions, sessions, and configuration."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.kst import open_devices
from pcmrs.devices.protocols import OpenDriver, RobotDriver
from pcmrs.errors import (
    ConfigurationError,
    DeviceError,
    DeviceRefusedError,
    UnknownOutcomeError,
)
from pcmrs.messages import JointSetpoint
from pcmrs.spatial import Floats
from tests.unit.devices.kst_lab import Lab, laboratory, smooth
from tests.unit.devices.kst_peer import HOME, START, Peer, line, served

DRIVER: OpenDriver = open_devices  # the type checker proves it

pytestmark = pytest.mark.usefixtures("patient")


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    async with laboratory() as lab:
        await lab.robot.connect()
        yield lab


async def test_a_cabinet_that_is_absent_at_the_start_is_no_obstacle() -> None:
    async with served(Peer()) as (host, port):
        pass
    async with open_devices(("robot",), {"kst": {"host": host, "port": port}}, SystemClock()) as devices:
        robot: RobotDriver = devices["robot"]
        with pytest.raises(DeviceError, match="start the KST application"):
            await robot.connect()
        for call in (robot.joints, robot.hold, robot.begin_servo, lambda: robot.follow(smooth(START, START + 0.1))):
            with pytest.raises(DeviceError, match="not connected"):
                await call()
        await robot.disconnect()


async def test_silent_cabinet_may_have_another_client() -> None:
    peer = Peer()
    peer.answers["getJointsPositions"] = None
    async with laboratory(peer) as lab:
        with pytest.raises(
            UnknownOutcomeError, match=r"did not answer in time.*accepts several clients.*answers only one"
        ):
            await lab.robot.connect()
        with pytest.raises(DeviceError, match="not connected"):
            await lab.robot.joints()
        peer.answers["getJointsPositions"] = "garbage\n"
        with pytest.raises(UnknownOutcomeError, match="make sure that no other is connected"):
            await lab.robot.connect()
        peer.answers["getJointsPositions"] = "nak\n"
        with pytest.raises(DeviceRefusedError) as refused:
            await lab.robot.connect()
        assert "clients" not in refused.value.text, "it has answered us"


async def test_an_arm_that_tells_nothing_says_why(lab: Lab) -> None:
    assert lab.robot.trouble == ""
    await lose(lab, "closed")
    await lab.when(lambda: len(lab.events) == 1)
    assert lab.robot.trouble == lab.events[0].text
    assert "connect again" in lab.robot.trouble
    await lab.robot.connect()
    assert lab.robot.trouble == ""
    await lab.robot.disconnect()
    assert lab.robot.trouble == "The robot is not connected; connect it first."


async def test_a_connected_arm_tells_its_joints_by_itself(lab: Lab) -> None:
    state = await lab.robot.connect()
    assert np.allclose(state.positions, START)
    await lab.when(lambda: len(lab.states) >= 5)
    assert lab.peer.clients == 1
    assert not any(each.moving for each in lab.states)
    assert all(each.captured <= each.sent for each in lab.states)
    assert np.all(np.diff([each.captured for each in lab.states]) > 0.0)


@pytest.mark.parametrize("method", ["hold", "joints", "connect"])
async def test_joints_asked_for_before_a_call_do_not_answer_it(method: str) -> None:
    async with laboratory(reply_timeout=2.0) as lab:
        await lab.robot.connect()
        lab.peer.answers["getJointsPositions"] = None
        await lab.when(lambda: lab.peer.lines[-1] == "getJointsPositions")
        calling = asyncio.create_task(getattr(lab.robot, method)())
        await asyncio.sleep(0)
        lab.peer.say(line(list(START)))
        del lab.peer.answers["getJointsPositions"]
        lab.peer.joints = list(START + 0.001)
        assert np.allclose((await calling).positions, START + 0.001, atol=1e-6)


async def test_a_motion_nobody_waits_for_any_more_is_braked(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 1.0)))
    await lab.moving()
    following.cancel()
    await lab.when(lambda: "stopDirectServoJoints" in lab.peer.lines)
    assert np.all(np.array(lab.peer.joints) < START + 0.4)
    await lab.when(lambda: not lab.states[-1].moving)
    here = np.array((await lab.robot.joints()).positions)
    assert (await lab.robot.follow(smooth(here, here - 0.05))).outcome == "done"


async def test_one_motion_at_a_time(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.1)))
    await lab.moving()
    for call in (lambda: lab.robot.follow(smooth(START, START)), lab.robot.begin_servo):
        with pytest.raises(DeviceError, match="still moving"):
            await call()
    assert (await following).outcome == "done"


async def test_a_motion_that_starts_elsewhere_is_refused(lab: Lab) -> None:
    with pytest.raises(DeviceError, match="plan it again from the present joints"):
        await lab.robot.follow(smooth(START + 0.1, START + 0.2))
    assert lab.peer.set_points() == []


def point(number: int, positions: Floats, session: int) -> JointSetpoint:
    return JointSetpoint(
        session=session, number=number, sent=0.0, positions=positions.tolist(), velocities=[0.0] * len(positions)
    )


async def test_session_follows_its_set_points_and_brakes_without_them(lab: Lab) -> None:
    session = (await lab.robot.begin_servo()).session
    lab.robot.set_point(point(1, START + 0.02, session))
    lab.robot.set_point(point(1, START + 0.1, session))
    lab.robot.set_point(point(2, START + 0.1, session - 1))
    assert lab.robot.sessions.dropped == 2
    await lab.when(lambda: len(lab.events) > 0)
    assert [(event.code, event.fields["reason"]) for event in lab.events] == [("servo_held", "no_set_point")]
    result = await lab.robot.end_servo(session)
    assert (result.outcome, result.reason) == ("stopped", "no_set_point")
    assert np.all(np.array(result.positions) < START + 0.03)
    with pytest.raises(DeviceError, match="is over"):
        await lab.robot.end_servo(session)


async def lose(lab: Lab, how: str) -> None:
    if how == "silent":
        lab.peer.answers |= dict.fromkeys(("jpJP", "jpExT", "getJointsPositions", "Torques_ext_J"))
    elif how == "garbage":
        lab.peer.say("???\n")
    else:
        lab.peer.close()


@pytest.mark.parametrize("how", ["silent", "closed", "garbage"])
@pytest.mark.parametrize("when", ["standing", "moving"])
async def test_a_lost_link_is_a_danger_and_has_an_unknown_outcome(lab: Lab, how: str, when: str) -> None:
    following = None
    if when == "moving":
        following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
        await lab.moving()
    await lose(lab, how)
    await lab.when(lambda: len(lab.events) == 1)
    assert (lab.events[0].code, lab.events[0].danger) == ("link_lost", True)
    if following is not None:
        with pytest.raises(UnknownOutcomeError, match="Look at the arm"):
            await following
    for call in (lab.robot.joints, lab.robot.hold, lab.robot.begin_servo):
        with pytest.raises(UnknownOutcomeError, match="connect again"):
            await call()
    heard, told = len(lab.peer.heard), len(lab.states)
    await asyncio.sleep(0.1)
    assert len(lab.peer.heard) == heard, "nothing is sent any more"
    assert len(lab.states) == told, "nothing is told any more"


async def test_after_a_reconnection_the_arm_starts_from_where_it_is(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
    await lab.moving()
    lab.peer.close()
    with pytest.raises(UnknownOutcomeError):
        await following
    lab.peer.joints = (START - 0.3).tolist()  # moved by hand
    heard = len(lab.peer.heard)
    state = await lab.robot.connect()
    assert lab.peer.clients == 2
    assert np.allclose(state.positions, START - 0.3)
    await lab.when(lambda: len(lab.peer.heard) > heard + 4)
    assert not any(line.startswith("j") for line in lab.peer.lines[heard:]), "nothing of the old motion is sent"
    with pytest.raises(DeviceError, match="plan it again"):
        await lab.robot.follow(smooth(START, START + 0.1))
    assert (await lab.robot.follow(smooth(START - 0.3, START - 0.2))).outcome == "done"


async def test_a_cabinet_that_refuses_a_motion_stays_connected(lab: Lab) -> None:
    lab.peer.answers["startDirectServoJoints"] = "nak\n"
    with pytest.raises(DeviceRefusedError, match="smartPAD"):
        await lab.robot.follow(smooth(START, START + 0.1))
    with pytest.raises(DeviceRefusedError):
        await lab.robot.begin_servo()
    assert lab.peer.set_points() == []
    del lab.peer.answers["startDirectServoJoints"]
    assert (await lab.robot.follow(smooth(START, START + 0.1))).outcome == "done"


async def test_disconnection_brakes_and_ends_the_application(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
    await lab.moving()
    await lab.robot.disconnect()
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    await lab.when(lambda: lab.peer.lines[-1] == "end")
    assert "stopDirectServoJoints" in lab.peer.lines
    with pytest.raises(DeviceError, match="not connected"):
        await lab.robot.joints()
    assert lab.events == []


async def test_connection_requested_while_braking_waits_for_standstill(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
    await lab.moving()
    disconnecting = asyncio.create_task(lab.robot.disconnect())
    await asyncio.sleep(0)
    await lab.robot.connect()
    await disconnecting
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    assert lab.peer.lines.index("stopDirectServoJoints") < lab.peer.lines.index("end")
    assert lab.peer.clients == 2


async def test_a_disconnection_during_a_connection_is_the_last_word() -> None:
    async with laboratory() as lab:
        connecting = asyncio.create_task(lab.robot.connect())
        await asyncio.sleep(0)
        await lab.robot.disconnect()
        await connecting
        with pytest.raises(DeviceError, match="not connected"):
            await lab.robot.joints()


async def test_impedance_is_asked_for_as_configured() -> None:
    async with laboratory(mode="impedance", impedance={"tool_mass": 0.5}) as lab:
        await lab.robot.connect()
        assert (await lab.robot.follow(smooth(START, START + 0.05, 0.2))).outcome == "done"
        lines = lab.peer.lines
    start = next(at for at, line in enumerate(lines) if line.startswith("startSmartImpedneceJoints_0.50000_"))
    assert [float(word) for word in lines[start - 1].split("_")[1:8]] == pytest.approx(HOME, abs=1e-5)
    assert "startDirectServoJoints" not in lines


@pytest.mark.parametrize(
    ("devices", "settings", "text"),
    [
        (("tracker",), {}, "robot"),
        (("robot",), {"kst": {"rate_hz": 100.0}}, "rate_hz"),
        (("robot",), {"kst": {"tool_axis": [0.0, 0.0, 2.0]}}, "unit vector"),
        (("robot",), {"kst": {"hots": "x"}}, "hots"),
        (("robot",), {"robot": {"model": "ur5"}}, "joints"),
        (("robot",), {"robot": {"force_limit": -1.0}}, "robot"),
    ],
)
async def test_a_wrong_configuration_is_named(devices: tuple[str, ...], settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with open_devices(devices, settings, SystemClock()):
            pass


async def test_a_session_does_not_outlive_its_connection(lab: Lab) -> None:
    session = (await lab.robot.begin_servo()).session
    lab.peer.close()
    await lab.when(lambda: len(lab.events) == 1)
    await lab.robot.connect()
    lab.robot.set_point(point(1, START + 0.1, session))
    assert lab.robot.sessions.dropped == 1
    with pytest.raises(DeviceError, match="is over"):
        await lab.robot.end_servo(session)
