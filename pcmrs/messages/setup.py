"""Data that a console needs to show a cell: its user, the workflow, the arm, the tool and the body."""

from __future__ import annotations

from typing import Any, Literal

from pcmrs.messages._base import Message
from pcmrs.messages._poses import PoseMessage
from pcmrs.messages.identity import Role

__all__ = [
    "ArgumentShown",
    "ArmShown",
    "BoxShown",
    "LandmarkShown",
    "Point",
    "ProcedureDataView",
    "Setup",
    "SliceShown",
    "StimulationShown",
    "SurfaceShown",
]

Point = tuple[float, float, float]
"""Position x y z, m, in the frame that the field names."""


class BoxShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A fixed box that the arm keeps out of.

    Attributes:
        name: Name of the box.
        pose: Pose of its centre in the robot's base.
        size: Lengths of its edges, m.
    """

    name: str
    pose: PoseMessage
    size: Point


class SurfaceShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The body's surface in the image.

    Attributes:
        vertices: Little-endian float32, m, (V, 3) row by row.
        faces: Little-endian uint32, corners counter-clockwise seen from outside, (F, 3) row by row.
    """

    vertices: bytes
    faces: bytes


class ArmShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The arm as a chain of joints that turn about their own z axis.

    Attributes:
        name: Name of the arm.
        joints: Pose of each joint at position 0 in the frame of the one before; of the first in the robot's base.
        flange: Pose of the flange in the frame of the last joint.
        link_radius: Radius of all links, m.
    """

    name: str
    joints: list[PoseMessage]
    flange: PoseMessage
    link_radius: float


class SliceShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A rectangle across the tracker's measuring volume.

    Attributes:
        distance: Distance along the tracker's -z, m.
        width: Width along x, m.
        height: Height along y, m.
    """

    distance: float
    width: float
    height: float


class ArgumentShown(Message, frozen=True, kw_only=True):
    """One argument of an operation, for a form.

    Attributes:
        name: Name of the argument.
        kind: Kind of its value; ``numbers`` are `count` numbers, and ``other`` cannot be typed into a field.
        help: Description, for people.
        unit: Unit of its value; empty if it has none.
        required: It has no default.
        optional: Its value may be null.
        default: Default value.
        count: Number of numbers.
        least: Smallest value.
        most: Largest value.
        above: Limit that it is greater than.
        below: Limit that it is less than.
        longest: Largest number of characters.
        choices: Values to choose from.
    """

    name: str
    kind: Literal["number", "integer", "numbers", "text", "yes_no", "choice", "other"]
    help: str = ""
    unit: str = ""
    required: bool = False
    optional: bool = False
    default: Any = None
    count: int = 1
    least: float | None = None
    most: float | None = None
    above: float | None = None
    below: float | None = None
    longest: int | None = None
    choices: list[str] = []


class Setup(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to ``svc/setup/<user>``.

    Attributes:
        user: Name of the requesting user.
        role: Role of the user.
        lease_required: True if a user has to hold the cell before any change of it.
        blueprint: Workflow as TOML.
        arm: The arm.
        flange_from_coil: Pose of the tool's contact point on the arm.
        tool_marker_from_tool_tip: Pose of the tool's contact point in its marker body, which the tracker sees.
        tool_radius: Radius of the tool, a disc or rod about its z axis, m.
        tool_half_length: Half of the tool's length along its z axis, m.
        boxes: Fixed boxes that the arm keeps out of.
        surface: Surface of the body; None if none is configured.
        patient: Name of the patient of this session.
        operator: Name of the responsible operator.
        residual_limit: Mean distance of the landmarks beyond which a registration is rejected, m.
        drivers: Driver of each device; ``sim`` is simulated.
        body_margin: Distance that all links but the tool keep from the convex hull of the surface, m.
        tre_limit: Predicted error at a target beyond which a plan is refused, m.
        volume: Measuring volume of the tracker, near to far; empty if it is not configured.
        mep: Criteria of a response: the table ``procedure.stimulation.mep`` of the configuration.
        point_to_point: True if the arm moves in segments and can be stopped only at the end of one.
        confirm_offset: Distance before the target, along the tool's +z axis, at which `placement.confirm` ends, m.
        arguments: Arguments of operations, by the registered name of their type.
    """

    user: str
    role: Role
    lease_required: bool
    blueprint: str
    arm: ArmShown
    flange_from_coil: PoseMessage
    tool_marker_from_tool_tip: PoseMessage
    tool_radius: float
    tool_half_length: float
    boxes: list[BoxShown]
    surface: SurfaceShown | None
    patient: str
    operator: str
    residual_limit: float
    drivers: dict[str, str]
    body_margin: float = 0.0
    tre_limit: float = 0.004
    volume: list[SliceShown] = []
    mep: dict[str, Any] = {}
    point_to_point: bool = False
    confirm_offset: float = 0.0
    arguments: dict[str, list[ArgumentShown]] = {}


class LandmarkShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A landmark.

    Attributes:
        name: Name of the landmark.
        planned: Planned position in the image, m.
        digitized: Digitized position in body_ref, m; None until it is digitized.
    """

    name: str
    planned: Point
    digitized: Point | None = None


class StimulationShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Data of a procedure with stimulation; intensities are percent of the maximum stimulator output.

    Attributes:
        ceiling: Greatest intensity of any pulse; None until it is set.
        intensity: Intensity of the next pulse; None until it is set.
        response: Response to the last pulse: intensity, measured values, and the reason if it does not count.
        hunt: Search for the threshold: its settings and pulses as in the journal.
    """

    ceiling: float | None = None
    intensity: float | None = None
    response: dict[str, Any] | None = None
    hunt: dict[str, Any] | None = None


class ProcedureDataView(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Data of the procedure so far: published on ``state/data`` when it changes, and the answer to ``svc/data``.

    Attributes:
        landmarks: Landmarks in the order of the plan.
        body_ref_from_image: Registration in force; None if there is none.
        residual: Mean distance of its landmarks, m.
        plan: ``image_from_coil`` of the accepted tool plan; None if there is none.
        sigma: Assumed noise of a landmark, standard deviation per axis, m.
        covariance: Covariance of a registration that the surface has refined, (6, 6) row by row; empty otherwise.
        stimulation: Data of the stimulation; None if the workflow has none.
    """

    landmarks: list[LandmarkShown]
    body_ref_from_image: PoseMessage | None = None
    residual: float | None = None
    plan: PoseMessage | None = None
    sigma: float | None = None
    covariance: list[float] = []
    stimulation: StimulationShown | None = None
