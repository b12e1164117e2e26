"""A phantom: the body in front of the robot in place of a patient, and the robot's tool for it."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.shape import Shape
from pcmrs_sim.solid import ContactSolid


@dataclass(frozen=True, eq=False)
class PhantomLandmark:
    """An anatomical point.

    Attributes:
        name: Name that a planner shows.
        position: Position in the image, m, (3,).
    """

    name: str
    position: Floats


@dataclass(frozen=True, eq=False)
class Phantom:
    """A body part in the image frame (RAS, m), and its pose in the cell.

    Attributes:
        inside: A point inside it, m, (3,). At a landmark, the shaft of the pointer points away from it.
        landmarks: Landmarks in the order of the plan.
        solid: Shape in the image, for contact.
        tool: Shapes of the tool, in the tool frame, whose plane z = 0 is the tool's face.
        tool_radius: Radius of that face, m.
        world_from_image: Pose of the body; the world frame is the robot base.
        body_ref_from_image: Pose of the image in the frame of the patient's marker body.
    """

    inside: Floats
    landmarks: tuple[PhantomLandmark, ...]
    solid: ContactSolid
    tool: tuple[Shape, ...]
    tool_radius: float
    world_from_image: Transform
    body_ref_from_image: Transform
