"""Settings of the zones that the arm keeps out of: the cell, the body, and itself."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.workflows.settings._values import Length, LengthOrZero, PoseSetting, Positive

RESERVED = frozenset({"body", "base", "mount", "tool", "sight_of_tool", "sight_of_body"})
"""Names of zones and links that no box may have."""


class ToolSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Shape of the tool: a cylinder about its z axis, from the tool point along +z, away from the body.

    Attributes:
        kind: Kind of the shape.
        radius: Radius of the cylinder, m.
        half_length: Half of the length of the cylinder, m.
    """

    kind: Literal["cylinder"] = "cylinder"
    radius: Length = 0.05
    half_length: Length = 0.01


class BoxSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A fixed box that the arm keeps out of.

    Attributes:
        name: Name of the box, which refusals show.
        pose: Pose of its middle in the robot's base.
        size: Lengths of its edges along its own axes, m.
    """

    name: str
    pose: PoseSetting
    size: tuple[Positive, Positive, Positive]


TABLE = BoxSettings("table", PoseSetting((0.4, 0.0, -0.145)), (1.4, 1.4, 0.05))
"""Bench of the simulated cell. A real cell configures its own."""


class ZoneSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Zones that arm and tool keep out of, and the cone through which the tool must approach the body.

    Attributes:
        tool: Shape of the tool on the flange.
        boxes: Fixed obstacles in the cell.
        body_margin: Least distance of every link from the convex hull of the body's surface, m. Within `cone_height`
            of the target, which must be more than this margin, the tool may touch the body.
        box_margin: Least distance of links and tool from every box, m.
        link_margin: Least distance from each other of links that are not neighbours, m.
        sight_radius: Least distance of links from the tracker's lines of sight to the tool and to the body's reference,
            m.
        cone_height: Distance from the target within which the tool point stays in the cone, m; below the standoff.
        cone_half_angle_deg: Angle between the cone and the tool's axis at the target, deg.
        depth_limit: Largest distance of the tool point beyond the target, m.
        drift_limit: Largest distance by which a link may be nearer to a zone than both planned and allowed, m. Beyond
            it the motion is held.

    Raises:
        ValueError: Two boxes have the same name, or a box has a reserved name.
    """

    tool: ToolSettings = ToolSettings()
    boxes: tuple[BoxSettings, ...] = (TABLE,)
    body_margin: LengthOrZero = 0.030
    box_margin: LengthOrZero = 0.020
    link_margin: LengthOrZero = 0.010
    sight_radius: Length = 0.003
    cone_height: LengthOrZero = 0.060
    cone_half_angle_deg: Annotated[float, msgspec.Meta(gt=0.0, lt=90.0)] = 30.0
    depth_limit: LengthOrZero = 0.010
    drift_limit: Length = 0.005

    def __post_init__(self) -> None:
        names = [box.name for box in self.boxes]
        taken = sorted({name for name in names if names.count(name) > 1 or name in RESERVED})
        if taken:
            raise ValueError(f"every box needs a unique name that is not reserved; rename {', '.join(taken)}")


class BodySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Surface of the body, from which the arm keeps away.

    Attributes:
        surface: File of a triangle mesh in image coordinates; empty for no surface. A name without a path is searched
            for in `folders` and among the shipped examples.
        unit: Unit of the coordinates.
        space: Orientation of the axes.
        folders: Folders to search, in order.
    """

    surface: str = ""
    unit: Literal["m", "mm"] = "m"
    space: Literal["RAS", "LPS"] = "RAS"
    folders: tuple[str, ...] = ()
