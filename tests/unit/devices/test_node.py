"""A node serves its devices: streams, beats, health, and requests that come late or after a stop."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from pcmrs.devices.deadman import DEADMAN
from pcmrs.devices.gate import HOLD_TIME
from pcmrs.devices.node import PASSIVE_PERIOD, REQUEST_DELAY
from pcmrs.devices.standstill import MOVED, THRESHOLD
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import (
    BodyPose,
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    JointSetpoint,
    JointState,
)
from pcmrs.testing.clock import settle
from pcmrs.testing.devices import STATE
from tests.unit.devices.node_bench import BEAT_PERIOD, TRAJECTORY, Bench, beat_for


async def test_events_of_the_robot_are_published(bench: Bench) -> None:
    event = DeviceEvent(device="robot", code="force_limit", text="Too much.", danger=True, fields={"force": 30.0})
    bench.robot_device.reports.put_nowait(event)
    await settle()
    assert bench.link.published["dev/robot/event"] == [event]


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
        period = BEAT_PERIOD if device in ("robot", "pointer") else PASSIVE_PERIOD
        assert 2.0 / period <= len(numbers) <= 2.4 / period, "those that act beat as fast as the daemon"
    devices = ("robot", "tracker", "pointer", "scene")
    health = {device: bench.link.published[f"dev/{device}/state"][-1].connected for device in devices}
    why = {device: bench.link.published[f"dev/{device}/state"][-1].text for device in ("robot", "tracker")}
    assert why == {"robot": "The device sends nothing.", "tracker": "The tracker is unplugged."}
    assert health == {"robot": False, "tracker": False, "pointer": True, "scene": True}, "two have sent nothing yet"
    bench.robot_device.stream.put_nowait(JointState(captured=1, sent=1, positions=[], velocities=[], torques=[]))
    await bench.clock.advance(1.0)
    assert bench.link.published["dev/robot/state"][-1].connected


async def test_a_request_that_is_stamped_ahead_is_refused(bench: Bench) -> None:
    await beat_for(bench, 1.0)
    request = DeviceRequest(method="connect", sent=bench.clock.monotonic() + 2.0 * REQUEST_DELAY)
    reply = await bench.link.request("dev/robot/cmd", request, DeviceReply, 1.0)
    assert reply.failure is not None
    assert "ahead of the daemon's clock" in reply.failure.text


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


@pytest.mark.parametrize("error", [DeviceError("The brakes are worn."), OSError("The socket is closed.")])
async def test_node_receives_stop_itself_even_if_the_hold_fails(bench: Bench, error: Exception) -> None:
    bench.robot_device.error = error
    bench.node.stop("bus:nurse")
    await settle()
    bench.node.stop("bus:nurse")
    await settle()
    assert bench.robot_device.holds == 2


async def test_release_without_measured_joints_is_given_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await bench.robot.stop()
    joints: asyncio.Future[JointState] = asyncio.get_running_loop().create_future()
    monkeypatch.setattr(bench.robot_device, "joints", lambda: joints)
    releasing = asyncio.create_task(bench.raw("robot", "release_latch"))
    await settle()
    await bench.clock.advance(HOLD_TIME)
    reply = await releasing
    assert reply.failure is not None
    assert reply.failure.code == UnknownOutcomeError.code
    assert reply.gate is not None
    assert reply.gate.latched, "an answer after the daemon has stopped waiting releases nothing"


async def test_node_alone_holds_an_arm_that_moves_unasked(bench: Bench) -> None:
    await bench.raw("robot", "connect")
    displaced = [*STATE.positions[:-1], STATE.positions[-1] + 2 * THRESHOLD]
    bench.robot_device.stream.put_nowait(STATE)
    await settle()
    assert bench.robot_device.holds == 0
    bench.robot_device.stream.put_nowait(msgspec.structs.replace(STATE, positions=displaced))
    await settle()
    assert bench.robot_device.holds == 1
    assert [(event.code, event.danger) for event in bench.link.published["dev/robot/event"]] == [(MOVED, True)]
    await bench.robot.joints()
    assert bench.robot.latched
