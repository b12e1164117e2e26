"""Hot-spots of simulated subjects: number of pulses after which each method stays near the true one.

The subjects are those of `pcmrs_sim.tms.subject` on the head phantom. Every method gets the same subjects and starts at
the same usual place, which is not theirs. There is no daemon: the coil is exactly where it should be, and amplitudes
are measured without noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import msgspec
import numpy as np

from pcmrs.formats.mesh import Mesh, read_mesh
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import as_transform, hand_area, heading
from pcmrs.tms.settings import HotspotMethod, HotspotSettings
from pcmrs.workflows.settings import BodySettings
from pcmrs.workflows.surface import find_surface
from pcmrs_sim.tms.subject import Subject, draw

METHODS: tuple[HotspotMethod, ...] = get_args(HotspotMethod)
NEAR = 0.005
"""Largest distance from the hot-spot at which an estimate counts as near, m."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Result of one search of one subject.

    Attributes:
        errors: Distance of the estimate from the hot-spot after every pulse, m; infinite before the first response.
        heading_error: Final error of the handle, rad; None if there was no response.
    """

    subject: Subject
    search: HotspotSearch
    errors: tuple[float, ...]
    heading_error: float | None

    @property
    def near_after(self) -> int | None:
        """Number of pulses after which the estimate stayed within `NEAR`; None if it is not at the end."""
        far = [number for number, error in enumerate(self.errors, 1) if not error <= NEAR]
        last = far[-1] if far else 0
        return None if last == len(self.errors) else last + 1


class SubjectQuantiles(msgspec.Struct, frozen=True):
    """Median and 95th percentile over all subjects; None if it exceeds every number."""

    median: float | None
    p95: float | None


class HotspotResult(msgspec.Struct, frozen=True):
    """Result of one method over all subjects.

    Attributes:
        near: Share of the searches that ended within 5 mm of the hot-spot.
        pulses_until_near: Number of pulses after which the estimate was within 5 mm and stayed there.
        pulses: Number of pulses of whole searches.
        error_mm: Distance of the final estimate, mm.
        heading_error_deg: Error of its handle, °.
        uncertainty_mm: Final uncertainty that the method states, mm.
        unanswered: Number of searches without any response; they count as not near, and have no error.
    """

    method: str
    near: float
    pulses_until_near: SubjectQuantiles
    pulses: SubjectQuantiles
    error_mm: SubjectQuantiles
    heading_error_deg: SubjectQuantiles
    uncertainty_mm: SubjectQuantiles
    unanswered: int


class HotspotReport(msgspec.Struct, frozen=True):
    """Results of all methods on the same subjects.

    Attributes:
        intensity: Intensity of all pulses, percent of the subject's threshold at the hot-spot.
        expected_mm: Distance of the hot-spots from the start of every search, mm.
    """

    experiment: str
    seed: int
    subjects: int
    simulated: bool
    intensity: float
    expected_mm: SubjectQuantiles
    methods: list[HotspotResult]


def run_hotspots(
    subjects: int, seed: int, intensity: float, progress: Callable[[str, int, int], None]
) -> tuple[HotspotReport, dict[str, list[SearchResult]], Mesh]:
    """Search every subject's hot-spot by every method; equal seeds give equal results.

    Args:
        subjects: Number of subjects, at least one.
        seed: Seed of subjects and of their variability.
        intensity: Percent of the subject's motor threshold at the hot-spot.
        progress: Called with the number of finished subjects.

    Returns:
        Report, the searches by method, and the mesh of the head.
    """
    mesh = read_mesh(find_surface(BodySettings(surface="head_phantom.ply")), "m", "RAS")
    closest = TriangleSurface(mesh.vertices, mesh.faces).closest
    centre = hand_area(closest, mesh.vertices[np.argmax(mesh.vertices[:, 2])])
    started = {method: HotspotSearch.begin(HotspotSettings(method=method), closest, centre) for method in METHODS}
    searched: dict[str, list[SearchResult]] = {method: [] for method in METHODS}
    for number in range(subjects):
        progress("hot-spots", number, subjects)
        subject = draw(closest, centre, np.random.default_rng((seed, number)))
        for index, method in enumerate(METHODS):
            rng = np.random.default_rng((seed, number, index))
            searched[method].append(search_hotspot(subject, started[method], intensity, rng))
    progress("done", subjects, subjects)
    distances = [float(np.linalg.norm(_place(each.subject) - centre.translation)) for each in searched[METHODS[0]]]
    report = HotspotReport(
        experiment="hotspots",
        seed=seed,
        subjects=subjects,
        simulated=True,
        intensity=intensity,
        expected_mm=_quantiles([1e3 * value for value in distances]),
        methods=[_result(method, found) for method, found in searched.items()],
    )
    return report, searched, mesh


def search_hotspot(subject: Subject, search: HotspotSearch, intensity: float, rng: np.random.Generator) -> SearchResult:
    """Perform one whole search.

    Args:
        subject: Simulated subject.
        search: Search before the first pulse.
        intensity: Intensity, percent of the subject's threshold; limited by the stimulator's maximum.
        rng: Source of randomness.

    Returns:
        Result of the search.
    """
    percent = min(intensity / 100.0 * subject.recruitment.threshold, 100.0)
    errors = []
    while not search.finished:
        pose = search.next()
        search = search.after(pose, subject.response(as_transform(pose), percent, rng))
        errors.append(_error(subject, search))
    turned = heading(subject.image_from_hotspot, _estimate(search)) if search.responded else None
    return SearchResult(subject, search, tuple(errors), None if turned is None else abs(turned))


def _error(subject: Subject, search: HotspotSearch) -> float:
    return float(np.linalg.norm(_estimate(search).translation - _place(subject))) if search.responded else float("inf")


def _estimate(search: HotspotSearch) -> Transform:
    return as_transform(search.estimate.image_from_coil)


def _place(subject: Subject) -> Floats:
    return subject.image_from_hotspot.translation


def _result(method: str, found: list[SearchResult]) -> HotspotResult:
    answered = [each for each in found if each.search.responded]
    near = [each.near_after for each in found]
    return HotspotResult(
        method=method,
        near=sum(each is not None for each in near) / len(near),
        pulses_until_near=_quantiles([float("inf") if each is None else each for each in near]),
        pulses=_quantiles([len(each.search.pulses) for each in found]),
        error_mm=_quantiles([1e3 * each.errors[-1] for each in answered]),
        heading_error_deg=_quantiles(
            [np.degrees(each.heading_error) for each in answered if each.heading_error is not None]
        ),
        uncertainty_mm=_quantiles([1e3 * each.search.estimate.uncertainty for each in answered]),
        unanswered=len(found) - len(answered),
    )


def _quantiles(values: list[float]) -> SubjectQuantiles:
    """Return median and p95 of numbers that may be infinite: the smallest value that enough of them do not exceed."""
    if not values:
        return SubjectQuantiles(None, None)
    median, p95 = np.quantile(values, (0.5, 0.95), method="inverted_cdf").tolist()
    return SubjectQuantiles(*(value if np.isfinite(value) else None for value in (median, p95)))
