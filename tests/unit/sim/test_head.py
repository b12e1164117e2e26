import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats
from pcmrs_sim.head import CENTRE, EXPONENT, LANDMARKS, SEMI_AXES, outward_normal, surface_point

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).map(np.array).filter(lambda d: np.linalg.norm(d) > 0.1)


def level(point: Floats) -> float:
    """Below 1 inside of the head, above 1 outside."""
    return float(np.sum(np.abs((point - CENTRE) / SEMI_AXES) ** EXPONENT))


@given(directions)
def test_surface_points_lie_on_the_surface_in_their_direction(direction: Floats) -> None:
    point = surface_point(direction)
    assert np.isclose(level(point), 1.0, atol=1e-9)
    assert np.allclose(np.cross(point - CENTRE, direction), 0.0, atol=1e-12)
    assert np.dot(point - CENTRE, direction) > 0.0


@given(directions, directions)
def test_normal_is_perpendicular_to_the_surface_and_points_out(direction: Floats, other: Floats) -> None:
    point = surface_point(direction)
    normal = outward_normal(point)
    neighbour = surface_point(direction + 1e-6 * other)
    assert np.isclose(np.linalg.norm(normal), 1.0)
    assert abs(np.dot(neighbour - point, normal)) < 1e-3 * np.linalg.norm(neighbour - point) + 1e-12
    assert level(point + 1e-4 * normal) > 1.0


def test_landmarks_have_the_size_of_a_face() -> None:
    at = {landmark.name: landmark.position for landmark in LANDMARKS}
    assert len(at) == 6
    assert all(level(position) > 1.0 - 1e-9 for position in at.values())
    assert at["left_tragus"][0] < CENTRE[0] < at["right_tragus"][0]
    assert 0.08 < np.linalg.norm(at["left_outer_canthus"] - at["right_outer_canthus"]) < 0.11
    assert at["nose_tip"][1] == max(position[1] for position in at.values())
