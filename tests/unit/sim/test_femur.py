import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats
from pcmrs_sim.femur import BASE, HEAD_CENTRE, LANDMARKS, distance, distances, from_base, surface_point
from tests.support.trials import examples

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).map(np.array).filter(lambda d: np.linalg.norm(d) > 0.1)
insides = st.sampled_from([BASE, HEAD_CENTRE, from_base(0.0, 0.0, -0.1)])


@examples(50)
@given(insides, directions)
def test_a_ray_leaves_the_bone_where_its_surface_ends(inside: Floats, direction: Floats) -> None:
    point = surface_point(inside, direction)
    outwards = direction / np.linalg.norm(direction)
    assert abs(distance(point)) < 1e-9
    assert np.allclose(np.cross(point - inside, direction), 0.0, atol=1e-12)
    assert np.dot(point - inside, direction) > 0.0
    assert distances(point + np.linspace(1e-4, 0.2, 100)[:, None] * outwards).min() > 0.0


def test_the_landmarks_lie_on_the_bone_where_anatomy_has_them() -> None:
    at = {landmark.name: landmark.position for landmark in LANDMARKS}
    assert len(at) == 4
    assert max(abs(distance(point)) for point in at.values()) < 1e-9
    assert at["greater_trochanter"][0] > at["lateral_shaft"][0] > at["lesser_trochanter"][0] > at["femoral_head"][0]
    assert at["femoral_head"][2] > at["greater_trochanter"][2] > at["lesser_trochanter"][2] > at["lateral_shaft"][2]
