"""What stands before the robot in place of a patient, and what the robot carries for it."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.shape import Shape
from pcmrs_sim.solid import ContactSolid


@dataclass(frozen=True, eq=False)
class PhantomLandmark:
    """An anatomical point, in the image, m, (3,); named as a planner shows it."""

    name: str
    position: Floats


@dataclass(frozen=True, eq=False)
class Phantom:
    """A body part in the image frame (RAS, m), and its place in the cell.

    Attributes:
        inside: A point inside of it: who touches a landmark holds the pointer away from there, (3,).
        landmarks: In the order in which they are planned.
        body: Its shape in the image, as it is drawn.
        solid: The same, as a tool meets it.
        tool: Shape of what the robot carries for it, in the frame of the tool, whose face is its plane z = 0.
        tool_radius: Of that face, m.
        world_from_image: Where it stands; the robot base is the world frame.
        body_ref_from_image: Where its marker body is fixed to it.
    """

    inside: Floats
    landmarks: tuple[PhantomLandmark, ...]
    body: tuple[Shape, ...]
    solid: ContactSolid
    tool: tuple[Shape, ...]
    tool_radius: float
    world_from_image: Transform
    body_ref_from_image: Transform
