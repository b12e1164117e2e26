"""The hot-spot search: where it goes, what it finds, what it refuses; both methods behind one interface."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from pcmrs.errors import GeometryError, RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Transform
from pcmrs.tms.adaptive import NOISE_DECADES, SPREAD_DECADES, posterior
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import along_scalp, as_message, as_transform, heading, turned
from pcmrs.tms.settings import HotspotMethod, HotspotSettings
from pcmrs_sim.tms.subject import Subject
from tests.support.trials import examples
from tests.unit.tms.heads import RADIUS, TOP, Steady, phantom, sphere

METHODS: tuple[HotspotMethod, ...] = ("adaptive", "grid")
RNG = np.random.default_rng(0)


def begun(method: HotspotMethod = "adaptive", **given: float) -> HotspotSearch:
    surface, centre = phantom()
    chosen = msgspec.convert({"method": method, **given}, HotspotSettings)
    return HotspotSearch.begin(chosen, surface.closest, centre)


def subject_at(x: float, y: float, angle: float) -> Subject:
    surface, centre = phantom()
    (hotspot,) = along_scalp(surface.closest, centre, [[x, y]])
    return Subject(Steady(50.0), turned(hotspot, angle))


def run(search: HotspotSearch, subject: Subject, shift: Transform | None = None) -> HotspotSearch:
    """The whole search; `shift` is how the coil is off in its own frame."""
    while not search.finished:
        pose = as_transform(search.next())
        measured = pose if shift is None else pose @ shift
        search = search.after(as_message(measured), subject.response(measured, 60.0, RNG))
        assert len(search.pulses) <= MOST_PULSES
    return search


def away(search: HotspotSearch, subject: Subject) -> float:
    found = as_transform(search.estimate.image_from_coil)
    return float(np.linalg.norm(found.translation - subject.image_from_hotspot.translation))


MOST_PULSES = 200
"""No search of these tests asks for more."""
HOTSPOTS = [(0.0, 0.0, 0.0), (0.008, -0.004, 0.3), (-0.009, 0.009, -0.5), (0.002, 0.013, 0.1), (-0.012, -0.006, -0.2)]


@pytest.mark.parametrize("hotspot", HOTSPOTS)
@pytest.mark.parametrize("method", METHODS)
def test_a_steady_muscle_leads_to_the_hotspot(method: HotspotMethod, hotspot: tuple[float, float, float]) -> None:
    subject = subject_at(*hotspot)
    ended = run(begun(method), subject)
    assert away(ended, subject) < 0.005
    found = as_transform(ended.estimate.image_from_coil)
    assert abs(heading(subject.image_from_hotspot, found)) < math.radians(20.0)
    assert len(ended.pulses) <= 60


@pytest.mark.parametrize("method", METHODS)
def test_measured_pose_of_the_coil_counts(method: HotspotMethod) -> None:
    """A robot that is off by 3 mm and 3 degrees throughout does not shift what is found."""
    subject = subject_at(0.006, 0.003, 0.2)
    shift = Transform.from_rotvec((0.003, 0.0, 0.0), (0.0, 0.0, 0.05))
    assert away(run(begun(method), subject, shift), subject) < 0.004


@pytest.mark.parametrize("method", METHODS)
def test_journalled_search_continues_unchanged(method: HotspotMethod) -> None:
    subject = subject_at(0.005, 0.005, 0.2)
    search = begun(method)
    for _ in range(25):
        read = msgspec.json.decode(msgspec.json.encode(search), type=HotspotSearch)
        assert read == search
        assert read.next() == search.next()
        pose = search.next()
        search = search.after(pose, subject.response(as_transform(pose), 60.0, RNG))
    assert msgspec.json.decode(msgspec.json.encode(search), type=HotspotSearch).estimate == search.estimate


def test_grid_mapping_visits_all_places_then_turns_the_handle() -> None:
    """It turns the handle at the middle."""
    subject, search = subject_at(0.006, -0.006, 0.3), begun("grid", pulses_per_place=2)
    asked = []
    while not search.finished:
        asked.append(search.next())
        search = search.after(asked[-1], subject.response(as_transform(asked[-1]), 60.0, RNG))
        assert len(asked) <= MOST_PULSES
    assert asked[0::2] == asked[1::2]
    for pose, place in zip(asked[0:74:2], search.places, strict=True):
        assert np.allclose(as_transform(pose).matrix, as_transform(place).matrix, atol=1e-12)
    turning = [as_transform(pose) for pose in asked[74::2]]
    assert np.ptp([pose.translation for pose in turning], axis=0).max() < 1e-9
    middle = search.pose_at(turning[0].translation)
    assert np.degrees([heading(middle, pose) for pose in turning]) == pytest.approx(np.arange(-45.0, 46.0, 15.0))


def test_the_middle_of_a_map_is_the_centre_of_gravity() -> None:
    search = begun("grid", rings=1)
    amplitudes = [100e-6, 300e-6, 49e-6, 0.0, 60e-6, 50e-6, 1e-3]
    for amplitude in amplitudes:
        search = search.after(search.next(), amplitude)
    weights = np.array([100, 300, 0, 0, 60, 50, 1000]) / 1510.0
    middle = weights @ np.array([place.position for place in search.places])
    found = as_transform(search.estimate.image_from_coil)
    away_from_it = found.inverse() @ middle
    assert np.linalg.norm(away_from_it[:2]) < 1e-4  # it is lifted onto the scalp
    assert -1e-3 < away_from_it[2] <= 0.0


def test_pulses_per_place_repeat_what_was_asked_for() -> None:
    search = begun("adaptive", pulses_per_place=3)
    asked = []
    for number in range(9):
        asked.append(search.next())
        search = search.after(asked[-1], (number + 1) * 20e-6)
    assert asked[0] == asked[1] == asked[2] != asked[3] == asked[4] == asked[5] != asked[6]


@examples(25)
@given(
    st.sampled_from(METHODS),
    st.lists(st.one_of(st.floats(0.0, 0.1), st.sampled_from([0.0, 1e-300, 49.9e-6, 50e-6, 0.1])), max_size=45),
    st.integers(0, 2**32 - 1),
)
def test_whatever_is_measured_proposals_stay_within_the_region(
    method: HotspotMethod, amplitudes: list[float], seed: int
) -> None:
    """Amplitudes are anything, and the coil is anywhere near."""
    rng, search = np.random.default_rng(seed), begun(method)
    surface, _ = phantom()
    places = np.array([place.position for place in search.places])
    for amplitude in amplitudes:
        if search.finished:
            break
        pose = as_transform(search.next())
        assert np.linalg.norm(places - pose.translation, axis=1).min() < 0.0071
        nearest, normals = surface.closest(pose.translation[None])
        assert np.linalg.norm(nearest[0] - pose.translation) < 2e-4
        assert pose.rotation[:, 2] @ normals[0] > math.cos(math.radians(2.0))
        off = Transform.from_rotvec(rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.3, 3))
        search = search.after(as_message(pose @ off), amplitude)
    if search.responded:
        assert math.isfinite(search.estimate.uncertainty)
        assert np.linalg.norm(places - search.estimate.image_from_coil.position, axis=1).min() < 0.05


def test_poses_between_the_places_lie_on_the_scalp() -> None:
    """On a sphere, where the scalp is known without edges."""
    search = HotspotSearch.begin(HotspotSettings(), sphere, TOP)
    rng = np.random.default_rng(3)
    for x, y in rng.uniform(-0.015, 0.015, (50, 2)):
        pose = search.pose_at(np.array((x, y, 0.98 * RADIUS)), 0.4)
        assert np.linalg.norm(pose.translation) == pytest.approx(RADIUS, abs=1e-5)
        assert pose.rotation[:, 2] @ pose.translation / RADIUS > math.cos(math.radians(0.2))
        (carried,) = along_scalp(sphere, TOP, RADIUS * np.arccos(pose.translation[2] / RADIUS) * _unit(x, y)[None])
        assert heading(carried, pose) == pytest.approx(0.4, abs=0.01)


def _unit(x: float, y: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array((x, y)) / math.hypot(x, y)


@given(st.integers(0, 2**32 - 1))
@examples(20)
def test_the_process_is_that_of_scikit_learn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inputs, candidates = rng.normal(size=(12, 4)), rng.normal(size=(9, 4))
    outputs = rng.normal(size=12)
    kernel = ConstantKernel(SPREAD_DECADES**2) * RBF(1.0)
    oracle = GaussianProcessRegressor(kernel, alpha=NOISE_DECADES**2, optimizer=None).fit(inputs, outputs)
    expected, spread = oracle.predict(candidates, return_cov=True)
    mean, covariance = posterior(candidates, inputs, outputs)
    assert np.allclose(mean, expected, atol=1e-9)
    assert np.allclose(covariance, spread, atol=1e-9)


def test_adaptive_search_ends_at_a_known_place_or_at_its_budget() -> None:
    subject = subject_at(0.005, 0.0, 0.1)
    loose = run(begun("adaptive", uncertainty_mm=6.0), subject)
    assert 20 <= len(loose.pulses) < 40
    assert loose.estimate.uncertainty <= 0.006
    assert len(run(begun("adaptive", uncertainty_mm=50.0), subject).pulses) == 20
    assert len(run(begun("adaptive", uncertainty_mm=0.1, max_pulses=25), subject).pulses) == 25


def test_the_expected_map_is_highest_near_the_hotspot() -> None:
    subject = subject_at(0.007, 0.0, 0.0)
    search = run(begun("grid"), subject)
    places = [as_transform(place) for place in search.places]
    best = places[int(np.argmax(search.expected_amplitudes(places)))]
    assert np.linalg.norm(best.translation - subject.image_from_hotspot.translation) < 0.007


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("amplitude", [math.nan, math.inf, -math.inf, -1e-9, 1.0])
def test_invalid_amplitude_is_refused(method: HotspotMethod, amplitude: float) -> None:
    search = begun(method)
    with pytest.raises(RefusalError) as refused:
        search.after(search.next(), amplitude)
    assert refused.value.refusal_code == "bad_amplitude"


def test_invalid_pose_is_refused() -> None:
    for pose in (
        PoseMessage(position=(0.0, math.nan, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0)),
        PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(0.0, 0.0, 0.0, 0.0)),
    ):
        with pytest.raises(GeometryError):
            begun().after(pose, 1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_no_response_gives_no_hotspot_and_no_pulse_after_the_end(method: HotspotMethod) -> None:
    search = begun(method)
    while not search.finished:
        search = search.after(search.next(), 20e-6)
        assert len(search.pulses) <= MOST_PULSES
    assert not search.responded
    with pytest.raises(RefusalError) as refused:
        _ = search.estimate
    assert refused.value.refusal_code == "no_response"
    with pytest.raises(RefusalError) as refused:
        search.next()
    assert refused.value.refusal_code == "search_finished"


@pytest.mark.parametrize(
    "given",
    [
        {"method": "random"},
        {"spacing_mm": 0.0},
        {"rings": 0},
        {"rings": 7},
        {"rings": 6, "heading_step_deg": 5.0},
        {"min_pulses": 50, "max_pulses": 40},
        {"pulses_per_place": 0},
        {"uncertainty_mm": -1.0},
        {"seed": 1},
    ],
)
def test_settings_that_make_no_search_are_refused(given: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(given, HotspotSettings)
