"""Fake devices: they are whole devices, and fail and report as a test demands."""

from __future__ import annotations

import pytest

from pcmrs.devices.opening import check_conformity
from pcmrs.errors import DeviceError
from pcmrs.messages import BodyPose, DeviceEvent, JointTrajectory, LandmarkPrompt, PressRequest
from pcmrs.testing.devices import (
    END,
    EPOCH,
    SESSION,
    STATE,
    FakeEmg,
    FakeHand,
    FakeRobot,
    FakeStimulator,
    FakeTracker,
)

PRESS = PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.01, speed=0.01, timeout=5.0)


@pytest.mark.parametrize(
    ("name", "fake"),
    [
        ("robot", FakeRobot()),
        ("tracker", FakeTracker()),
        ("pointer", FakeHand()),
        ("scene", FakeHand()),
        ("stimulator", FakeStimulator()),
        ("emg", FakeEmg()),
    ],
)
def test_a_fake_is_a_whole_device(name: str, fake: object) -> None:
    """A node refuses a driver with less."""
    check_conformity("fake", {name: fake})


async def test_a_robot_records_its_motions_in_order() -> None:
    robot = FakeRobot()
    ways = [JointTrajectory(period=0.01, positions=[[0.0] * 7, [goal] * 7]) for goal in (0.1, 0.2)]
    assert [(await robot.follow(way)).positions for way in ways] == [[0.1] * 7, [0.2] * 7]
    await robot.press(PRESS)
    assert (robot.followed, robot.pressed) == (ways, [PRESS])


async def test_robot_records_the_set_points_of_a_servo_block() -> None:
    robot = FakeRobot()
    async with robot.servo() as stream:
        stream.send([0.2] * 7, [0.0] * 7)
    first, last = robot.setpoints
    assert (first.session, first.number, first.positions) == (SESSION, 1, [0.2] * 7)
    assert last is END


async def test_a_robot_has_one_session_and_marks_its_end() -> None:
    robot = FakeRobot()
    assert (await robot.begin_servo()).session == SESSION
    with pytest.raises(DeviceError, match="There is no session 5") as error:
        await robot.end_servo(SESSION + 1)
    assert error.value.fields["session"] == SESSION + 1
    assert robot.setpoints == []
    assert await robot.end_servo(SESSION) == robot.servo_end
    assert robot.setpoints == [END]


async def test_a_failing_robot_still_counts_its_holds() -> None:
    robot = FakeRobot()
    robot.error = DeviceError("The brakes are worn.")
    for call in (robot.connect, robot.hold, lambda: robot.end_servo(SESSION)):
        with pytest.raises(DeviceError, match="worn"):
            await call()
    assert robot.holds == 1
    assert await robot.joints() == STATE


async def test_streams_publish_what_the_test_puts_in_order() -> None:
    robot, tracker, stimulator = FakeRobot(), FakeTracker(), FakeStimulator()
    frame = [BodyPose(body="coil", frame_number=1, captured=0.0, sent=0.0, valid=True)]
    events = [DeviceEvent(device="robot", code=code, text=code) for code in ("a", "b")]
    robot.stream.put_nowait(STATE)
    tracker.stream.put_nowait(frame)
    for event in events:
        robot.reports.put_nowait(event)
        stimulator.reports.put_nowait(event)
    assert await anext(robot.states()) == STATE
    assert await anext(tracker.frames()) == frame
    for reported in (robot.events(), stimulator.events()):
        assert [await anext(reported), await anext(reported)] == events


async def test_a_hand_records_who_asked_for_what() -> None:
    hand = FakeHand()
    prompt = LandmarkPrompt(index=2, name="nasion", position_in_image=(0.0, 0.1, 0.2))
    await hand.touch(prompt)
    await hand.touch_surface()
    await hand.displace_touch(2, (0.0, 0.0, 0.01))
    assert hand.calls == [prompt, "surface", (2, (0.0, 0.0, 0.01))]


async def test_a_stimulator_keeps_its_intensity_and_counts_disarms() -> None:
    stimulator = FakeStimulator()
    await stimulator.set_intensity(62.0)
    assert (await stimulator.arm()).armed
    fired = await stimulator.fire(3)
    assert (fired.number, fired.intensity) == (3, 62.0)
    state = await stimulator.disarm()
    assert (state.armed, state.pulse, stimulator.disarms) == (False, 3, 1)


async def test_only_pulse_1_has_an_epoch() -> None:
    assert await FakeEmg().epoch(1, 0.1, 0.1) == EPOCH
    with pytest.raises(DeviceError, match="No marker of pulse 2") as error:
        await FakeEmg().epoch(2, 0.1, 0.1)
    assert error.value.fields["pulse"] == 2
