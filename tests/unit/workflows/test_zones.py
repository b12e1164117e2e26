"""Zones of a cell: the example tools fit, and samples bound the motion between them."""

from __future__ import annotations

import json
from dataclasses import replace

import coal
import msgspec
import numpy as np
import pytest

from pcmrs.config import merge_tables
from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.collision import cylinder, hull, se3
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.sampled_clearance import BOUND
from pcmrs.spatial import Transform
from pcmrs.workflows._paths import along_axis
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.surface import read_surface
from pcmrs.workflows.zones import CellZones
from tests import ROOT
from tests.support.shipped import shipped_blueprint

EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize("name", ["ratms", "femoroplasty"])
def test_example_tools_keep_off_the_body_until_in_the_cone(name: str) -> None:
    defaults = merge_tables({"procedure": {}}, shipped_blueprint(name).defaults)
    own = msgspec.convert(defaults["procedure"], ProcedureSettings)
    surface = read_surface(own)
    assert surface is not None
    body, zones = hull(surface.vertices), own.zones
    tool = cylinder(zones.tool.radius, zones.tool.half_length, middle=zones.tool.half_length)
    for pose in json.loads((EXAMPLES / f"{name}_plan.json").read_text())["poses"]:
        image_from_target = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
        for height in np.linspace(zones.cone_height, own.placement.standoff, 5):
            placed = se3(image_from_target @ along_axis(height)) * tool.pose
            found = coal.DistanceResult()
            shapes = (
                body.geometry,
                coal.Transform3s(),
                tool.geometry,
                coal.Transform3s(placed.rotation, placed.translation),
            )
            assert coal.distance(*shapes, coal.DistanceRequest(), found) > zones.body_margin + BOUND


def test_tool_pointing_away_moves_at_most_twice_the_bound() -> None:
    """No point of it moves farther between two samples."""
    tool = {"radius": 0.01, "half_length": 0.2}
    own = msgspec.convert({"zones": {"tool": tool}}, ProcedureSettings)
    flange_from_tool = Transform(np.eye(3), np.array((0.0, 0.0, 0.15)))
    mounting = replace(
        Mounting.read(own.calibration),
        flange_from_tool_marker=flange_from_tool,
        tool_marker_from_tool_tip=Transform.identity(),
    )
    zones = CellZones(IIWA14_R820, mounting, own, read_surface(own))
    postures = zones.sample_clearance([np.zeros(7), 0.5 * np.eye(7)[1]]).postures
    arm, end = ArmModel(IIWA14_R820), np.array((0.01, 0.0, 0.4))
    ends = np.array([arm.forward(q) @ flange_from_tool @ end for q in postures])
    assert np.linalg.norm(np.diff(ends, axis=0), axis=1).max() < 2.0 * BOUND
