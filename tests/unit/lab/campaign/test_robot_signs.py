"""Signs of a robot's fault: the event by which it reports it, or silence."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.messages import DeviceEvent
from pcmrs.testing.devices import STATE
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.robot_signs import ALARMS, SILENCE, robot_reports
from pcmrs_sim.faults import FAULTS
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run


def event(code: str) -> DeviceEvent:
    return DeviceEvent(device="robot", code=code, text="")


def test_alarms_are_of_faults_that_the_simulation_has() -> None:
    assert ALARMS.keys() <= FAULTS.keys()


@pytest.mark.parametrize("name", ALARMS)
async def test_a_fault_is_shown_by_its_own_event(name: str) -> None:
    cell = ScriptedCell()
    async with robot_reports(cell.as_cell) as robot:
        take = cell.client.handlers["dev/robot/event"]
        take(event("another"))
        with pytest.raises(Unmet, match=rf"No client has seen '{name}'.*another"):
            robot.shown(name)
        take(event(ALARMS[name]))
        take(event(ALARMS[name]))
        assert robot.shown(name) == {f"events {ALARMS[name]}": 2}
    assert cell.client.handlers == {}


def test_a_silent_link_is_shown_by_the_missing_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    async def look(after: float, silence: float) -> dict[str, Any]:
        cell = ScriptedCell()
        async with robot_reports(cell.as_cell) as robot:
            await asyncio.sleep(after)
            cell.client.handlers["state/joints"](STATE)
            await asyncio.sleep(silence)
            return robot.shown("silence_robot")

    assert run(monkeypatch, look(9.0, 1.0)) == {"no joints for_s": 1.0}
    with pytest.raises(Unmet, match="silence_robot"):
        run(monkeypatch, look(9.0, 0.9 * SILENCE))
