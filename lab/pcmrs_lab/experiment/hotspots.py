"""Hot-spots of simulated subjects: after how many pulses each method is near the true one, and stays there.

The subjects are those of `pcmrs_sim.tms.subject` on the head phantom. Every method gets the same subjects and begins at
the same usual place, which is not theirs. No daemon: the coil is where it should be, and amplitudes are as they are.
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
"""As far as an estimate may be from the hot-spot, m."""


@dataclass(frozen=True, slots=True)
class Searched:
    """One search of one subject.

    Attributes:
        errors: Distance of the estimate from the hot-spot after every pulse, m; infinite before the first response.
        heading_error: Of the handle in the end, rad; None where there was no response.
    """

    subject: Subject
    search: HotspotSearch
    errors: tuple[float, ...]
    heading_error: float | None

    @property
    def near_after(self) -> int | None:
        """Pulses after which the estimate was within `NEAR` and stayed so; None where it is not in the end."""
        far = [number for number, error in enumerate(self.errors, 1) if not error <= NEAR]
        last = far[-1] if far else 0
        return None if last == len(self.errors) else last + 1


class SubjectQuantiles(msgspec.Struct, frozen=True):
    """Of a series over all subjects: half of it is not above the median, 95 % not above p95; None is beyond any."""

    median: float | None
    p95: float | None


class HotspotResult(msgspec.Struct, frozen=True):
    """One method over all subjects.

    Attributes:
        near: Share of the searches that ended within 5 mm of the hot-spot.
        pulses_until_near: After which the estimate was within 5 mm and stayed so.
        pulses: Of whole searches.
        error_mm: Distance of the final estimate.
        heading_error_deg: Of its handle.
        uncertainty_mm: That the method states in the end.
        unanswered: Searches without any response; they are in no error, and not near.
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
    """All methods on the same subjects.

    Attributes:
        intensity: Of all pulses, percent of the subject's threshold at the hot-spot.
        expected_mm: How far the hot-spots are from where every search begins.
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
) -> tuple[HotspotReport, dict[str, list[Searched]], Mesh]:
    """Searches every subject's hot-spot by every method; one seed gives one result.

    Args:
        subjects: How many, at least one.
        seed: Of subjects and of their variability.
        intensity: Percent of the subject's motor threshold at the hot-spot.
        progress: Told how many subjects of how many are done.

    Returns:
        The report, of each method its searches, and the head that they were made on.
    """
    mesh = read_mesh(find_surface(BodySettings(surface="head_phantom.ply")), "m", "RAS")
    closest = TriangleSurface(mesh.vertices, mesh.faces).closest
    centre = hand_area(closest, mesh.vertices[np.argmax(mesh.vertices[:, 2])])
    begun = {method: HotspotSearch.begin(HotspotSettings(method=method), closest, centre) for method in METHODS}
    searched: dict[str, list[Searched]] = {method: [] for method in METHODS}
    for number in range(subjects):
        progress("hot-spots", number, subjects)
        subject = draw(closest, centre, np.random.default_rng((seed, number)))
        for index, method in enumerate(METHODS):
            rng = np.random.default_rng((seed, number, index))
            searched[method].append(search_hotspot(subject, begun[method], intensity, rng))
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


def search_hotspot(subject: Subject, search: HotspotSearch, intensity: float, rng: np.random.Generator) -> Searched:
    """One whole search; the intensity in percent of the subject's threshold, as far as the stimulator goes."""
    percent = min(intensity / 100.0 * subject.recruitment.threshold, 100.0)
    errors = []
    while not search.finished:
        pose = search.next()
        search = search.after(pose, subject.response(as_transform(pose), percent, rng))
        errors.append(_error(subject, search))
    turned = heading(subject.image_from_hotspot, _estimate(search)) if search.responded else None
    return Searched(subject, search, tuple(errors), None if turned is None else abs(turned))


def _error(subject: Subject, search: HotspotSearch) -> float:
    return float(np.linalg.norm(_estimate(search).translation - _place(subject))) if search.responded else float("inf")


def _estimate(search: HotspotSearch) -> Transform:
    return as_transform(search.estimate.image_from_coil)


def _place(subject: Subject) -> Floats:
    return subject.image_from_hotspot.translation


def _result(method: str, found: list[Searched]) -> HotspotResult:
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
    """Of numbers that may be infinite; whole ones stay so: the smallest that enough of them do not exceed."""
    if not values:
        return SubjectQuantiles(None, None)
    median, p95 = np.quantile(values, (0.5, 0.95), method="inverted_cdf").tolist()
    return SubjectQuantiles(*(value if np.isfinite(value) else None for value in (median, p95)))
