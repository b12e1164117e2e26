"""Data of a placement procedure: landmarks, digitization, registration, plan and nudges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Self

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.dispatcher import ProcedureData
from pcmrs.fsm import Blueprint, Effect
from pcmrs.messages import BodyPose, Epoch, PoseMessage
from pcmrs.messages.setup import StimulationShown
from pcmrs.registration import NoiseEstimate
from pcmrs.spatial import Floats, Transform

__all__ = [
    "Digitized",
    "Landmark",
    "PlacementData",
    "Planned",
    "Point",
    "Registered",
    "as_message",
    "as_point",
    "as_transform",
    "settle",
]

Point = tuple[float, float, float]
"""Position x y z, m."""


class Landmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A planned anatomical point.

    Attributes:
        name: Name of the landmark.
        position: Position in the image, m.
    """

    name: str
    position: Point


class Digitized(msgspec.Struct, frozen=True, kw_only=True):
    """A complete digitization and its preconditions.

    Attributes:
        landmarks: Planned landmarks.
        points: Digitized point of each landmark in body_ref, m.
        patient: Name of the patient.
        calibration: `Cell.calibration_id` at that time.
        reference: ``body_ref_from_witness`` at its start; None if no witness was seen.
        reference_serial: Serial number of the marker body on the patient; empty if it is not known.
    """

    landmarks: tuple[Landmark, ...]
    points: tuple[Point, ...]
    patient: str
    calibration: str
    reference: PoseMessage | None = None
    reference_serial: str = ""


class Registered(msgspec.Struct, frozen=True, kw_only=True):
    """An accepted registration and its preconditions.

    Attributes:
        id: Identifier of the registration.
        body_ref_from_image: Registration.
        residual: Mean distance of the landmarks, m.
        rms: Root mean square distance of the landmarks, m.
        landmarks: Planned landmarks.
        digitized: Digitized point of each landmark in body_ref, m.
        patient: Name of the patient.
        calibration: `Cell.calibration_id` at that time.
        reference: ``body_ref_from_witness`` of its digitization; None if no witness was seen.
        covariance: Covariance of the small motion ``(rotation vector, translation)`` in body_ref between it and the
            true registration, rad and m, (6, 6) row by row; empty if the surface has not refined it.
        reference_serial: Serial number of the marker body on the patient; empty if it is not known.
    """

    id: str
    body_ref_from_image: PoseMessage
    residual: float
    rms: float
    landmarks: tuple[Landmark, ...]
    digitized: tuple[Point, ...]
    patient: str
    calibration: str
    reference: PoseMessage | None = None
    covariance: tuple[float, ...] = ()
    reference_serial: str = ""

    def middle_in_body_ref(self) -> Floats:
        """Return the centre of the landmarks in body_ref, m, (3,)."""
        centre: Floats = np.mean([landmark.position for landmark in self.landmarks], axis=0)
        return as_transform(self.body_ref_from_image) @ centre


class Planned(msgspec.Struct, frozen=True, kw_only=True):
    """An accepted tool plan and its preconditions.

    Attributes:
        id: Identifier of the plan.
        image_from_coil: Planned pose of the tool's contact point.
        patient: Name of the patient.
        calibration: `Cell.calibration_id` at that time.
        reference: ``body_ref_from_witness`` of the digitization at that time; None if there was none.
        reference_serial: Serial number of the marker body on the patient; empty if it is not known.
    """

    id: str
    image_from_coil: PoseMessage
    patient: str
    calibration: str
    reference: PoseMessage | None = None
    reference_serial: str = ""


