"""Pressing by admittance: gentle, to the asked force, and never on and on."""

from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.devices.motion.press import RESISTANCE, TOLERANCE, PressMotion
from pcmrs.errors import DeviceError
from pcmrs.messages import MotionResult, PressRequest
from pcmrs.spatial import rotation_angle
from pcmrs_sim.arm import Arm
from pcmrs_sim.opening import open_devices
from pcmrs_sim.settings import GeometrySettings, SimSettings, SkinSettings
from tests.unit.sim.simulated_arms import body_before_tool, make_arm

INWARD = -GeometrySettings().flange_from_coil.transform.rotation[:, 2]
REQUEST = PressRequest(
    force=3.0,
    direction_in_flange=(float(INWARD[0]), float(INWARD[1]), float(INWARD[2])),
    travel=0.010,
    speed=0.02,
    timeout=8.0,
)


def pressed(
    gap: float, request: PressRequest = REQUEST, stiffness: float = 1000.0
) -> tuple[Arm, PressMotion, list[float]]:
    """The arm after a press on a head `gap` (m) away, and the true force at every millisecond."""
    settings = SimSettings(contact=SkinSettings(stiffness=stiffness))
    arm = make_arm(settings)
    arm.contact.place(body_before_tool(gap, settings))
    press = arm.press(request)
    forces = []
    for _ in range(9000):
        arm.step(1)
        forces.append(arm.contact.force)
        if arm.reference.ended and arm.at_rest:
            break
    return arm, press, forces


@pytest.mark.parametrize("stiffness", [600.0, pytest.param(1000.0, marks=pytest.mark.nightly), 5000.0])
@pytest.mark.parametrize("force", [1.0, pytest.param(3.0, marks=pytest.mark.nightly), 5.0])
def test_the_force_is_reached_without_overshoot_and_kept(force: float, stiffness: float) -> None:
    arm, press, forces = pressed(0.0, msgspec.structs.replace(REQUEST, force=force), stiffness)
    assert arm.stopped is None
    assert forces[-1] == pytest.approx(force, abs=TOLERANCE + 0.1)
    assert press.force == pytest.approx(forces[-1], abs=0.3)
    assert max(forces) < force + 2 * TOLERANCE
    arm.step(2000)
    assert arm.contact.force == pytest.approx(forces[-1], abs=0.15), "it stays"


def test_tool_moves_straight_along_its_axis_within_the_speed() -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(0.005))
    start = arm.base_from_flange()
    press = arm.press(msgspec.structs.replace(REQUEST, speed=0.003))
    ways = [0.0]
    for _ in range(300):
        arm.step(10)
        ways.append(press.travelled)
    assert np.diff(ways).max() <= 0.003 * 0.010 * (1 + 1e-9)
    way = start.inverse() @ arm.base_from_flange().translation
    assert np.linalg.norm(np.cross(way, INWARD)) < 1e-4
    assert rotation_angle(start, arm.base_from_flange()) < 2e-4
    assert way @ INWARD == pytest.approx(press.travelled, abs=1e-4)


def test_in_the_air_the_speed_is_that_of_the_admittance() -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(0.05))
    press = arm.press(REQUEST)
    arm.step(300)
    before = press.travelled
    arm.step(200)
    assert (press.travelled - before) / 0.2 == pytest.approx(REQUEST.force / RESISTANCE, rel=0.1)


def test_without_contact_it_ends_at_its_travel() -> None:
    arm, press, _ = pressed(0.05)
    assert arm.stopped == "no_contact"
    assert 0.0099 < press.travelled <= 0.0101


def test_contact_that_is_too_soft_ends_at_the_travel() -> None:
    arm, press, forces = pressed(0.002, stiffness=200.0)
    assert arm.stopped == "travel_limit"
    assert press.travelled <= 0.0101
    assert 0.5 < forces[-1] < 3.0


def test_it_does_not_press_for_ever() -> None:
    arm, _, _ = pressed(0.002, msgspec.structs.replace(REQUEST, timeout=0.5))
    assert arm.stopped == "timeout"


async def press_in_cell(clock: Clock, gap: float, **changes: Any) -> MotionResult:
    place = body_before_tool(gap)
    pose = {"position": place.translation.tolist(), "quat_wxyz": place.quat_wxyz.tolist()}
    async with open_devices(("robot",), {"sim": {"geometry": {"world_from_image": pose}}}, clock) as devices:
        await devices["robot"].connect()
        result: MotionResult = await devices["robot"].press(msgspec.structs.replace(REQUEST, **changes))
        state = await devices["robot"].joints()
        assert state.flange_force is not None
        if result.outcome == "done":
            assert -INWARD @ state.flange_force == pytest.approx(result.force, abs=0.2)
    return result


async def test_the_result_has_the_force(clock: Clock) -> None:
    result = await press_in_cell(clock, 0.002)
    assert result.outcome == "done"
    assert result.force == pytest.approx(3.0, abs=0.5)
    result = await press_in_cell(clock, 0.05)
    assert (result.outcome, result.reason) == ("stopped", "no_contact")
    assert result.force == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize(
    "change",
    [
        {"force": 0.5},
        {"force": 5.5},
        {"force": float("nan")},
        {"travel": 0.0},
        {"travel": 0.011},
        {"speed": 0.0},
        {"speed": 0.2},
        {"timeout": -1.0},
        {"timeout": float("inf")},
        {"timeout": float("nan")},
        {"timeout": 20.1},
        {"direction_in_flange": (0.0, 0.0, 0.5)},
    ],
)
async def test_a_press_that_is_not_gentle_is_refused(clock: Clock, change: dict[str, Any]) -> None:
    with pytest.raises(DeviceError, match="must be"):
        await press_in_cell(clock, 0.002, **change)
