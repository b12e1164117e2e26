"""What the scene shows is where it is."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.console._geometry import ArmFrames, TrackerLocator, as_stl, as_zone, placement_deviation, residuals, tool_tip
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import PoseMessage
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import as_message
from tests.unit.console.shown_cell import FLANGE_FROM_TOOL_TIP, TOOL_MARKER_FROM_TOOL_TIP, body, setup, shown, some_pose


@pytest.mark.parametrize("name", ["iiwa14", "iiwa7", "panda", "ur5"])
def test_the_flange_is_where_the_kinematics_have_it(name: str) -> None:
    facts, arm = find_arm(name), ArmFrames(shown(name))
    model = ArmModel(facts)
    for seed in range(20):
        q = np.random.default_rng(seed).uniform([j.lower for j in facts.joints], [j.upper for j in facts.joints])
        frames = arm.frames(q)
        assert len(frames) == len(facts.joints) + 1 == len(arm.spans) + 1
        there = model.forward(q)
        assert distance(frames[-1], there) < 1e-9
        assert rotation_angle(frames[-1], there) < 1e-7
        for frame, following, span in zip(frames[:-1], frames[1:], arm.spans, strict=True):
            assert np.allclose(frame @ span, following.translation, atol=1e-9), "a link ends where the next begins"


@given(st.integers(0, 10_000))
def test_tool_and_body_are_shown_by_one_tracker(seed: int) -> None:
    locator, q = TrackerLocator(setup()), np.random.default_rng(seed).uniform(-1.5, 1.5, 7)
    base_from_tracker, base_from_body = some_pose(seed), some_pose(seed + 1)
    base_from_tool_tip = locator.arm.frames(q)[-1] @ FLANGE_FROM_TOOL_TIP
    tool = base_from_tracker.inverse() @ base_from_tool_tip
    ref = body("body_ref", base_from_tracker.inverse() @ base_from_body)
    assert locator.in_base(ref) is None, "nobody knows yet where the tracker is"
    locator.see(q, tool, moving=True)
    assert locator.in_base(ref) is None, "in motion joints and tracker do not speak of one moment"
    locator.see(q, tool, moving=False)
    found = locator.in_base(ref)
    assert found is not None
    assert distance(found, base_from_body) < 1e-6
    assert locator.in_base(body("body_ref", base_from_body, valid=False)) is None


def test_tracker_noise_is_smoothed_and_motion_followed_at_once() -> None:
    locator, q, random = TrackerLocator(setup()), np.zeros(7), np.random.default_rng(1)
    base_from_tool_tip = locator.arm.frames(q)[-1] @ FLANGE_FROM_TOOL_TIP
    for base_from_tracker in (some_pose(1), some_pose(2)):
        errors = []
        for _ in range(400):
            noise = Transform.from_rotvec(random.normal(0.0, 5e-5, 3), random.normal(0.0, 7e-4, 3))
            locator.see(q, base_from_tracker.inverse() @ base_from_tool_tip @ noise, moving=False)
            assert locator.base_from_tracker is not None
            errors.append(distance(locator.base_from_tracker, base_from_tracker))
        assert max(errors) < 0.02
        assert np.median(errors[100:]) < 0.35 * errors[0] or np.median(errors[100:]) < 5e-4


@given(st.integers(0, 10_000))
def test_the_error_is_the_measured_pose_in_the_planned_one(seed: int) -> None:
    image_from_plan, body_from_image, tracker_from_body = (some_pose(seed + each) for each in range(3))
    planned_from_measured = Transform.from_rotvec((0.001, -0.002, 0.002), (0.0, 0.0, 0.01))
    tracker_from_tool_tip = tracker_from_body @ body_from_image @ image_from_plan @ planned_from_measured
    data = ProcedureDataView(
        landmarks=[], body_ref_from_image=as_message(body_from_image), plan=as_message(image_from_plan)
    )
    marker = tracker_from_tool_tip @ TOOL_MARKER_FROM_TOOL_TIP.inverse()
    found = placement_deviation(data, tool_tip(setup(), body("coil", marker)), body("body_ref", tracker_from_body))
    assert found is not None
    assert found.mm == pytest.approx((3.0, 1.0, -2.0, 2.0), abs=1e-6)
    assert found.degrees == pytest.approx(np.degrees(0.01), abs=1e-6)
    assert tool_tip(setup(), body("coil", marker, valid=False)) is None
    assert placement_deviation(data, None, body("body_ref", tracker_from_body)) is None
    assert placement_deviation(ProcedureDataView(landmarks=[]), None, None) is None


def test_residuals_are_in_body_ref() -> None:
    registered = Transform.from_rotvec((0.1, 0.0, 0.0), (0.0, 0.0, np.pi / 2))
    landmarks = [
        LandmarkShown(name="a", planned=(0.01, 0.0, 0.0), digitized=(0.1, 0.013, 0.0)),
        LandmarkShown(name="b", planned=(0.0, 0.01, 0.0)),
    ]
    data = ProcedureDataView(landmarks=landmarks, body_ref_from_image=as_message(registered))
    first, second = residuals(data)
    assert first == pytest.approx(0.003)
    assert second is None
    assert residuals(ProcedureDataView(landmarks=landmarks)) == [None, None]


def test_the_browser_gets_the_surface_that_the_daemon_has() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    read = trimesh.load_mesh(io.BytesIO(as_stl(np.array(mesh.vertices), np.array(mesh.faces))), file_type="stl")
    assert len(read.faces) == len(mesh.faces)
    assert read.volume == pytest.approx(mesh.volume, rel=1e-5)
    assert read.is_watertight


def test_a_pose_that_came_over_the_bus_stays_one() -> None:
    assert PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0)) == as_message(Transform.identity())


def test_the_zone_is_the_hull_and_its_margin() -> None:
    corners = np.array(trimesh.creation.box((0.1, 0.1, 0.1)).vertices)
    read = trimesh.load_mesh(io.BytesIO(as_zone(corners, 0.03)), file_type="stl")
    assert read.bounds == pytest.approx(np.array([[-0.08] * 3, [0.08] * 3]), abs=2e-3)
    far = np.linalg.norm(np.maximum(np.abs(read.vertices) - 0.05, 0.0), axis=1)
    assert far.max() <= 0.03 + 1e-6
    assert trimesh.load_mesh(io.BytesIO(as_zone(corners, 0.0)), file_type="stl").volume == pytest.approx(1e-3)