class PlacementData(ProcedureData, frozen=True, kw_only=True):
    """Data of the procedures that place a tool on a registered body.

    Attributes:
        landmarks: Planned landmarks in the image.
        digitized: Digitized point of each landmark in body_ref, m; None while the landmark is open.
        reference: ``body_ref_from_witness`` when the first landmark was digitized; None if no witness was seen.
        surface: Points touched on the skin, in body_ref, m, in order.
        previous_digitization: Last complete digitization.
        registered: Registration in force.
        previous: Last accepted registration, in force or not.
        noise: Noise estimated from the residuals of accepted registrations, by pointer.
        plan: ``image_from_tool_tip`` of the accepted tool plan.
        previous_plan: Last accepted tool plan, in force or not.
        nudge_translation: Sum of nudges since the approach, m, in the tool frame.
        nudge_rotation_zyx: Sum of rotations about z, y, x since the approach, rad.
        approached: Identifiers of the plan and the registration to which the tool was brought.
        approached_pose: ``image_from_tool_tip`` of that plan.
        teleoperator: User who has engaged the clutch; None while it is open.
    """

    landmarks: tuple[Landmark, ...] = ()
    digitized: tuple[Point | None, ...] = ()
    reference: PoseMessage | None = None
    surface: tuple[Point, ...] = ()
    previous_digitization: Digitized | None = None
    registered: Registered | None = None
    previous: Registered | None = None
    noise: dict[str, NoiseEstimate] = msgspec.field(default_factory=dict)
    plan: PoseMessage | None = None
    previous_plan: Planned | None = None
    nudge_translation: Point = (0.0, 0.0, 0.0)
    nudge_rotation_zyx: Point = (0.0, 0.0, 0.0)
    approached: tuple[str, str] | None = None
    approached_pose: PoseMessage | None = None
    teleoperator: str | None = None

    @classmethod
    def begin(cls, _blueprint: Blueprint) -> Self:
        """Return the data with which a procedure under the blueprint starts."""
        return cls()

    def complete_digitization(self) -> tuple[Point, ...]:
        """Return the digitized points in body_ref, m; empty unless every landmark has one."""
        points = tuple(point for point in self.digitized if point is not None)
        return points if self.landmarks and len(points) == len(self.landmarks) else ()

    def stimulation_view(self) -> StimulationShown | None:
        """State of the stimulation for people; None for a procedure without."""
        return None

    def newest_epoch(self) -> Epoch | None:
        """Signal that the last pulse was judged by, if there is one."""
        return None


def settle(data: PlacementData, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Remove the data that the joint state no longer supports. Branches that the workflow lacks change nothing. Pure.

    Args:
        data: Data of the procedure.
        states: New state of every branch.
        effects: Effects of the commit.
    """
    changes: dict[str, object] = {}
    # The digits of this branch: landmarks are planned, digitized, registered.
    registration = states.get("registration", "111")
    if registration == "000":
        changes |= {"landmarks": (), "digitized": (), "reference": None}
    if any(effect.branch == "digitization" and effect.operation == "reinit" for effect in effects):
        changes |= {"digitized": _all_open(data) if registration != "000" else (), "reference": None}
    if registration not in ("110", "111"):
        changes["surface"] = ()
    if registration != "111":
        changes |= {"registered": None, "registration_id": None}
    if states.get("toolplan", "1") != "1":
        changes |= {"plan": None, "plan_id": None}
    if states.get("placement") in ("unknown", "retracted"):
        changes |= {"approached": None, "approached_pose": None}
    if states.get("teleoperation") != "engaged":
        changes["teleoperator"] = None
    return msgspec.structs.replace(data, **changes) if changes else data


def _all_open(data: PlacementData) -> tuple[None, ...]:
    return tuple(None for _ in data.landmarks)


@lru_cache(maxsize=64)
def as_transform(pose: PoseMessage | BodyPose) -> Transform:
    """Return a pose message as a `Transform`."""
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def as_message(transform: Transform) -> PoseMessage:
    """Return a transform as a pose message."""
    return PoseMessage(position=as_point(transform.translation), quat_wxyz=_four(transform.quat_wxyz))


def as_point(values: npt.ArrayLike) -> Point:
    """Return three numbers as plain data."""
    x, y, z = np.asarray(values, dtype=float).tolist()
    return (x, y, z)


def _four(values: npt.ArrayLike) -> tuple[float, float, float, float]:
    w, x, y, z = np.asarray(values, dtype=float).tolist()
    return (w, x, y, z)
