"""Which devices a daemon waits for at its start."""

from __future__ import annotations

import pytest

from pcmrs.errors import DeviceError
from pcmrs.service.hearing import Hearing, awaited
from pcmrs.settings import DeviceSettings, RobotSettings, Settings

ELSEWHERE = Settings(robot=RobotSettings(driver="none"), tracker=DeviceSettings(driver="none"))


@pytest.mark.parametrize(
    ("settings", "branches", "devices"),
    [
        (Settings(), ["lamp"], {"robot", "tracker"}),
        (ELSEWHERE, ["lamp"], set()),
        (ELSEWHERE, ["robot"], {"robot"}),
        (ELSEWHERE, ["registration", "lamp"], {"tracker"}),
        (Settings(robot=RobotSettings(driver="none")), ["registration"], {"tracker"}),
    ],
)
def test_what_is_started_here_or_needed_by_the_workflow_is_waited_for(
    settings: Settings, branches: list[str], devices: set[str]
) -> None:
    assert awaited(settings, branches) == devices


async def test_all_awaited_devices_must_be_heard() -> None:
    hearing = Hearing({"robot", "tracker"})
    hearing.hear("tracker")
    assert not hearing.complete
    hearing.hear("robot")
    assert hearing.complete
    await hearing.wait()
    hearing.fail(DeviceError("too late to matter"))
    await hearing.wait()


async def test_nothing_awaited_is_nothing_waited_for() -> None:
    await Hearing(set()).wait()


async def test_a_device_that_ends_ends_the_wait() -> None:
    hearing = Hearing({"robot"})
    hearing.fail(DeviceError("The node of robot ended."))
    with pytest.raises(DeviceError, match="ended"):
        await hearing.wait()
