"""Contact as a spring, the force that the arm knows of, and what it does when that is too much."""

import asyncio
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import Clock
from pcmrs.devices.motion.force import HYSTERESIS, ForceGuard, ForceSettings
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent
from pcmrs.spatial import Floats, Transform
from pcmrs_sim import femur, head
from pcmrs_sim.force import ForceSensor
from pcmrs_sim.opening import open_devices
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plan import trajectory
from pcmrs_sim.settings import ArmSettings, GeometrySettings, SimSettings
from tests.unit.sim.simulated_arms import FACTS, HOME, body_before_tool, make_arm, smooth

FLANGE_FROM_COIL = GeometrySettings().flange_from_coil.transform
directions = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda v: float(np.linalg.norm(v)) > 0.1)


def tool_of(arm: Any) -> Transform:
    tool: Transform = arm.base_from_flange() @ FLANGE_FROM_COIL
    return tool


@given(directions, st.floats(-0.01, 0.01))
def test_a_face_at_the_scalp_reaches_as_deep_as_it_was_put(direction: list[float], depth: float) -> None:
    point = head.surface_point(direction)
    normal = head.outward_normal(point)
    touch = head.HEAD.solid.touch(point - depth * normal, normal, head.COIL_RADIUS)
    if depth <= 0.0:
        assert touch is None or touch.depth < 1e-9
    elif depth > 1e-9:
        assert touch is not None
        assert touch.depth == pytest.approx(depth, abs=1e-9)
        assert np.allclose(touch.point, point, atol=2e-4)


@given(directions, st.floats(0.001, 0.01))
def test_no_point_of_the_head_lies_deeper_than_its_touch(direction: list[float], depth: float) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    rays = np.random.default_rng(0).normal(size=(300, 3))
    surface = np.array([head.surface_point(ray) for ray in rays])
    touch = head.HEAD.solid.touch(head.CENTRE, axis, 1.0)
    assert touch is not None
    assert ((surface - head.CENTRE) @ axis).max() <= touch.depth + 1e-12


@pytest.mark.parametrize(("depth_percent", "inferior", "posterior"), [(0.45, 20, 8), (0.55, 16, 4), (0.65, 30, 12)])
def test_a_guide_touches_the_bone_at_the_planned_entry(depth_percent: float, inferior: float, posterior: float) -> None:
    entry, target = trajectory(depth_percent, inferior, posterior)
    axis = (entry - target) / np.linalg.norm(entry - target)
    clear = femur.FEMUR.solid.touch(entry + 0.006 * axis, axis, femur.GUIDE_RADIUS)
    assert clear is None or clear.depth < 0.006, "a sleeve of 6 mm meets the slope of the bone a little before its axis"
    inside = femur.FEMUR.solid.touch(entry - 0.003 * axis, axis, femur.GUIDE_RADIUS)
    assert inside is not None
    assert 0.003 - 1e-4 < inside.depth < 0.003 + 0.006


@pytest.mark.parametrize("seed", range(20))
def test_a_point_is_in_the_balls_where_it_is_in_the_bone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = femur.BASE + rng.uniform(-0.05, 0.05, 3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    touch = femur.FEMUR.solid.touch(origin, axis, 1e-9)
    ahead = np.array([femur.distance(origin + along * axis) for along in np.linspace(0.0, 0.25, 1000)])
    inside = np.flatnonzero(ahead < 0.0)
    if touch is None:
        assert ahead.min() > -1e-4
    elif len(inside):
        assert touch.depth == pytest.approx(np.linspace(0.0, 0.25, 1000)[inside[-1]], abs=6e-4)


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
    assert arm.sensor.flange_force == pytest.approx(FLANGE_FROM_COIL.rotation[:, 2] * arm.contact.force, abs=0.3)


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


def test_beside_the_face_there_is_no_touch() -> None:
    solid, crown = head.HEAD.solid, head.surface_point((0.0, 0.0, 1.0))
    inward = np.array([0.0, 0.0, -0.005])
    assert solid.touch(crown + inward + np.array([0.049, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.05) is not None
    assert solid.touch(crown + inward + np.array([0.051, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.05) is None


def test_the_estimate_has_the_stated_noise_and_no_bias() -> None:
    settings, axis = ArmSettings(), np.array([0.0, 0.0, -1.0])
    sensor = ForceSensor(axis, settings, 1e-3, np.random.default_rng(2))
    seen = []
    for _ in range(20_000):
        sensor.update(3.0)
        seen.append(sensor.flange_force)
    values = np.array(seen[1000:])
    share = 1 - np.exp(-2 * np.pi * settings.force_filter_hz * 1e-3)
    assert values.mean(axis=0) == pytest.approx([0.0, 0.0, -3.0], abs=0.01)
    assert values.std(axis=0) == pytest.approx(settings.force_noise * np.sqrt(share / (2 - share)), rel=0.1)


def test_limit_counts_once_and_again_only_if_the_force_grows() -> None:
    guard = ForceGuard(25.0)
    course = [10.0, 25.5, 26.0, 24.0, 26.0, 25.4 + HYSTERESIS, 25.6 + HYSTERESIS, 25.0 - HYSTERESIS - 0.1, 25.1]
    assert [guard.exceeded(force) for force in course] == [False, True, False, False, False, False, True, False, True]


@pytest.mark.parametrize("limit", [1.0, 3.0, 5.0, 6.0, 25.0])
def test_limit_of_any_size_counts_again_after_the_force_fell(limit: float) -> None:
    guard = ForceGuard(limit)
    fallen = max(limit - HYSTERESIS, limit / 2)
    course = [1.01 * limit, 1.01 * fallen, 1.01 * limit, 0.99 * fallen, limit, 1.01 * limit]
    assert [guard.exceeded(force) for force in course] == [True, False, False, False, False, True]


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


@pytest.mark.parametrize("phantom", ["head", "femur"])
def test_the_tool_lies_behind_its_face(phantom: Literal["head", "femur"]) -> None:
    for shape in PHANTOMS[phantom].tool:
        cap = shape.size[0] if shape.kind == "capsule" else 0.0
        assert shape.pose.translation[2] - shape.size[1] - cap >= -1e-12


def test_the_force_limit_also_guards_a_standing_arm() -> None:
    arm, place = make_arm(force=ForceSettings(force_limit=10.0, relief_mm=5.0)), body_before_tool(0.0)
    for depth in np.linspace(0.0, 0.012, 200):
        arm.contact.place(Transform(place.rotation, place.translation + depth * place.rotation[:, 2]))
        arm.step(5)
    arm.step(1000)
    (alarm,) = arm.alarms
    assert alarm.fields["relieved"] == pytest.approx(0.005, abs=1e-4)
    assert arm.at_rest
    assert arm.contact.force < 8.0


@pytest.mark.parametrize(("before", "after"), [(-0.001, 0.005), (0.005, 0.0005)])
def test_suddenly_shifted_body_neither_hits_nor_draws_the_tool(before: float, after: float) -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(-before))
    arm.step(1)
    arm.contact.place(body_before_tool(-after))
    arm.step(1)
    spring = SimSettings().contact.stiffness * after
    assert 0.0 <= arm.contact.force <= 2.0 * spring * 1.01
