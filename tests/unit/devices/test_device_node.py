"""A device behind its node: typed calls both ways, and the node's own hold."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import msgspec
import pytest

from pcmrs.devices.deadman import DEADMAN, DELIVERY, HELD_UP, TURN, beat_period
from pcmrs.devices.gate import LATCHED
from pcmrs.devices.node import DAEMON_BEAT, REQUEST_DELAY, DeviceNode
from pcmrs.devices.remote import ANSWER_TIME, MOTION_MARGIN, RemotePointer, RemoteRobot, RemoteScene
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import (
    Beat,
    BodyPose,
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    GateState,
    HeadBurst,
    HeadMotion,
    JointSetpoint,
    JointState,
    JointTrajectory,
    LandmarkPrompt,
    MotionResult,
    PressRequest,
)
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.testing.devices import END, STATE, FakeHand, FakeRobot, FakeTracker
from pcmrs.threads import Load
from tests.support.memory_link import MemoryLink

BEAT_PERIOD = beat_period(DEADMAN)

TRAJECTORY = JointTrajectory(period=0.005, positions=[[0.0] * 7, [0.1] * 7])


class FakeScheduling:
    """A machine that serves the node, unless told otherwise."""

    def __init__(self) -> None:
        self.waits = 0.0
        self.busy = False

    def waited(self) -> float:
        return self.waits

    def pending(self) -> bool:
        return self.busy

    def load(self) -> Load:
        return Load(running=9, processors=2)


class Bench:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.link = MemoryLink()
        self.robot_device, self.tracker, self.hand = FakeRobot(), FakeTracker(), FakeHand()
        devices = {"robot": self.robot_device, "tracker": self.tracker, "pointer": self.hand, "scene": self.hand}
        self.scheduling = FakeScheduling()
        self.node = DeviceNode(self.link, devices, self.clock, DEADMAN, self.scheduling)
        self.robot = RemoteRobot(self.link, self.clock, "a")
        self.pointer = RemotePointer(self.link, self.clock, 30.0, "a")
        self.scene = RemoteScene(self.link, self.clock)

    async def raw(self, device: str, method: str, **arguments: Any) -> DeviceReply:
        request = DeviceRequest(method=method, arguments=arguments, token=self.robot.token())
        return await self.link.request(f"dev/{device}/cmd", request, DeviceReply, 1.0)


@asynccontextmanager
async def _open_bench() -> AsyncIterator[Bench]:
    bench = Bench()
    serving = asyncio.create_task(bench.node.run())
    await settle()
    await bench.robot.joints()
    await bench.robot.release_latch()
    yield bench
    serving.cancel()
    with suppress(asyncio.CancelledError):
        await serving


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with _open_bench() as opened:
        yield opened


async def test_calls_and_results_keep_their_types(bench: Bench) -> None:
    assert await bench.robot.connect() == STATE
    await bench.robot.disconnect()
    result = await bench.robot.follow(TRAJECTORY)
    assert result == MotionResult(outcome="done", positions=[0.1] * 7)
    assert bench.robot_device.followed == [TRAJECTORY]
    prompt = LandmarkPrompt(index=2, name="nasion", position_in_image=(0.0, 0.1, 0.2))
    await bench.pointer.touch(prompt)
    await bench.scene.displace_touch(3, (0.01, 0.0, 0.0))
    assert bench.hand.calls == ["release", prompt, (3, (0.01, 0.0, 0.0))], "it acts for who has held it last"


class SlowLink(MemoryLink):
    """Its one reply comes when the test says so."""

    def __init__(self) -> None:
        super().__init__()
        self.reply: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

    async def request(self, *_: Any, **__: Any) -> Any:
        return await self.reply


async def test_an_arm_that_moves_is_not_released(bench: Bench) -> None:
    await bench.robot.stop()
    bench.robot_device.state = msgspec.structs.replace(STATE, moving=True)
    with pytest.raises(DeviceError, match="still moves") as refused:
        await bench.robot.release_latch()
    assert refused.value.fields["code"] == "moving"
    assert bench.robot.latched
    with pytest.raises(DeviceError) as refused:
        await bench.robot.follow(TRAJECTORY)
    assert refused.value.fields["code"] == LATCHED
    assert bench.robot_device.followed == []
    bench.robot_device.state = STATE
    await bench.robot.release_latch()
    await bench.robot.follow(TRAJECTORY)
    assert bench.robot_device.followed == [TRAJECTORY]


async def test_device_that_was_never_heard_gets_no_request_or_release(bench: Bench) -> None:
    """No request is sent to it and nobody releases its latch."""
    unheard = RemoteRobot(bench.link, bench.clock, "a")
    await bench.robot.stop()
    for ask in (lambda: unheard.follow(TRAJECTORY), unheard.begin_servo, unheard.release_latch):
        with pytest.raises(DeviceError, match="has not reported yet: wait for it, then ask again"):
            await ask()
    assert unheard.unreleased is None
    await bench.robot.joints()
    assert bench.robot.latched
    assert bench.robot_device.followed == []


@pytest.mark.parametrize("method", ["stop", "joints"])
async def test_late_reply_of_an_ended_node_does_not_hide_its_successor(method: str) -> None:
    link = SlowLink()
    robot = RemoteRobot(link, ManualClock())
    asked = asyncio.create_task(getattr(robot, method)())
    await settle()
    robot.take(GateState(node="second", epoch=0, latched=True))
    ended = GateState(node="first", epoch=1, latched=True, changes=1)
    link.reply.set_result(DeviceReply(result=msgspec.to_builtins(STATE), gate=ended))
    await asked
    robot.take(GateState(node="second", epoch=3, latched=True, changes=3))
    assert robot.gate is not None
    assert (robot.gate.node, robot.gate.epoch) == ("second", 3)


def gate_of(robot: RemoteRobot, *nodes: str) -> str:
    """The node session that counts when each of these has said something, in this order."""
    for changes, node in enumerate(nodes):
        robot.take(GateState(node=node, epoch=0, latched=True, changes=changes))
    assert robot.gate is not None
    return robot.gate.node


async def test_late_word_of_unknown_node_hides_its_successor_briefly() -> None:
    """It hides it for three messages only."""
    robot = RemoteRobot(SlowLink(), ManualClock())
    assert gate_of(robot, "second", "first", "second", "second") == "first"
    assert gate_of(robot, "second") == "second"
    assert gate_of(robot, "first", "first", "second", "first", "first") == "second", "it has ended"


async def test_a_scene_moves_its_head_reference_and_pointer(bench: Bench) -> None:
    burst = HeadBurst(time=1.0, duration=0.5, speed=0.086, direction=(1.0, 0.0, 0.0))
    motion = HeadMotion(drift=(3.3e-5, 0.0, 0.0), bursts=[burst], seed=3)
    await bench.scene.set_motion(motion)
    await bench.scene.bump_reference((0.005, 0.0, 0.0), (0.0, 0.1, 0.0))
    await bench.scene.pivot_pointer(20.0)
    assert bench.hand.calls == [motion, ((0.005, 0.0, 0.0), (0.0, 0.1, 0.0)), 20.0]


async def test_a_press_reports_its_force(bench: Bench) -> None:
    request = PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.01, speed=0.01, timeout=5.0)
    assert (await bench.robot.press(request)).force == 3.1
    assert bench.robot_device.pressed == [request]


def carry_setpoints(bench: Bench) -> None:
    """What the daemon has published reaches the node, in order."""
    for setpoint in bench.link.published.pop("dev/robot/setpoint", []):
        bench.link.hear("dev/robot/setpoint", setpoint)


async def test_set_points_are_published_numbered_and_stamped(bench: Bench) -> None:
    async with bench.robot.servo() as stream:
        stream.send([0.1] * 7, [0.0] * 7)
        await bench.clock.advance(0.016)
        stream.send([0.2] * 7, [0.3] * 7)
        carry_setpoints(bench)
    first, second, end = bench.robot_device.setpoints
    assert (first.session, first.number, second.number) == (4, 1, 2)
    assert second.sent - first.sent == pytest.approx(0.016)
    assert (second.positions, second.velocities) == ([0.2] * 7, [0.3] * 7)
    assert end is END, "leaving ends the session"


async def test_session_that_the_robot_ended_is_an_error_on_leaving_it(bench: Bench) -> None:
    bench.robot_device.servo_end = MotionResult(outcome="stopped", positions=[0.1] * 7, reason="no_set_point")
    with pytest.raises(DeviceError, match="no_set_point") as failed:
        async with bench.robot.servo():
            pass
    assert failed.value.fields["reason"] == "no_set_point"


async def test_a_block_that_fails_ends_the_session_and_keeps_its_error(bench: Bench) -> None:
    bench.robot_device.error = DeviceError("The brakes are on.")
    with pytest.raises(ZeroDivisionError):
        async with bench.robot.servo():
            _ = 1 / 0
    assert bench.robot_device.setpoints == [END]


async def test_a_cancelled_block_ends_the_session(bench: Bench) -> None:
    async def serve() -> None:
        async with bench.robot.servo():
            await asyncio.Event().wait()

    serving = asyncio.create_task(serve())
    await settle()
    serving.cancel()
    with pytest.raises(asyncio.CancelledError):
        await serving
    assert bench.robot_device.setpoints == [END]


async def test_events_of_the_robot_are_published(bench: Bench) -> None:
    event = DeviceEvent(device="robot", code="force_limit", text="Too much.", danger=True, fields={"force": 30.0})
    bench.robot_device.reports.put_nowait(event)
    await settle()
    assert bench.link.published["dev/robot/event"] == [event]


async def test_a_device_that_refuses_is_a_device_error_with_its_text(bench: Bench) -> None:
    bench.robot_device.error = DeviceError("The brakes are on.", joint=3)
    with pytest.raises(DeviceError, match="The brakes are on") as failed:
        await bench.robot.connect()
    assert failed.value.fields == {"joint": 3, "code": "device_failed"}


async def test_a_device_that_does_not_know_is_unknown(bench: Bench) -> None:
    bench.robot_device.error = UnknownOutcomeError("The cabinet is silent.")
    with pytest.raises(UnknownOutcomeError, match="The cabinet is silent"):
        await bench.robot.hold()


@pytest.mark.parametrize(
    ("method", "arguments", "text"),
    [
        ("explode", {}, "no method 'explode'"),
        ("states", {}, "no method 'states'"),
        ("servo", {}, "no method 'servo'"),
        ("__init__", {}, "no method '__init__'"),
        ("follow", {}, r"follow takes \['trajectory'\]"),
        ("joints", {"fast": True}, r"joints takes \[\]"),
        ("follow", {"trajectory": {"period": "soon", "positions": []}}, "Expected `float`"),
    ],
)
async def test_unknown_call_is_answered_with_the_known_ones(
    bench: Bench, method: str, arguments: dict[str, Any], text: str
) -> None:
    reply = await bench.raw("robot", method, **arguments)
    assert reply.failure is not None
    assert reply.failure.code == "malformed"
    with pytest.raises(AssertionError, match=text):
        raise AssertionError(reply.failure.text)


async def test_silence_is_unknown_not_failed(bench: Bench) -> None:
    bench.link.silent = True
    with pytest.raises(UnknownOutcomeError):
        await bench.robot.joints()


@pytest.mark.parametrize(
    ("method", "within"), [("joints", ANSWER_TIME), ("follow", 2 * TRAJECTORY.period + MOTION_MARGIN)]
)
async def test_an_answer_that_does_not_come_in_time_is_unknown(method: str, within: float) -> None:
    clock, link = ManualClock(), MemoryLink()

    async def never(_key: str, _request: DeviceRequest) -> DeviceReply:
        await asyncio.Event().wait()
        raise AssertionError

    link.serve("dev/robot/cmd", DeviceRequest, never)
    robot = RemoteRobot(link, clock)
    robot.take(GateState(node="n", epoch=0, latched=False))
    asking = asyncio.create_task(robot.joints() if method == "joints" else robot.follow(TRAJECTORY))
    await settle()
    await clock.advance(within - 0.001)
    assert not asking.done()
    await clock.advance(0.002)
    with pytest.raises(UnknownOutcomeError, match=f"robot.{method} was not answered within"):
        await asking


async def test_an_answer_of_another_type_is_unknown() -> None:
    link = MemoryLink()

    async def nonsense(_key: str, _request: DeviceRequest) -> DeviceReply:
        return DeviceReply(result={"positions": "all fine"})

    link.serve("dev/robot/cmd", DeviceRequest, nonsense)
    with pytest.raises(UnknownOutcomeError, match="has the wrong type"):
        await RemoteRobot(link, ManualClock()).joints()


async def test_streams_are_published_under_their_keys(bench: Bench) -> None:
    pose = BodyPose(body="coil", frame_number=1, captured=0.0, sent=0.0, valid=True)
    hidden = BodyPose(body="pointer", frame_number=1, captured=0.0, sent=0.0, valid=False)
    bench.tracker.stream.put_nowait([pose, hidden])
    bench.robot_device.stream.put_nowait(STATE)
    await settle()
    (coil,), (pointer,) = bench.link.published["state/pose/coil"], bench.link.published["state/pose/pointer"]
    assert coil.session == pointer.session != ""
    assert (coil, pointer) == tuple(msgspec.structs.replace(each, session=coil.session) for each in (pose, hidden))
    assert bench.link.published["state/joints"] == [STATE]


async def test_the_node_beats_for_every_device(bench: Bench) -> None:
    await bench.clock.advance(2.2)
    for device in ("robot", "tracker", "pointer", "scene"):
        numbers = [beat.number for beat in bench.link.published[f"dev/{device}/beat"]]
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) >= 1.0 / BEAT_PERIOD
    devices = ("robot", "tracker", "pointer", "scene")
    health = {device: bench.link.published[f"dev/{device}/state"][-1].connected for device in devices}
    why = {device: bench.link.published[f"dev/{device}/state"][-1].text for device in ("robot", "tracker")}
    assert why == {"robot": "The device sends nothing.", "tracker": "The tracker is unplugged."}
    assert health == {"robot": False, "tracker": False, "pointer": True, "scene": True}, "two have sent nothing yet"
    bench.robot_device.stream.put_nowait(JointState(captured=1, sent=1, positions=[], velocities=[], torques=[]))
    await bench.clock.advance(1.0)
    assert bench.link.published["dev/robot/state"][-1].connected


MOVING = msgspec.structs.replace(STATE, moving=True)


def beat(bench: Bench, number: int, delay: float = 0.0, *, age: float = 0.0, session: str = "a") -> None:
    """The daemon's heartbeat arrives, `delay` s after it was sent; its sign of life was `age` s old then."""
    sent = bench.clock.monotonic() - delay
    bench.link.hear(DAEMON_BEAT, Beat(number=number, session=session, alive=sent - age, sent=sent))


