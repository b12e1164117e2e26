"""What a placement procedure gathers: landmarks, digitization, registration, plan and nudges."""

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

Point = tuple[float, float, float]


class Landmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A planned anatomical point in the image, m."""

    name: str
    position: Point


class Digitized(msgspec.Struct, frozen=True, kw_only=True):
    """A complete digitization: for each landmark its point in body_ref, m, and what it rests on.

    Attributes:
        reference: ``body_ref_from_witness`` when it began; None where no witness was seen.
        reference_serial: Of the marker body that was on the patient; empty where nobody said.
    """

    landmarks: tuple[Landmark, ...]
    points: tuple[Point, ...]
    patient: str
    calibration: str
    reference: PoseMessage | None = None
    reference_serial: str = ""


class Registered(msgspec.Struct, frozen=True, kw_only=True):
    """An accepted registration and all it rests on.

    Attributes:
        body_ref_from_image: The registration.
        residual: Mean distance of the landmarks, m.
        patient: Whose head it is.
        calibration: Identity of the pointer's and tool's calibration it was made with.
        reference: ``body_ref_from_witness`` of its digitization; None where no witness was seen.
        covariance: Where the surface has refined it: of the small motion ``(rotation vector, translation)`` in body_ref
            that is between it and the true one, rad and m, (6, 6) row by row; empty otherwise.
        reference_serial: Of the marker body that was on the patient; empty where nobody said.
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
    """An accepted tool plan and what it was made for.

    Attributes:
        image_from_coil: The planned pose.
        patient: In whose image.
        calibration: Identity of the pointer's and tool's calibration then.
        reference: ``body_ref_from_witness`` of the digitization then; None where there was none.
        reference_serial: Of the marker body that was on the patient; empty where nobody said.
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
        landmarks: Planned, in the image, m.
        digitized: For each landmark its point in body_ref, m; None while it is open.
        reference: ``body_ref_from_witness`` when the first of them was digitized; None where no witness was seen.
        surface: Points touched on the skin, in body_ref, m, in order.
        previous_digitization: The last complete digitization.
        registered: The registration in force.
        previous: The last accepted registration, in force or not.
        noise: What accepted registrations have left over, by pointer.
        plan: ``image_from_coil`` of the accepted tool plan.
        previous_plan: The last accepted tool plan, in force or not.
        nudge_translation: Sum of nudges since the approach, m, in the tool frame.
        nudge_rotation_zyx: Sum of rotations since the approach, rad.
        approached: Ids of the plan and registration that the tool is at.
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
    teleoperator: str | None = None

    @classmethod
    def begin(cls, _blueprint: Blueprint) -> Self:
        """What a procedure under the blueprint begins with."""
        return cls()

    def complete_digitization(self) -> tuple[Point, ...]:
        """The digitized points; empty unless every landmark has one."""
        points = tuple(point for point in self.digitized if point is not None)
        return points if self.landmarks and len(points) == len(self.landmarks) else ()

    def stimulation_view(self) -> StimulationShown | None:
        """What people are shown of the stimulation; None for a procedure without."""
        return None

    def newest_epoch(self) -> Epoch | None:
        """Signal that the last pulse was judged by, if there is one."""
        return None


def settle(data: PlacementData, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Drops what the joint state no longer stands for; a branch that the workflow has not says nothing. Pure."""
    changes: dict[str, object] = {}
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
        changes["approached"] = None
    if states.get("teleoperation") != "engaged":
        changes["teleoperator"] = None
    return msgspec.structs.replace(data, **changes) if changes else data


def _all_open(data: PlacementData) -> tuple[None, ...]:
    return tuple(None for _ in data.landmarks)


@lru_cache(maxsize=64)
def as_transform(pose: PoseMessage | BodyPose) -> Transform:
    """The pose as a `Transform`."""
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def as_message(transform: Transform) -> PoseMessage:
    """The transform as data."""
    return PoseMessage(position=as_point(transform.translation), quat_wxyz=_four(transform.quat_wxyz))


def as_point(values: npt.ArrayLike) -> Point:
    """Three numbers as plain data."""
    x, y, z = np.asarray(values, dtype=float).tolist()
    return (x, y, z)


def _four(values: npt.ArrayLike) -> tuple[float, float, float, float]:
    w, x, y, z = np.asarray(values, dtype=float).tolist()
    return (w, x, y, z)
