"""The daemon's side of a device: typed calls, unknown outcomes, and the latch."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from pcmrs.devices.gate import LATCHED
from pcmrs.devices.remote import ANSWER_TIME, MOTION_MARGIN, RemoteRobot
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import (
    DeviceReply,
    DeviceRequest,
    GateState,
    HeadBurst,
    HeadMotion,
    LandmarkPrompt,
    MotionResult,
    PressRequest,
)
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.testing.devices import STATE
from tests.support.memory_link import MemoryLink
from tests.unit.devices.node_bench import TRAJECTORY, Bench


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


async def test_a_device_that_refuses_is_a_device_error_with_its_text(bench: Bench) -> None:
    bench.robot_device.error = DeviceError("The brakes are on.", joint=3)
    with pytest.raises(DeviceError, match="The brakes are on") as failed:
        await bench.robot.connect()
    assert failed.value.fields == {"joint": 3, "code": "device_failed"}


async def test_a_device_that_does_not_know_is_unknown(bench: Bench) -> None:
    bench.robot_device.error = UnknownOutcomeError("The cabinet is silent.")
    with pytest.raises(UnknownOutcomeError, match="The cabinet is silent"):
        await bench.robot.hold()


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
