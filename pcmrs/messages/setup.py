"""What a console needs once, to show a cell: who asks, the workflow, the arm, the tool, the body."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message
from pcmrs.messages.identity import Role
from pcmrs.messages.poses import PoseMessage

Point = tuple[float, float, float]


class BoxShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Something fixed that the arm keeps out of: its middle in the robot's base, and its edges, m."""

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
    """The arm as joints that turn about their own z.

    Attributes:
        joints: Each in the frame of the one before it at position 0; the first in the robot's base.
        flange: In the frame of the last joint.
        link_radius: Of all links, m.
    """

    name: str
    joints: list[PoseMessage]
    flange: PoseMessage
    link_radius: float


class SliceShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A rectangle across the tracker's measuring volume: `distance` along its -z, width along x, height along y, m."""

    distance: float
    width: float
    height: float


class Setup(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to ``svc/setup/<user>``.

    Attributes:
        role: What the user may do.
        lease_required: Whether somebody has to hold the cell before anything that changes it.
        blueprint: The workflow, as TOML.
        flange_from_coil: Where the tool is on the arm.
        tool_radius: Of the tool, a disc or rod about its z axis, m.
        tool_half_length: The same along it.
        surface: None where none is configured.
        patient: Whose session it is.
        operator: Who is responsible for it.
        residual_limit: Mean distance of the landmarks beyond which a registration is rejected, m.
        drivers: Device to the driver that serves it; ``sim`` is simulated.
        body_margin: All links but the tool keep so far from the convex hull of the surface, m.
        tre_limit: Predicted error at a target beyond which a plan is refused, m.
        volume: Where the tracker measures, near to far; empty where nobody has said.
        mep: What a response is told from: the table ``procedure.stimulation.mep`` of the configuration.
    """

    user: str
    role: Role
    lease_required: bool
    blueprint: str
    arm: ArmShown
    flange_from_coil: PoseMessage
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


class LandmarkShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A landmark: planned in the image, and where it was digitized in body_ref, m; None while it is open."""

    name: str
    planned: Point
    digitized: Point | None = None


class StimulationShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What a procedure with stimulation has gathered; intensities in percent of the maximum stimulator output.

    Attributes:
        ceiling: That no pulse goes above; None until it has been set.
        intensity: Of the next pulse; None until it has been set.
        response: To the last pulse: intensity, what was measured, and why it does not count where it does not.
        hunt: For the threshold: its settings and pulses, as the journal has them.
    """

    ceiling: float | None = None
    intensity: float | None = None
    response: dict[str, Any] | None = None
    hunt: dict[str, Any] | None = None


class ProcedureDataView(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What the procedure has gathered so far: told on ``state/data`` when it changes, and asked for by ``svc/data``.

    Attributes:
        body_ref_from_image: The registration in force.
        residual: Mean distance of its landmarks, m.
        plan: ``image_from_coil`` of the accepted tool plan.
        sigma: Noise of a landmark that is reckoned with now, standard deviation per axis, m.
        covariance: Of the registration, where the surface has refined it, (6, 6) row by row; empty otherwise.
        stimulation: None where the workflow stimulates nothing.
    """

    landmarks: list[LandmarkShown]
    body_ref_from_image: PoseMessage | None = None
    residual: float | None = None
    plan: PoseMessage | None = None
    sigma: float | None = None
    covariance: list[float] = []
    stimulation: StimulationShown | None = None