async def beat_for(bench: Bench, seconds: float, first: int = 1, delay: float = 0.0, session: str = "a") -> int:
    """Heartbeats as a daemon sends them; returns the next number."""
    numbers = range(first, first + round(seconds / BEAT_PERIOD))
    for number in numbers:
        beat(bench, number, delay, session=session)
        await bench.clock.advance(BEAT_PERIOD)
    return numbers.stop


async def test_moving_robot_is_held_one_deadman_after_last_heartbeat(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    await beat_for(bench, 2.0)
    await bench.clock.advance(DEADMAN - BEAT_PERIOD - 0.001)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(0.002)
    assert bench.robot_device.holds == 1
    (event,) = bench.link.published["dev/robot/event"]
    assert (event.code, event.danger) == ("daemon_silent", True), "the daemon learns of it, and latches"
    assert event.fields["silence"] == pytest.approx(DEADMAN, abs=0.002)


async def test_robot_that_starts_moving_while_daemon_is_silent_is_held(bench: Bench) -> None:
    await bench.clock.advance(10.0)
    bench.robot_device.stream.put_nowait(MOVING)
    await bench.clock.advance(DEADMAN / 2)
    assert bench.robot_device.holds == 1


async def test_heartbeats_that_come_late_do_not_count(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    await beat_for(bench, 1.0, number, delay=0.5)
    assert bench.robot_device.holds > 0, "they keep coming, and all of them are of half a second ago"


async def test_a_beat_that_is_stamped_ahead_makes_no_later_one_late(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    bench.link.hear(DAEMON_BEAT, Beat(number=number, session="a", alive=1e12, sent=1e12))
    await beat_for(bench, 1.0, number + 1)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(1.0)
    assert bench.robot_device.holds > 0, "the one from the future is no sign of life"
    health = bench.link.published["dev/robot/state"][-1]
    assert health.dropped["implausible_beats"] == 1


async def test_a_request_that_is_stamped_ahead_is_refused(bench: Bench) -> None:
    await beat_for(bench, 1.0)
    request = DeviceRequest(method="connect", sent=bench.clock.monotonic() + 2.0 * REQUEST_DELAY)
    reply = await bench.link.request("dev/robot/cmd", request, DeviceReply, 1.0)
    assert reply.failure is not None
    assert "ahead of the daemon's clock" in reply.failure.text


@pytest.mark.parametrize(
    ("delay", "age"), [(0.9 * DEADMAN, 0.0), (0.0, 0.9 * DEADMAN), (0.45 * DEADMAN, 0.45 * DEADMAN)]
)
async def test_silence_counts_from_last_sign_of_life_however_delayed(bench: Bench, delay: float, age: float) -> None:
    """It waited in the daemon, on the way or here: the arm is not led by anyone for longer than the deadman's time."""
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    await bench.clock.advance(0.9 * DEADMAN - BEAT_PERIOD)
    beat(bench, number, delay, age=age)  # of the same moment as the last one but for one period
    await bench.clock.advance(0.1 * DEADMAN + BEAT_PERIOD + 0.001)
    assert bench.robot_device.holds == 1
    (event,) = bench.link.published["dev/robot/event"]
    assert event.fields["silence"] == pytest.approx(DEADMAN, abs=0.002)


async def test_a_beat_that_carries_no_newer_sign_of_life_does_not_help(bench: Bench) -> None:
    """The process that sends the beats goes on while the loop hangs."""
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    for late in range(3):
        beat(bench, number + late, age=(late + 1) * BEAT_PERIOD)
        await bench.clock.advance(BEAT_PERIOD)
    await bench.clock.advance(0.001)
    assert bench.robot_device.holds == 1


async def test_heartbeats_of_a_restarted_daemon_count_with_any_clock(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    await beat_for(bench, 1.0)
    await beat_for(bench, 1.0, first=1, delay=1000.0, session="b")
    assert bench.robot_device.holds == 1, "what the daemon before has asked for ends"
    assert bench.link.published["dev/robot/event"] == [], "and nothing is silent"


async def test_heartbeats_of_the_previous_daemon_no_longer_count(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0, session="a")
    await beat_for(bench, 1.0, session="b")
    await beat_for(bench, 1.5 * DEADMAN, number, session="a")
    (event,) = bench.link.published["dev/robot/event"]
    assert event.code == "daemon_silent"


async def test_no_motion_starts_while_the_daemon_is_silent(bench: Bench) -> None:
    await bench.clock.advance(10.0)
    asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
    await settle()
    await bench.clock.advance(2 * DEADMAN)
    with pytest.raises(DeviceError, match="does not begin to move"):
        await asking
    asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
    await settle()
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    assert (await asking).outcome == "done"
    assert bench.robot_device.followed == [TRAJECTORY]


async def test_motion_waiting_for_the_daemon_does_not_start_after_stop(bench: Bench) -> None:
    """A hold of an arm that still rests is over before the heartbeat that the motion waits for has come."""
    stops: tuple[Callable[[], Awaitable[object]], ...] = (bench.robot.hold, lambda: bench.node.make_safe("stop"))
    for number, stop in enumerate(stops, start=1):
        await bench.clock.advance(10.0)
        asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
        await settle()
        await stop()
        beat(bench, number)
        await bench.clock.advance(DEADMAN / 2)
        with pytest.raises(DeviceError, match=r"older than the last hold or restart|was stopped and is latched"):
            await asking
    assert bench.robot_device.followed == []


async def test_delayed_request_is_dropped_unless_it_makes_safe(bench: Bench) -> None:
    await beat_for(bench, 1.0)
    sent = bench.clock.monotonic() - REQUEST_DELAY - 0.1
    arguments = {"trajectory": msgspec.to_builtins(TRAJECTORY)}
    late = DeviceRequest(method="follow", arguments=arguments, sent=sent, token=bench.robot.token())
    reply = await bench.link.request("dev/robot/cmd", late, DeviceReply, 1.0)
    assert reply.failure is not None
    assert "late and was dropped" in reply.failure.text
    assert bench.robot_device.followed == []
    hold = await bench.link.request("dev/robot/cmd", DeviceRequest(method="hold", sent=sent), DeviceReply, 1.0)
    assert hold.failure is None
    assert bench.node.late == {"requests": 1}


async def test_a_set_point_that_comes_late_is_dropped(bench: Bench) -> None:
    await beat_for(bench, 1.0)
    now = bench.clock.monotonic()
    for number, age in enumerate((0.0, DEADMAN + 0.01, 0.01), start=1):
        setpoint = JointSetpoint(session=4, number=number, sent=now - age, positions=[0.0] * 7, velocities=[0.0] * 7)
        setpoint = msgspec.structs.replace(setpoint, token=bench.robot.token())
        bench.link.hear("dev/robot/setpoint", setpoint)
    assert [setpoint.number for setpoint in bench.robot_device.setpoints] == [1, 3]
    assert bench.node.late == {"setpoints": 1}


async def test_set_points_dropped_by_the_driver_are_in_the_node_health(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(STATE)
    await bench.clock.advance(2.0)
    assert "stale_setpoints" not in bench.link.published["dev/robot/state"][-1].dropped
    bench.robot_device.dropped = 3
    await bench.clock.advance(2.0)
    assert bench.link.published["dev/robot/state"][-1].dropped["stale_setpoints"] == 3


async def test_delayed_node_reads_what_arrived_and_reports_the_delay(bench: Bench) -> None:
    """Its timer was in time: the threads that receive were not served."""
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN - TURN)
    bench.scheduling.waits, bench.scheduling.busy = 5 * HELD_UP, True
    await bench.clock.advance(2 * TURN)
    beat(bench, 2, 2 * TURN)
    await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(DEADMAN / 2)
    assert bench.robot_device.holds == 0
    (event,) = bench.link.published["dev/robot/event"]
    assert (event.code, event.danger) == ("node_held_up", False)
    assert "9 threads want to run on 2 processors" in event.text
    beat(bench, 3)
    for number in range(4, 10):
        await bench.clock.advance(DEADMAN + TURN)  # late each time, and each time the beat has arrived already
        beat(bench, number, 2 * TURN)
        await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 0
    assert bench.link.published["dev/robot/event"] == [event], "it is not told each time"


async def test_delayed_node_holds_at_once_if_nothing_has_arrived(bench: Bench) -> None:
    """Whatever it waits for, the arm is held within 25 ms after the deadman's time."""
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    bench.clock.stall(2 * DEADMAN)
    await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 1
    codes = [event.code for event in bench.link.published["dev/robot/event"]]
    assert sorted(codes) == ["daemon_silent", "node_held_up"]
    (silent,) = (event for event in bench.link.published["dev/robot/event"] if event.code == "daemon_silent")
    assert "9 threads want to run on 2 processors" in silent.text, "the reason of the hold is the machine"


async def test_threads_that_never_rest_do_not_put_the_hold_off(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    bench.scheduling.waits, bench.scheduling.busy = 5 * HELD_UP, True
    await bench.clock.advance(DEADMAN + DELIVERY + TURN)
    assert bench.robot_device.holds == 1


async def test_a_resting_robot_is_left_alone_by_a_silent_daemon(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(STATE)
    await bench.clock.advance(10.0)
    assert bench.robot_device.holds == 0


FAILURES = [DeviceError("The brakes are worn."), OSError("The socket is closed.")]


@pytest.mark.parametrize("error", FAILURES)
async def test_node_receives_stop_itself_even_if_the_hold_fails(bench: Bench, error: Exception) -> None:
    bench.robot_device.error = error
    bench.node.stop("bus:nurse")
    await settle()
    bench.node.stop("bus:nurse")
    await settle()
    assert bench.robot_device.holds == 2


@pytest.mark.parametrize("error", FAILURES)
async def test_failed_hold_does_not_end_the_watch_over_a_moving_robot(bench: Bench, error: Exception) -> None:
    bench.robot_device.error = error
    bench.robot_device.stream.put_nowait(msgspec.structs.replace(STATE, moving=True))
    for holds in (1, 2):
        await bench.clock.advance(DEADMAN + BEAT_PERIOD / 2)
        assert bench.robot_device.holds == holds
