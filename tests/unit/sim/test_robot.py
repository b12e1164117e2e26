"""The simulated robot: motions, presses, servo sessions and the limit of the force."""

import asyncio
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent
from pcmrs.spatial import Floats
from pcmrs_sim.opening import open_devices
from pcmrs_sim.settings import GeometrySettings, SimSettings
from tests.unit.sim.simulated_arms import FACTS, HOME, body_before_tool, smooth

FLANGE_FROM_COIL = GeometrySettings().flange_from_coil.transform


def towards_head(way: float) -> Floats:
    """A posture with the tool `way` (m) farther along its axis, from home."""
    model = ArmModel(FACTS)
    direction = -(model.forward(HOME) @ FLANGE_FROM_COIL).rotation[:, 2]
    posture: Floats = HOME + np.linalg.pinv(model.jacobian(HOME)) @ np.concatenate((way * direction, np.zeros(3)))
    return posture


async def pushed_into_head(
    clock: Clock, relief_mm: float, way: float = 0.05
) -> tuple[Any, list[DeviceEvent], float, float]:
    """A motion of `way` against a head 10 mm away: its result, the events, the true force and the tool's way."""
    place = body_before_tool(0.010)
    pose = {"position": place.translation.tolist(), "quat_wxyz": place.quat_wxyz.tolist()}
    settings = {
        "sim": {"geometry": {"world_from_image": pose}},
        "robot": {"force_limit": 10.0, "relief_mm": relief_mm},
    }
    events: list[DeviceEvent] = []
    async with open_devices(("robot", "scene"), settings, clock) as devices:

        async def listen() -> None:
            async for event in devices["robot"].events():
                events.append(event)

        listening = asyncio.create_task(listen())
        await devices["robot"].connect()
        start = await devices["scene"].truth()
        result = await devices["robot"].follow(smooth(HOME, towards_head(way)))
        await clock.sleep(0.1)
        truth = await devices["scene"].truth()
        back = await devices["robot"].follow(smooth(np.array(result.positions), HOME))
        assert back.outcome == "done", "a force that is too great does not keep the arm from going back"
        listening.cancel()
    gone = np.linalg.norm(np.subtract(truth.tracker_from_coil.position, start.tracker_from_coil.position))
    return result, events, truth.contact_force, float(gone)


async def test_too_much_force_stops_the_motion_and_is_reported(clock: Clock) -> None:
    result, (event,), force, gone = await pushed_into_head(clock, relief_mm=0.0)
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    assert (event.code, event.danger) == ("force_limit", True)
    assert 10.0 < event.fields["force"] < 11.0
    assert event.fields["limit"] == 10.0
    assert event.fields["relieved"] == 0.0
    assert 10.0 < force < 14.0, "it stands where it braked"
    assert gone == pytest.approx(0.010 + force / SimSettings().contact.stiffness, abs=5e-4)


@pytest.mark.parametrize("relief_mm", [1.0, 5.0])
async def test_a_force_is_relieved_by_no_more_than_configured(clock: Clock, relief_mm: float) -> None:
    _, _, force_without, _ = await pushed_into_head(clock, relief_mm=0.0)
    result, (event,), force, _ = await pushed_into_head(clock, relief_mm=relief_mm)
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    assert event.fields["relieved"] == pytest.approx(relief_mm * 1e-3, abs=1e-4)
    assert event.fields["relieved"] <= relief_mm * 1e-3
    assert force_without - force == pytest.approx(relief_mm, abs=1.0)


async def test_a_touch_below_the_limit_is_nothing_to_report(clock: Clock) -> None:
    result, events, force, _ = await pushed_into_head(clock, relief_mm=5.0, way=0.018)
    assert result.outcome == "done"
    assert 7.0 < force < 9.0
    assert events == []
