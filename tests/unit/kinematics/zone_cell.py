"""A cell with a body and a table as zones, for tests."""

from __future__ import annotations

from itertools import product

import numpy as np
from hypothesis import strategies as st

from pcmrs.kinematics.arms import IIWA14_R820, ArmFacts
from pcmrs.kinematics.collision import box, hull
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.zones import ToolShape, Zone, ZoneModel
from pcmrs.spatial import Transform

FACTS: ArmFacts = IIWA14_R820

ARM = ArmModel(FACTS)

FLANGE_FROM_TOOL = Transform.from_quat_wxyz((0.0, 0.0, 0.15), (0.0, 1.0, 0.0, 0.0))

CORNERS = np.array(list(product((-0.1, 0.1), repeat=3)))
"""Of a cube with edges of 0.2 m about its origin."""

SIGHT = 0.004
MARKER_IN_FLANGE = np.array((0.03, -0.02, 0.06))
"""Marker body of the tool, not at its contact point."""

seeds = st.integers(0, 2**32 - 1)


def zone_model(*, margin: float = 0.03) -> ZoneModel:
    zones = [
        Zone("body", hull(CORNERS), margin, tool_may_touch=True),
        Zone("table", box((2.0, 2.0, 0.1), Transform.identity()), 0.02),
    ]
    tool = ToolShape(radius=0.05, half_length=0.01)
    return ZoneModel(
        FACTS, FLANGE_FROM_TOOL, tool, zones, link_margin=0.01, sight_radius=SIGHT, marker_in_flange=MARKER_IN_FLANGE
    )
