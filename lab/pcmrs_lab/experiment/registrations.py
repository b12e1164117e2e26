"""Monte Carlo of registrations by landmarks and skin: true against predicted error at the target.

There is no daemon. A person touches the landmarks and points of the skin of the head phantom, whose hair keeps the tip
from the skin. Each row of the table changes one property of the usual touches. Beside the refinement of PCMRS stand
the same without an estimate of the hair, and plain point-to-point ICP of the package trimesh (P. J. Besl, N. D. McKay,
A Method for Registration of 3-D Shapes, IEEE PAMI 14 (1992)), which knows neither landmarks nor hair.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import msgspec
import numpy as np
import trimesh
import trimesh.registration
import trimesh.sample
from scipy.spatial.transform import Rotation

from pcmrs.errors import RefusalError
from pcmrs.registration import register_points
from pcmrs.registration.surface import OffsetPrior, refine_with_surface
from pcmrs.settings import read_settings
from pcmrs.spatial import Floats, Transform
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows.settings import RegistrationSettings
from pcmrs_sim import head, surfaces

Region = Literal["top and face", "top", "face", "back"]
LOWEST = 0.2
"""Smallest component of a direction upwards at the top of the head. Neck and cushion cover the rest."""
FRONTAL = 0.5
"""Smallest component of a direction to the front on the face, and to the back at the back of the head."""
OUTLIER = 0.010
"""Standard deviation per axis of a touch that slipped, m."""
CLOUD_POINTS = 40000
"""Number of points of the surface for plain ICP, 1.7 mm apart."""
ICP_STEPS = 50
PROGRESS_EVERY = 10


@dataclass(frozen=True, slots=True)
class Touches:
    """Properties of the touched points of the skin.

    Attributes:
        points: Number of points.
        region: Where they are.
        noise_mm: Standard deviation per axis, mm.
        hair_mm: Distance of the tip from the skin in the hair, mm.
        outliers: Share of touches that slipped, percent.
    """

    points: int = 100
    region: Region = "top and face"
    noise_mm: float = 0.5
    hair_mm: float = 2.0
    outliers: int = 0


USUAL = Touches()
REGIONS: tuple[Region, ...] = ("top and face", "top", "face", "back")
ROWS: list[tuple[str, str, Touches]] = [
    *(("points", str(count), replace(USUAL, points=count)) for count in (25, 50, 100, 200)),
    *(("region", region, replace(USUAL, region=region)) for region in REGIONS),
    *(("noise", f"{noise:g} mm", replace(USUAL, noise_mm=noise)) for noise in (0.25, 0.5, 1.0)),
    *(("hair", f"{hair:g} mm", replace(USUAL, hair_mm=hair)) for hair in (0.0, 2.0, 4.0, 6.0, 10.0)),
    *(("outliers", f"{share} %", replace(USUAL, outliers=share)) for share in (0, 5, 10)),
]
"""Property, its value, and the touches; all other properties are the usual ones."""


class MethodErrors(msgspec.Struct, frozen=True):
    """Errors of one method over the runs that it does not refuse, mm.

    Attributes:
        refused: Number of refused runs by code.
        true_mm: Root mean square of the true error at the target; None if all runs are refused.
        predicted_mm: Root mean square of the predicted error; None if all are refused, or the method predicts none.
    """

    refused: dict[str, int]
    true_mm: float | None
    predicted_mm: float | None


class RegistrationRow(msgspec.Struct, frozen=True):
    """Results of all methods on the same touches.

    Attributes:
        property: Property that this row changes.
        value: Its value.
        landmarks: Registration by the landmarks alone.
        refined: Refinement by the skin.
        without_offset: Refinement that takes hair for skin.
        icp: Plain ICP, which refuses nothing and predicts nothing.
        hair_mm: Mean of the estimated offset of the hair; None if all runs are refused.
    """

    property: str
    value: str
    landmarks: MethodErrors
    refined: MethodErrors
    without_offset: MethodErrors
    icp: MethodErrors
    hair_mm: float | None


class RegistrationsReport(msgspec.Struct, frozen=True):
    """All rows.

    Attributes:
        icp: Package and version of plain ICP.
    """

    experiment: str
    seed: int
    runs: int
    simulated: bool
    target: tuple[float, float, float]
    sigma_mm: float
    icp: str
    rows: list[RegistrationRow]


@dataclass
class _Found:
    """Errors of one method in the runs of one row, m."""

    true: list[float] = field(default_factory=list)
    predicted: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)

    def errors(self) -> MethodErrors:
        return MethodErrors(dict(self.refused), _rms_mm(self.true), _rms_mm(self.predicted))


class _Head:
    """The phantom, its target, and the person who touches it."""

    def __init__(self, settings: RegistrationSettings) -> None:
        self.settings = settings
        self.landmarks = np.array([landmark.position for landmark in head.LANDMARKS])
        self.vertices, self.faces = surfaces.head_surface()
        self.target = np.array(read_plan(example_plan("ratms")).poses[0].position)
        self.icp = _PlainIcp(self.vertices, self.faces)

    def refine(self, session: dict[str, Any], offsets: tuple[OffsetPrior, ...]) -> tuple[Transform, float, float]:
        """Return the refined registration, its predicted error, m, and the estimated hair, m."""
        refined = refine_with_surface(
            **session,
            landmarks_image=self.landmarks,
            sigma=self.settings.sigma_mm / 1e3,
            vertices=self.vertices,
            faces=self.faces,
            sigma_surface=self.settings.surface_sigma_mm / 1e3,
            target=self.target,
            trim=self.settings.surface_trim,
            offsets=offsets,
        )
        hair = next((offset.value for offset in refined.offsets if offset.region != "face"), 0.0)
        return refined.body_ref_from_image, refined.tre_after, hair


def run_registrations(runs: int, seed: int, progress: Callable[[str, int, int], None]) -> RegistrationsReport:
    """Register and refine every row `runs` times; equal seeds give equal results.

    Args:
        runs: Number of runs of each row, at least one.
        seed: Seed of all touches.
        progress: Called with the number of finished runs.
    """
    phantom = _Head(read_settings(overrides=["workflow=ratms"]).procedure.registration)
    rows: list[RegistrationRow] = []
    for row in ROWS:

        def report(text: str, done: int) -> None:
            progress(text, len(rows) * runs + done, len(ROWS) * runs)

        rows.append(_row(phantom, row, runs, seed, report))
    progress("done", len(ROWS) * runs, len(ROWS) * runs)
    x, y, z = phantom.target.tolist()
    return RegistrationsReport(
        experiment="registrations",
        seed=seed,
        runs=runs,
        simulated=True,
        target=(x, y, z),
        sigma_mm=phantom.settings.sigma_mm,
        icp=f"trimesh {trimesh.__version__}",
        rows=rows,
    )


def _row(
    phantom: _Head, row: tuple[str, str, Touches], runs: int, seed: int, progress: Callable[[str, int], None]
) -> RegistrationRow:
    name, value, touches = row
    landmarks, refined, bare, icp = _Found(), _Found(), _Found(), _Found()
    hair: list[float] = []
    for number in range(runs):
        if number % PROGRESS_EVERY == 0:
            progress(f"{name} {value}", number)
        rng = np.random.default_rng((seed, number))
        truth, session = _session(phantom, touches, rng)
        started: Transform = session["registration"]

        def error(found: Transform, truth: Transform = truth) -> float:
            return float(np.linalg.norm(found @ phantom.target - truth @ phantom.target))

        landmarks.true.append(error(started))
        for found, offsets in ((refined, phantom.settings.offset_priors("coil")), (bare, ())):
            try:
                registration, predicted, estimate = phantom.refine(session, offsets)
            except RefusalError as refusal:
                found.refused[refusal.refusal_code] += 1
                continue
            found.true.append(error(registration))
            found.predicted.append(predicted)
            if found is refined:
                hair.append(estimate)
        icp.true.append(error(phantom.icp.register(started, session["points_body_ref"])))
    return RegistrationRow(
        name,
        value,
        landmarks.errors(),
        refined.errors(),
        bare.errors(),
        icp.errors(),
        float(np.mean(hair)) * 1e3 if hair else None,
    )


def _session(phantom: _Head, touches: Touches, rng: np.random.Generator) -> tuple[Transform, dict[str, Any]]:
    """Return the true registration, and the arguments of a refinement that were touched."""
    truth = Transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.3, 0.3, 3))
    digitized = truth @ (phantom.landmarks + rng.normal(0.0, phantom.settings.sigma_mm / 1e3, phantom.landmarks.shape))
    points = truth @ touched_skin(touches, rng)
    registration = register_points(digitized, phantom.landmarks).fixed_from_moving
    return truth, {"registration": registration, "landmarks_body_ref": digitized, "points_body_ref": points}


def touched_skin(touches: Touches, rng: np.random.Generator) -> Floats:
    """Draw touched points of the head phantom, in the image, m, (K, 3).

    Args:
        touches: Number, place and errors of the points.
        rng: Source of the points.
    """
    found: list[Floats] = []
    while len(found) < touches.points:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        if not _within(touches.region, direction):
            continue
        point = head.surface_point(direction)
        if _has_hair(point):
            point = point + touches.hair_mm / 1e3 * head.outward_normal(point)
        found.append(point)
    points = np.array(found) + rng.normal(0.0, touches.noise_mm / 1e3, (touches.points, 3))
    slipped = round(touches.outliers / 100.0 * touches.points)
    points[:slipped] += rng.normal(0.0, OUTLIER, (slipped, 3))
    return points


def _within(region: Region, direction: Floats) -> bool:
    top, face, back = direction[2] > LOWEST, direction[1] > FRONTAL, direction[1] < -FRONTAL
    return bool({"top and face": top or face, "top": top, "face": face, "back": back}[region])


def _has_hair(point: Floats) -> bool:
    """Return whether a point of the phantom has hair: above the hairline, which is not exactly where PCMRS expects it.

    The hairline is 5 mm above the plane by which the refinement separates hair and face.
    """
    offset = point - head.CENTRE
    return bool(offset[2] > offset[1] + 0.005)


def _rms_mm(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) * 1e3 if values else None


class _PlainIcp:
    """Point-to-point ICP of trimesh, which needs no tree of triangles for a cloud of points."""

    def __init__(self, vertices: Floats, faces: Any) -> None:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        self._cloud, _ = trimesh.sample.sample_surface(mesh, CLOUD_POINTS, seed=0)

    def register(self, start: Transform, points_body_ref: Floats) -> Transform:
        """Return ``body_ref_from_image`` by the points alone.

        Args:
            start: Registration by the landmarks.
            points_body_ref: Touched points in body_ref, m, (K, 3).
        """
        touched = start.inverse() @ points_body_ref
        matrix, _, _ = trimesh.registration.icp(
            touched, self._cloud, threshold=1e-12, max_iterations=ICP_STEPS, reflection=False, scale=False
        )
        return start @ Transform(matrix[:3, :3], matrix[:3, 3]).inverse()
