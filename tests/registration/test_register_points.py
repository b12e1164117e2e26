import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import DegeneratePointsError, GeometryError
from pcmrs.registration import register_points
from pcmrs.spatial import Transform, distance, rotation_angle

seeds = st.integers(0, 2**32 - 1)
SQUARE = 0.1 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)


def random_motion(rng: np.random.Generator) -> Transform:
    return Transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))


def random_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in a box of unequal sides about corners that make them span a triangle."""
    corners = np.array([(0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)])
    return np.concatenate((corners, rng.uniform(-0.1, 0.1, (count - 3, 3)))) + rng.normal(size=3)


@given(seeds, st.integers(3, 12))
def test_a_rigid_motion_is_found_exactly(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    truth, moving = random_motion(rng), random_points(rng, count)
    found = register_points(truth @ moving, moving)
    assert rotation_angle(found.fixed_from_moving, truth) < 1e-12
    assert distance(found.fixed_from_moving, truth) < 1e-12
    assert found.rms < 1e-14


@given(seeds, st.integers(3, 12), st.floats(1e-5, 0.01))
def test_noisy_points_give_the_rotation_of_scipy(seed: int, count: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    truth, moving = random_motion(rng), random_points(rng, count)
    fixed = truth @ moving + rng.normal(scale=noise, size=moving.shape)
    found = register_points(fixed, moving)
    centred = fixed - fixed.mean(axis=0), moving - moving.mean(axis=0)
    expected, _ = Rotation.align_vectors(*centred)
    np.testing.assert_allclose(found.fixed_from_moving.rotation, expected.as_matrix(), atol=1e-6)
    # Not by SciPy's own sum, which is a difference of large squares and loses half of the digits of small residuals.
    left = centred[0] - centred[1] @ expected.as_matrix().T
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    assert found.residual == pytest.approx(found.distances.mean())
    assert found.residual <= found.rms + 1e-15


@given(seeds)
def test_coplanar_points_are_turned_never_mirrored(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_motion(rng)
    found = register_points(truth @ SQUARE, SQUARE)
    assert rotation_angle(found.fixed_from_moving, truth) < 1e-12


@given(seeds, st.floats(0.0, 0.002))
def test_noisy_coplanar_points_stay_near_the_truth(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    truth = random_motion(rng)
    found = register_points(truth @ SQUARE + rng.uniform(-noise, noise, SQUARE.shape), SQUARE)
    assert rotation_angle(found.fixed_from_moving, truth) < 0.2


@given(seeds)
def test_a_coplanar_set_mirrored_in_its_plane_is_turned_over(seed: int) -> None:
    """In space, a plane figure and its mirror image differ by half a turn only."""
    rng = np.random.default_rng(seed)
    truth = random_motion(rng)
    mirrored = SQUARE * (-1.0, 1.0, 1.0)
    found = register_points(truth @ mirrored, SQUARE)
    turned_over = Transform(np.diag((-1.0, 1.0, -1.0)), np.zeros(3))
    assert found.rms < 1e-14
    assert rotation_angle(found.fixed_from_moving, truth @ turned_over) < 1e-12


@given(seeds)
def test_a_mirrored_solid_gives_the_best_rotation_and_a_large_residual(seed: int) -> None:
    rng = np.random.default_rng(seed)
    moving = random_points(rng, 6)
    fixed = moving * (-1.0, 1.0, 1.0)
    found = register_points(fixed, moving)
    _, rssd = Rotation.align_vectors(fixed - fixed.mean(axis=0), moving - moving.mean(axis=0))
    assert np.linalg.det(found.fixed_from_moving.rotation) == pytest.approx(1.0)
    assert found.rms == pytest.approx(rssd / np.sqrt(6))


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (np.empty((0, 3)), "are 0"),
        (SQUARE[:2], "are 2"),
        (np.ones((5, 3)), "coincide"),
        (np.ones((5, 3)) + 1e-5 * np.eye(5, 3), "coincide"),
        (np.outer(np.arange(4.0), (0.1, 0.2, 0.3)), "line"),
        (np.outer(np.arange(4.0), (0.1, 0.2, 0.3)) + 1e-3 * np.eye(4, 3), "line"),
    ],
)
def test_degenerate_sets_are_refused_on_either_side(points: np.ndarray, text: str) -> None:
    proper = np.eye(max(3, len(points)), 3)[: len(points)] + np.arange(len(points))[:, None] ** 2
    for fixed, moving, which in ((points, points, "fixed"), (proper, points, "moving")):
        with pytest.raises(DegeneratePointsError, match=text) as caught:
            register_points(fixed, moving)
        assert len(caught.value.fields["singular_values"]) == 3
        if len(points) >= 3:
            assert caught.value.fields["points"] == which


def test_malformed_points_are_refused() -> None:
    broken = SQUARE.copy()
    broken[2, 1] = np.nan
    with pytest.raises(GeometryError, match=r"\[2\].*not finite"):
        register_points(SQUARE, broken)
    with pytest.raises(GeometryError, match="4 fixed points but 3 moving"):
        register_points(SQUARE, SQUARE[:3])
    with pytest.raises(GeometryError, match="shape"):
        register_points(SQUARE[:, :2], SQUARE)
