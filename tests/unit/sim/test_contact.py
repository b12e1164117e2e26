"""Contact as a spring: the force on the tool where the body lies beyond its face."""

from typing import Any

import pytest

from pcmrs.spatial import Transform
from pcmrs_sim import head
from pcmrs_sim.settings import GeometrySettings, SimSettings
from tests.unit.sim.simulated_arms import body_before_tool, make_arm

FLANGE_FROM_TOOL_TIP = GeometrySettings().flange_from_tool_tip.transform


def tool_of(arm: Any) -> Transform:
    tool: Transform = arm.base_from_flange() @ FLANGE_FROM_TOOL_TIP
    return tool


@pytest.mark.parametrize("depth", [0.001, 0.004])
def test_in_rest_the_force_is_stiffness_times_depth(depth: float) -> None:
    arm = make_arm()
    place = body_before_tool(-depth)
    arm.contact.place(place)
    arm.step(1000)
    tool = place.inverse() @ tool_of(arm)
    reached = (head.surface_point((0.0, 0.0, 1.0)) - tool.translation)[2]
    assert reached == pytest.approx(depth, abs=5e-5), "the integral action holds the arm against it"
    assert arm.contact.force == pytest.approx(SimSettings().contact.stiffness * reached, abs=0.02)
    assert arm.sensor.flange_force == pytest.approx(FLANGE_FROM_TOOL_TIP.rotation[:, 2] * arm.contact.force, abs=0.3)


@pytest.mark.parametrize("gap", [0.0005, 0.05])
def test_without_touch_there_is_no_force(gap: float) -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(gap))
    arm.step(200)
    assert arm.contact.force == 0.0
    assert not arm._data.xfrc_applied.any()


def test_a_body_that_leaves_the_tool_presses_on_it_no_more() -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(-0.002))
    arm.step(10)
    assert arm.contact.force > 0.0
    arm.contact.place(body_before_tool(0.02))
    assert not arm.contact.clear(arm._data), "the face is still as near as the body reaches in another direction"
    arm.step(1)
    assert arm.contact.force == 0.0
    assert not arm._data.xfrc_applied.any()


@pytest.mark.parametrize(("before", "after"), [(-0.001, 0.005), (0.005, 0.0005)])
def test_suddenly_shifted_body_neither_hits_nor_draws_the_tool(before: float, after: float) -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(-before))
    arm.step(1)
    arm.contact.place(body_before_tool(-after))
    arm.step(1)
    spring = SimSettings().contact.stiffness * after
    assert 0.0 <= arm.contact.force <= 2.0 * spring * 1.01
