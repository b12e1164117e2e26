"""A servo session from the sender's side."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import DeviceError
from pcmrs.messages import (
    MotionResult,
)
from pcmrs.testing.clock import settle
from pcmrs.testing.devices import END
from tests.unit.devices.node_bench import Bench


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
