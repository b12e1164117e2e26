"""What the scene shows is where it is."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.console.geometry import ArmFrames, TrackerLocator, as_stl, placement_deviation, residuals
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose, PoseMessage
from pcmrs.messages.setup import ArmShown, LandmarkShown, ProcedureDataView, Setup
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import as_message

FLANGE_FROM_COIL = Transform.from_rotvec((0.0, 0.01, 0.15), (3.1, 0.1, 0.0))


def shown(name: str) -> ArmShown:
    facts = find_arm(name)
    return ArmShown(
        name=name,
        joints=[as_message(each.parent_from_joint) for each in facts.joints],
        flange=as_message(facts.joint_from_flange),
        link_radius=facts.link_radius,
    )


def setup() -> Setup:
    return Setup(
        user="local", role="operator", lease_required=False, blueprint="", arm=shown("iiwa14"),
        flange_from_coil=as_message(FLANGE_FROM_COIL), tool_radius=0.05, tool_half_length=0.01, boxes=[], surface=None,
        patient="", operator="", residual_limit=0.004, drivers={},
    )  # fmt: skip


def body(name: str, pose: Transform, *, valid: bool = True) -> BodyPose:
    message = as_message(pose)
    return BodyPose(
        body=name, frame_number=1, captured=0.0, sent=0.0, valid=valid,
        position=message.position, quat_wxyz=message.quat_wxyz,
    )  # fmt: skip


def some_pose(seed: int) -> Transform:
    numbers = np.random.default_rng(seed).normal(size=6)
    return Transform.from_rotvec(numbers[:3], numbers[3:])


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
    base_from_coil = locator.arm.frames(q)[-1] @ FLANGE_FROM_COIL
    coil = body("coil", base_from_tracker.inverse() @ base_from_coil)
    ref = body("body_ref", base_from_tracker.inverse() @ base_from_body)
    assert locator.in_base(ref) is None, "nobody knows yet where the tracker is"
    locator.see(q, coil, moving=True)
    assert locator.in_base(ref) is None, "in motion joints and tracker do not speak of one moment"
    locator.see(q, coil, moving=False)
    found = locator.in_base(ref)
    assert found is not None
    assert distance(found, base_from_body) < 1e-6
    assert locator.in_base(body("body_ref", base_from_body, valid=False)) is None


def test_tracker_noise_is_smoothed_and_motion_followed_at_once() -> None:
    locator, q, random = TrackerLocator(setup()), np.zeros(7), np.random.default_rng(1)
    base_from_coil = locator.arm.frames(q)[-1] @ FLANGE_FROM_COIL
    for base_from_tracker in (some_pose(1), some_pose(2)):
        errors = []
        for _ in range(400):
            noise = Transform.from_rotvec(random.normal(0.0, 5e-5, 3), random.normal(0.0, 7e-4, 3))
            locator.see(q, body("coil", base_from_tracker.inverse() @ base_from_coil @ noise), moving=False)
            assert locator.base_from_tracker is not None
            errors.append(distance(locator.base_from_tracker, base_from_tracker))
        assert max(errors) < 0.02
        assert np.median(errors[100:]) < 0.35 * errors[0] or np.median(errors[100:]) < 5e-4


@given(st.integers(0, 10_000))
def test_the_error_is_the_measured_pose_in_the_planned_one(seed: int) -> None:
    image_from_plan, body_from_image, tracker_from_body = (some_pose(seed + each) for each in range(3))
    planned_from_measured = Transform.from_rotvec((0.001, -0.002, 0.002), (0.0, 0.0, 0.01))
    tracker_from_coil = tracker_from_body @ body_from_image @ image_from_plan @ planned_from_measured
    data = ProcedureDataView(
        landmarks=[], body_ref_from_image=as_message(body_from_image), plan=as_message(image_from_plan)
    )
    found = placement_deviation(data, body("coil", tracker_from_coil), body("body_ref", tracker_from_body))
    assert found is not None
    assert found.mm == pytest.approx((3.0, 1.0, -2.0, 2.0), abs=1e-6)
    assert found.degrees == pytest.approx(np.degrees(0.01), abs=1e-6)
    assert (
        placement_deviation(data, body("coil", tracker_from_coil, valid=False), body("body_ref", tracker_from_body))
        is None
    )
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
