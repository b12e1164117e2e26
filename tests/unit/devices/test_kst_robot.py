"""The KST driver against a scripted cabinet: motion as streams, and what it makes of a cabinet that fails."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.kst import open_devices
from pcmrs.devices.kst import drive
from pcmrs.devices.kst.arm import TorqueForce
from pcmrs.devices.kst.drive import LATE, STALLED
from pcmrs.devices.protocols import OpenDriver, RobotDriver
from pcmrs.errors import (
    ConfigurationError,
    DeviceError,
    DeviceRefusedError,
    MotionInterruptedError,
    UnknownOutcomeError,
)
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, JointSetpoint, JointState, JointTrajectory
from pcmrs.spatial import Floats
from tests.unit.devices.kst_peer import HOME, Peer, line, served

DRIVER: OpenDriver = open_devices  # the type checker proves it
MODEL = ArmModel(ARMS["iiwa14"])
pytestmark = pytest.mark.usefixtures("patient")
START = np.array(HOME)
STEP = 1 / 200


def smooth(start: Floats, goal: Floats, duration: float = 0.4) -> JointTrajectory:
    """Minimum-jerk motion, at rest at both ends."""
    time = np.linspace(0.0, 1.0, 1 + round(duration / STEP))
    way = 10 * time**3 - 15 * time**4 + 6 * time**5
    return JointTrajectory(period=STEP, positions=(start + way[:, None] * (goal - start)).tolist())


@dataclass
class Lab:
    """A robot of the driver and its cabinet."""

    robot: Any
    peer: Peer
    events: list[DeviceEvent] = field(default_factory=list)
    states: list[JointState] = field(default_factory=list)

    async def when(self, condition: Callable[[], bool]) -> None:
        """Returns once something has come about."""
        async with asyncio.timeout(5.0):
            while not condition():  # noqa: ASYNC110 - what is waited for is no business of this loop
                await asyncio.sleep(0.002)

    async def moving(self) -> None:
        """Returns in the middle of a motion."""
        before = len(self.peer.set_points())
        await self.when(lambda: len(self.peer.set_points()) > before + 30)


async def _collect(stream: AsyncIterator[Any], into: list[Any]) -> None:
    async for each in stream:
        into.append(each)


@asynccontextmanager
async def laboratory(peer: Peer | None = None, robot: dict[str, Any] | None = None, **kst: Any) -> AsyncIterator[Lab]:
    peer = peer or Peer()
    async with served(peer) as (host, port):
        settings = {"kst": {"host": host, "port": port, "reply_timeout": 0.2, **kst}, "robot": robot or {}}
        async with open_devices(("robot",), settings, SystemClock()) as devices:
            lab = Lab(devices["robot"], peer)
            tasks = [
                asyncio.create_task(_collect(lab.robot.events(), lab.events)),
                asyncio.create_task(_collect(lab.robot.states(), lab.states)),
            ]
            await asyncio.sleep(0)
            yield lab
            for task in tasks:
                task.cancel()


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


async def test_a_motion_is_a_stream_that_ends_at_its_goal(lab: Lab) -> None:
    result = await lab.robot.follow(smooth(START, START + 0.1))
    assert (result.outcome, result.reason) == ("done", None)
    assert np.allclose(result.positions, START + 0.1, atol=1e-5)
    points = np.array([point for point, _ in lab.peer.set_points()])
    assert np.allclose(points[0], START, atol=1e-3)
    assert np.all(np.diff(points, axis=0) > -1e-5)
    assert np.abs(np.diff(points, axis=0)).max() < 5 * STEP * 0.1 * 1.875 / 0.4, "never in a burst"
    assert not any(line.startswith("doPTP") for line in lab.peer.lines)
    motion = [line.partition("_")[0] for line in lab.peer.lines]
    assert motion.count("startDirectServoJoints") == motion.count("stopDirectServoJoints") == 1
    streamed = motion[motion.index("startDirectServoJoints") + 1 : motion.index("stopDirectServoJoints")]
    assert set(streamed) == {"jf", "jpJP", "jpExT"}
    assert 0.15 < streamed.count("jpJP") / len(streamed) < 0.35
    assert any(each.moving for each in lab.states)
    assert not (await lab.robot.joints()).moving
    assert lab.events == []


async def test_hold_brakes_with_the_next_set_points(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 1.0)))
    await lab.moving()
    sent = len(lab.peer.set_points())
    held = await lab.robot.hold()
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    assert not held.moving
    assert np.allclose(held.positions, result.positions)
    points = np.array([point for point, _ in lab.peer.set_points()])[:, 0]
    steps = np.diff(points)
    fast = int(np.argmax(steps))
    assert fast <= sent + 4, "within 20 ms the set points get slower"
    assert np.all(np.diff(steps[sent + 4 :]) < 2.1e-5), "and slower, to a stop"
    assert points[-1] < START[0] + 0.4


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


async def test_one_reply_is_outstanding_and_an_overdue_one_ends_link(lab: Lab) -> None:
    lab.peer.answers["jpJP"] = None
    with pytest.raises(UnknownOutcomeError, match="did not answer in time"):
        await lab.robot.follow(smooth(START, START + 0.1, 2.0))
    streamed = [line.partition("_")[0] for line in lab.peer.lines]
    streamed = streamed[streamed.index("jpJP") :]
    assert streamed.count("jpJP") == 1
    assert set(streamed) == {"jpJP", "jf"}, "the stream goes on without asking, until the deadline"
    await lab.when(lambda: len(lab.events) == 1)
    assert (lab.events[0].code, lab.events[0].danger) == ("link_lost", True)


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


@pytest.mark.parametrize(("word", "error"), [("nak", DeviceRefusedError), ("interrupted", MotionInterruptedError)])
async def test_a_motion_that_the_cabinet_breaks_off_has_failed(lab: Lab, word: str, error: type[DeviceError]) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
    await lab.moving()
    lab.peer.say(f"{word}\n")
    with pytest.raises(error):
        await following
    assert [(event.code, event.danger) for event in lab.events] == [(error.code, True)]
    state = await lab.robot.hold()
    assert np.all(np.array(state.positions) < START + 0.4)
    here = np.array((await lab.robot.joints()).positions)
    assert (await lab.robot.follow(smooth(here, here + 0.05))).outcome == "done", "the link goes on"


async def test_a_question_of_the_stream_may_be_refused_too(lab: Lab) -> None:
    lab.peer.answers["jpExT"] = "nak\n"
    with pytest.raises(DeviceRefusedError):
        await lab.robot.follow(smooth(START, START + 0.1))
    del lab.peer.answers["jpExT"]
    here = np.array((await lab.robot.joints()).positions)
    assert (await lab.robot.follow(smooth(here, here + 0.05))).outcome == "done"


async def test_arm_that_is_not_where_it_was_sent_is_held(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
    await lab.moving()
    assert lab.events == []
    lab.peer.offset = 0.03
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "pose_differs")
    assert [(event.code, event.danger) for event in lab.events] == [("pose_differs", True)]
    assert np.all(np.array(lab.peer.joints) < START + 0.4)


def torques_of(force_in_flange: Floats, posture: Floats = START) -> Floats:
    """What the joints feel of a force on the flange."""
    force = MODEL.forward(posture).rotation @ force_in_flange
    torques: Floats = MODEL.jacobian(posture).T @ np.concatenate((force, np.zeros(3)))
    return torques


@given(st.lists(st.floats(-0.8, 0.8), min_size=7, max_size=7), st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3))
def test_the_force_is_that_which_the_joints_feel(offsets: list[float], force: list[float]) -> None:
    posture = np.clip(START + offsets, MODEL.lower, MODEL.upper)
    sensor = TorqueForce(MODEL, np.array((0.0, 0.0, -1.0)))
    sensor.update(posture, torques_of(np.array(force), posture))
    weakest = float(np.linalg.svd(MODEL.jacobian(posture), compute_uv=False)[-1])
    error = float(np.linalg.norm(np.subtract(sensor.flange_force, force)))
    assert error <= np.linalg.norm(force) * 1.01e-4 / (1e-4 + weakest**2) * 2 + 1e-9
    assert sensor.magnitude == pytest.approx(float(np.linalg.norm(sensor.flange_force)))


async def test_excessive_force_stops_the_motion_and_is_relieved() -> None:
    async with laboratory(robot={"force_limit": 20.0, "relief_mm": 2.0}) as lab:
        await lab.robot.connect()
        following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.2, 1.0)))
        await lab.moving()
        lab.peer.torques = torques_of(np.array((0.0, 0.0, -30.0)), np.array(lab.peer.joints)).tolist()
        result = await following
        assert (result.outcome, result.reason) == ("stopped", "force_limit")
        (event,) = lab.events
        assert (event.code, event.danger) == ("force_limit", True)
        assert event.fields["force"] == pytest.approx(30.0, rel=0.05)
        assert event.fields["relieved"] == pytest.approx(0.002, abs=1e-4)
        state = await lab.robot.joints()
        assert state.flange_force is not None
        assert state.flange_force[2] < -25.0


async def test_an_arm_that_stands_is_relieved_too() -> None:
    async with laboratory(robot={"force_limit": 20.0, "relief_mm": 1.0}) as lab:
        await lab.robot.connect()
        lab.peer.torques = torques_of(np.array((0.0, 0.0, -30.0))).tolist()
        await lab.when(lambda: len(lab.events) == 1)
        await lab.when(lambda: "stopDirectServoJoints" in lab.peer.lines)
        before, after = (MODEL.forward(q) for q in (START, np.array(lab.peer.joints)))
        way = before.rotation.T @ (after.translation - before.translation)
        assert np.allclose(way, (0.0, 0.0, -0.001), atol=1e-4), "back along the tool's axis"


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


async def test_driver_defect_frees_the_cabinet_for_the_next_connection(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise ValueError("a defect")

    monkeypatch.setattr(lab.robot._drive.arm, "take_joints", fail)
    await lab.when(lambda: lab.peer.lines[-1] == "end")
    assert [(event.code, event.danger) for event in lab.events] == [("link_lost", True)]


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


async def test_delayed_stream_ends_where_the_arm_has_stopped_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drive, "STALLED", STALLED)
    async with laboratory(reply_timeout=2.0) as lab:
        await lab.robot.connect()
        following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.5, 2.0)))
        await lab.moving()
        sent = lab.robot._drive.follower.reference.position.copy()  # the last one, on its way or there
        time.sleep(STALLED + 0.05)  # noqa: ASYNC251 - the process itself hangs
        result = await following
        assert (result.outcome, result.reason) == ("stopped", "stalled")
        assert [(event.code, event.danger) for event in lab.events] == [("stalled", True)]
        points = np.array([point for point, _ in lab.peer.set_points()])
        np.testing.assert_allclose(points[-1], sent, atol=1e-5, err_msg="not one step more")
        assert np.abs(points - START).max() == pytest.approx(np.abs(sent - START).max(), abs=1e-5)


async def test_cabinet_that_rests_later_than_its_arm_is_waited_for(lab: Lab) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.1)))
    await lab.moving()
    lab.peer.answers["Torques_ext_J"] = None  # its thread is busy with the stream
    await lab.when(lambda: lab.peer.lines[-1] == "Torques_ext_J")
    await asyncio.sleep(0.3)
    lab.peer.say(line(lab.peer.torques))
    del lab.peer.answers["Torques_ext_J"]
    assert (await following).outcome == "done"
    assert lab.events == []


class SwingingPeer(Peer):
    """Its arm swings about where it was told to be."""

    def _answer(self, command: str) -> str | None:
        self.offset = -self.offset
        return super()._answer(command)


async def test_arm_that_does_not_come_to_rest_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive, "UNSETTLED", 0.5)
    async with laboratory(SwingingPeer()) as lab:
        await lab.robot.connect()
        lab.peer.offset = 0.001
        with pytest.raises(DeviceError, match="does not stand still"):
            await lab.robot.follow(smooth(START, START + 0.05))


async def test_a_motion_waits_for_a_cabinet_that_is_late() -> None:
    async with laboratory(reply_timeout=2.0) as lab:
        await lab.robot.connect()
        following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.2, 1.0)))
        await lab.moving()
        owed = await be_silent(lab)
        waiting = np.array(lab.peer.joints)
        assert waiting.max() - START.max() < 0.19, "the motion does not go on without the arm"
        await asyncio.sleep(0.1)
        assert np.array_equal(lab.peer.joints, waiting)
        lab.peer.answers.clear()
        lab.peer.say(line(list(waiting)) if owed == "jpJP" else line([0.0] * 7))
        assert (await following).outcome == "done"
        assert np.allclose(lab.peer.joints, START + 0.2, atol=1e-5)
        assert lab.events == []


async def test_hold_does_not_wait_for_a_cabinet_that_is_late() -> None:
    async with laboratory(reply_timeout=2.0) as lab:
        await lab.robot.connect()
        following = asyncio.create_task(lab.robot.follow(smooth(START, START + 0.2, 1.0)))
        await lab.moving()
        await be_silent(lab)
        sent = len(lab.peer.set_points())
        holding = asyncio.create_task(lab.robot.hold())
        await lab.when(lambda: len(lab.peer.set_points()) > sent + 5)
        lab.peer.close()
        for ended in (following, holding):
            with pytest.raises(UnknownOutcomeError):
                await ended


async def be_silent(lab: Lab) -> str:
    """The cabinet answers nothing any more; returns once no set point comes, with what it still owes a reply."""
    lab.peer.answers |= {"jpJP": None, "jpExT": None}
    heard = -1
    while len(lab.peer.heard) > heard:
        heard = len(lab.peer.heard)
        await asyncio.sleep(2 * LATE)
    return next(name for text in reversed(lab.peer.lines) if (name := text.partition("_")[0]) in lab.peer.answers)
