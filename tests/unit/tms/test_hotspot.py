"""The hot-spot search: where it goes, what it finds, what it refuses; both methods behind one interface."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError, RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import as_message, as_transform, heading
from pcmrs.tms.settings import HotspotMethod
from tests.support.trials import examples
from tests.unit.tms.heads import phantom
from tests.unit.tms.searches import MOST_PULSES, RNG, away, begun, run, subject_at

METHODS: tuple[HotspotMethod, ...] = ("adaptive", "grid")
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
