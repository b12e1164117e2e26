from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform, distance, mean_transform, rotation_angle

coordinates = st.tuples(*[st.floats(-10.0, 10.0)] * 3)
rotvecs = st.tuples(*[st.floats(-1.8, 1.8)] * 3)
transforms = st.builds(Transform.from_rotvec, coordinates, rotvecs)


def same(a: Transform, b: Transform) -> None:
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-12)


@given(transforms, transforms, coordinates)
def test_composition_is_the_product_of_homogeneous_matrices(a: Transform, b: Transform, point: tuple[float]) -> None:
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-12)
    np.testing.assert_allclose((a @ b) @ point, a @ (b @ point), atol=1e-12)


@given(transforms)
def test_inverse_undoes(a: Transform) -> None:
    np.testing.assert_allclose((a @ a.inverse()).matrix, np.eye(4), atol=1e-13)
    np.testing.assert_allclose((a.inverse() @ a).matrix, np.eye(4), atol=1e-13)


@given(transforms)
def test_every_form_gives_the_same_transform_back(a: Transform) -> None:
    for again in (
        Transform.from_quat_wxyz(a.translation, a.quat_wxyz),
        Transform.from_quat_xyzw(a.translation, a.quat_xyzw),
        Transform.from_rotvec(a.translation, a.rotvec),
        Transform.from_matrix(a.matrix),
    ):
        np.testing.assert_allclose(again.matrix, a.matrix, atol=1e-12)
    assert a.quat_wxyz[0] == a.quat_xyzw[3] >= 0.0


@given(transforms)
def test_another_process_gets_the_same_numbers(a: Transform) -> None:
    for sent in (a, a.inverse()):  # whose rotation is a transposed view
        got = pickle.loads(pickle.dumps(sent))
        np.testing.assert_array_equal(got.matrix, sent.matrix)
        assert not got.rotation.flags.writeable
        assert not got.translation.flags.writeable


def test_points_map_one_by_one_or_as_rows() -> None:
    quarter_turn = Transform.from_quat_wxyz((1, 0, 0), (math.sqrt(0.5), 0, 0, math.sqrt(0.5)))
    np.testing.assert_allclose(quarter_turn @ (1.0, 0.0, 0.0), (1, 1, 0), atol=1e-15)
    np.testing.assert_allclose(quarter_turn @ np.eye(3), [(1, 1, 0), (0, 0, 0), (1, 0, 1)], atol=1e-15)


@given(transforms, rotvecs)
def test_rotation_angle_is_that_of_scipy_and_distance_of_origins(a: Transform, turn: tuple[float]) -> None:
    b = a @ Transform.from_rotvec((0.3, 0.0, 0.4), turn)
    assert rotation_angle(a, b) == pytest.approx(Rotation.from_rotvec(turn).magnitude(), abs=1e-12)
    assert distance(a, b) == pytest.approx(0.5)


def test_rotation_angle_keeps_small_angles_and_half_turns() -> None:
    for angle in (0.0, 1e-12, 1e-9, math.pi):
        turned = Transform.from_rotvec((0, 0, 0), (angle, 0, 0))
        assert rotation_angle(Transform.identity(), turned) == pytest.approx(angle, rel=1e-6, abs=0)


@given(transforms, rotvecs, coordinates)
def test_mean_of_opposite_deviations_is_the_middle(a: Transform, turn: tuple[float], shift: tuple[float]) -> None:
    small = 0.4 * np.asarray(turn)
    deviating = [a @ Transform.from_rotvec(sign * np.asarray(shift), sign * small) for sign in (1.0, -1.0)]
    mean = mean_transform(deviating)
    assert rotation_angle(mean, a) < 1e-7
    assert distance(mean, a) < 1e-12


def test_mean_of_nothing_is_refused() -> None:
    with pytest.raises(GeometryError, match="at least one"):
        mean_transform([])


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag((1.0, 1.0, -1.0)),
        2.0 * np.eye(3),
        np.eye(3) + 1e-4,
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
        np.eye(4),
    ],
)
def test_invalid_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(GeometryError):
        Transform(matrix, np.zeros(3))


