"""Devices that a daemon waits for at its start, and refusals for want of them."""

from __future__ import annotations

import asyncio

import pytest
from structlog.testing import capture_logs

from pcmrs.errors import DeviceError
from pcmrs.service.watches.readiness import DEVICES_TIME, NOTED_AFTER, DeviceReadiness, awaited
from pcmrs.settings import DeviceSettings, RobotSettings, Settings, TrackerSettings
from pcmrs.testing.clock import ManualClock, settle

OTHERS = {"pointer", "scene", "stimulator", "emg"}


NOWHERE = DeviceSettings(driver="none")


ELSEWHERE = Settings(robot=RobotSettings(driver="none"), tracker=TrackerSettings(driver="none"))


@pytest.mark.parametrize(
    ("settings", "branches", "devices"),
    [
        (Settings(), ["lamp"], {"robot", "tracker"} | OTHERS),
        (ELSEWHERE, ["lamp"], OTHERS),
        (ELSEWHERE, ["robot"], {"robot"} | OTHERS),
        (ELSEWHERE, ["registration", "lamp"], {"tracker"} | OTHERS),
        (Settings(robot=RobotSettings(driver="none")), ["registration"], {"tracker"} | OTHERS),
        (Settings(scene=NOWHERE, emg=NOWHERE), ["lamp"], {"robot", "tracker", "pointer", "stimulator"}),
    ],
)
def test_devices_started_here_or_required_are_waited_for(
    settings: Settings, branches: list[str], devices: set[str]
) -> None:
    """The workflow requires some of them."""
    assert awaited(settings, branches) == devices


async def test_all_awaited_devices_must_be_ready() -> None:
    readiness = DeviceReadiness({"robot", "tracker"}, ManualClock())
    readiness.record_message("tracker")
    assert not readiness.complete
    readiness.record_message("robot")
    assert not readiness.complete, "its first beat was lost: nobody could release it"
    readiness.record_gate("robot")
    assert readiness.complete
    await readiness.wait()
    readiness.fail(DeviceError("too late to matter"))
    await readiness.wait()


async def test_nothing_awaited_is_nothing_waited_for() -> None:
    await DeviceReadiness(set(), ManualClock()).wait()


async def test_a_device_that_ends_ends_the_wait() -> None:
    readiness = DeviceReadiness({"robot"}, ManualClock())
    readiness.fail(DeviceError("The node of robot ended."))
    with pytest.raises(DeviceError, match="ended"):
        await readiness.wait()


async def test_device_that_is_not_ready_in_time_is_named() -> None:
    clock = ManualClock()
    readiness = DeviceReadiness({"robot", "tracker"}, clock)
    with capture_logs() as log:
        waiting = asyncio.create_task(readiness.wait())
        await settle()
        await clock.advance(NOTED_AFTER - 0.1)
        assert log == []
        await clock.advance(0.1)
        readiness.record_message("tracker")
        await clock.advance(DEVICES_TIME - NOTED_AFTER - 0.1)
        assert not waiting.done()
        await clock.advance(0.1)
        with pytest.raises(DeviceError, match=r"No answer within 120 s from: robot; the log says why\.") as raised:
            await waiting
    assert raised.value.fields == {"devices": ["robot"]}
    assert [(entry["event"], entry["devices"]) for entry in log] == [("waiting_for_devices", ["robot", "tracker"])]


async def test_a_slow_start_is_no_failure() -> None:
    """Beside many processes that compute, a simulated cell takes more than 30 s until it is heard."""
    clock = ManualClock()
    readiness = DeviceReadiness({"robot"}, clock)
    waiting = asyncio.create_task(readiness.wait())
    await settle()
    await clock.advance(60.0)
    readiness.record_message("robot")
    readiness.record_gate("robot")
    await waiting
