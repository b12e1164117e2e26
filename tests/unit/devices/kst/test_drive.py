"""The stream to the arm: its pace, its end, and an arm or a cabinet that is late."""

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest

from pcmrs.devices.kst import drive
from pcmrs.devices.kst.drive import LATE, STALLED
from pcmrs.errors import (
    DeviceError,
    DeviceRefusedError,
    MotionInterruptedError,
    UnknownOutcomeError,
)
from tests.unit.devices.kst_lab import STEP, Lab, laboratory, smooth
from tests.unit.devices.kst_peer import MODEL, START, Peer, line, torques_of

pytestmark = pytest.mark.usefixtures("patient")


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    async with laboratory() as lab:
        await lab.robot.connect()
        yield lab


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


async def test_driver_defect_frees_the_cabinet_for_the_next_connection(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise ValueError("a defect")

    monkeypatch.setattr(lab.robot._drive.arm, "take_joints", fail)
    await lab.when(lambda: lab.peer.lines[-1] == "end")
    assert [(event.code, event.danger) for event in lab.events] == [("link_lost", True)]


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