def test_other_malformed_numbers_are_refused() -> None:
    for bad in ((0.0, 0.0), (np.inf, 0.0, 0.0), ("a", "b", "c")):
        with pytest.raises(GeometryError, match="translation"):
            Transform.from_quat_wxyz(bad, (1, 0, 0, 0))
    with pytest.raises(GeometryError, match="length 0"):
        Transform.from_quat_xyzw((0, 0, 0), (0, 0, 0, 0))
    with pytest.raises(GeometryError, match=r"length 1\.1"):
        Transform.from_quat_wxyz((0, 0, 0), (1.1, 0, 0, 0))
    with pytest.raises(GeometryError, match="last row"):
        Transform.from_matrix(np.ones((4, 4)))
    with pytest.raises(GeometryError, match="shape"):
        Transform.identity() @ (1.0, 2.0)


def test_a_rounded_quaternion_is_normalized() -> None:
    rotation = Transform.from_quat_xyzw((0, 0, 0), (0.7071, 0, 0, 0.7071)).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)


def test_a_transform_cannot_be_changed_through_its_arrays() -> None:
    source = np.zeros(3)
    a = Transform(np.eye(3), source)
    source[0] = 1.0
    assert a.translation[0] == 0.0
    for transform in (a, a @ a, a.inverse()):
        with pytest.raises(ValueError, match="read-only"):
            transform.translation[0] = 1.0


@given(coordinates, st.tuples(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0)))
def test_angles_about_z_y_and_x_are_those_of_scipy(position: tuple[float], angles: tuple[float]) -> None:
    a = Transform.from_zyx(position, angles)
    np.testing.assert_allclose(a.rotation, Rotation.from_euler("ZYX", angles).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(a.rotation, Rotation.from_euler("xyz", angles[::-1]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(a.zyx, angles, atol=1e-9)
    assert tuple(a.translation) == position


@pytest.mark.parametrize("middle", [-math.pi / 2, math.pi / 2])
@given(first=st.floats(-3.0, 3.0), last=st.floats(-3.0, 3.0))
def test_angles_at_gimbal_lock_give_the_same_pose(middle: float, first: float, last: float) -> None:
    """The first and the last axis are one there."""
    a = Transform.from_zyx((0, 0, 0), (first, middle, last))
    assert a.zyx[2] == 0.0
    np.testing.assert_allclose(Transform.from_zyx((0, 0, 0), a.zyx).rotation, a.rotation, atol=1e-9)


@given(st.lists(rotvecs, min_size=1, max_size=6))
def test_the_mean_rotation_is_that_of_scipy(turns: list[tuple[float]]) -> None:
    around = [Rotation.from_rotvec(0.5 * np.array(turn)) for turn in turns]  # near each other: one mean
    mean = mean_transform([Transform(turn.as_matrix(), np.zeros(3)) for turn in around])
    expected = Rotation.concatenate(around).mean().as_matrix()
    np.testing.assert_allclose(mean.rotation, expected, atol=1e-9)


@given(transforms, transforms)
def test_a_composition_is_a_rigid_transform(a: Transform, b: Transform) -> None:
    Transform(*((a @ b).rotation, (a @ b).translation))  # refuses what is none


@given(transforms, transforms, transforms)
def test_composition_is_associative(a: Transform, b: Transform, c: Transform) -> None:
    same((a @ b) @ c, a @ (b @ c))


@given(transforms)
def test_the_identity_is_neutral(a: Transform) -> None:
    same(a @ Transform.identity(), a)
    same(Transform.identity() @ a, a)


@given(transforms, transforms)
def test_inverses_are_two_sided_and_turn_the_order_round(a: Transform, b: Transform) -> None:
    same(a @ a.inverse(), Transform.identity())
    same(a.inverse() @ a, Transform.identity())
    same((a @ b).inverse(), b.inverse() @ a.inverse())
