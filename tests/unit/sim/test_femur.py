import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.registration import register_points
from pcmrs.spatial import Floats
from pcmrs_lab.experiment.published import PUBLISHED, FailureRun
from pcmrs_sim.femur import BASE, HEAD_CENTRE, LANDMARKS, distance, distances, from_base, surface_point
from tests.support.trials import examples

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).map(np.array).filter(lambda d: np.linalg.norm(d) > 0.1)
insides = st.sampled_from([BASE, HEAD_CENTRE, from_base(0.0, 0.0, -0.1)])

DEVIATION = 1.03e-3
"""Of a digitized landmark of the femur, m per axis."""
LIMIT = 2.7e-3
"""Residual that the workflow accepts, m."""
POINTS = np.array([landmark.position for landmark in LANDMARKS])


def residuals(offset: Floats, count: int) -> Floats:
    """Residuals of digitizations with an offset, m, (4, 3), (count,)."""
    rng = np.random.default_rng(0)
    touches = POINTS + offset + rng.normal(0.0, DEVIATION, (count, *POINTS.shape))
    return np.array([register_points(touched, POINTS).residual for touched in touches])


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


def test_usual_digitizations_have_the_published_residual() -> None:
    """They pass the limit."""
    controls = residuals(np.zeros((4, 3)), 2000)
    published = [run.residual_mm for run in PUBLISHED["femoroplasty"].failures if run.injection == "none"]
    assert min(filter(None, published)) < controls.mean() * 1e3 < max(filter(None, published))
    assert np.quantile(controls, 0.999) < LIMIT


@pytest.mark.parametrize("run", [run for run in PUBLISHED["femoroplasty"].failures if run.offset_in_image])
def test_every_published_digitization_error_is_beyond_the_limit(run: FailureRun) -> None:
    assert run.landmark is not None
    assert run.offset_in_image is not None
    offset = np.zeros((4, 3))
    offset[run.landmark - 1] = run.offset_in_image
    assert residuals(offset, 500).min() > 2 * LIMIT
