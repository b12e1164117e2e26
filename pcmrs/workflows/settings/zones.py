"""What the arm keeps out of: the cell, the body, and itself."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.workflows.settings.values import NotNegative, PoseSetting, Positive

RESERVED = frozenset({"body", "base", "mount", "tool", "sight_of_tool", "sight_of_body"})
"""Names of zones and links that no box may have."""


class ToolSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The tool's shape: a cylinder about its z axis, from the tool point along +z, away from the body; m."""

    kind: Literal["cylinder"] = "cylinder"
    radius: Positive = 0.05
    half_length: Positive = 0.01


class BoxSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Something fixed that the arm keeps out of.

    Attributes:
        name: As refusals have it.
        pose: Of its middle, in the robot's base.
        size: Edges along its axes, m.
    """

    name: str
    pose: PoseSetting
    size: tuple[Positive, Positive, Positive]


TABLE = BoxSettings("table", PoseSetting((0.4, 0.0, -0.145)), (1.4, 1.4, 0.05))
"""The bench of the simulated cell; a real one has its own."""


class ZoneSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What arm and tool keep out of, and the cone through which alone the tool comes to the body.

    Attributes:
        tool: What the flange carries.
        boxes: What stands fixed in the cell.
        body_margin: Distance of every link from the convex hull of the body's surface, m; the tool may touch it within
            `cone_height` of the target, which has to be more than this.
        box_margin: Distance of links and tool from every box, m.
        link_margin: Distance of links that are no neighbours from each other, m.
        sight_radius: How far links stay from what the tracker sees the tool and the body's reference along, m.
        cone_height: Distance from the target within which the tool point stays in the cone, m; below the standoff.
        cone_half_angle_deg: Between the cone and the tool's axis at the target.
        depth_limit: How far beyond the target the tool point may be, m.
        drift_limit: A motion is held where a link is nearer to a zone than planned and allowed by so much, m.

    Raises:
        ValueError: Two boxes have one name, or one that means something else.
    """

    tool: ToolSettings = ToolSettings()
    boxes: tuple[BoxSettings, ...] = (TABLE,)
    body_margin: NotNegative = 0.030
    box_margin: NotNegative = 0.020
    link_margin: NotNegative = 0.010
    sight_radius: Positive = 0.003
    cone_height: NotNegative = 0.060
    cone_half_angle_deg: Annotated[float, msgspec.Meta(gt=0.0, lt=90.0)] = 30.0
    depth_limit: NotNegative = 0.010
    drift_limit: Positive = 0.005

    def __post_init__(self) -> None:
        names = [box.name for box in self.boxes]
        taken = sorted({name for name in names if names.count(name) > 1 or name in RESERVED})
        if taken:
            raise ValueError(f"boxes need names of their own, which {', '.join(taken)} is not")


class BodySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The surface of the body, which the arm keeps away from.

    Attributes:
        surface: File of a triangle mesh in image coordinates; none when empty. A name alone is looked for in `folders`
            and among the shipped examples.
        unit: Of its numbers.
        space: Of its axes.
        folders: Where to look, in order.
    """

    surface: str = ""
    unit: Literal["m", "mm"] = "m"
    space: Literal["RAS", "LPS"] = "RAS"
    folders: tuple[str, ...] = ()
