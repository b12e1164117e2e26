"""The scene of the cell follows joints, tracker and plan."""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec.structs import replace

from pcmrs.console._cell import CellPanel
from pcmrs.console._geometry import ArmFrames
from pcmrs.messages import JointState
from pcmrs.messages.setup import BoxShown, ProcedureDataView
from pcmrs.workflows.data import as_message
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import FLANGE_FROM_TOOL_TIP, TOOL_MARKER_FROM_TOOL_TIP, body, setup, shown, some_pose

ARM = ArmFrames(shown("iiwa14"))
POSTURE = [0.1, -0.4, 0.3, 1.2, -0.2, 0.7, 0.5]
BOX = BoxShown(name="table", size=(1.0, 2.0, 0.1), pose=as_message(some_pose(5)))


def panel(page: DetachedPage, view: ShownCell) -> None:
    surfaces: Any = None
    with page.client:
        CellPanel(view, replace(setup(), boxes=[BOX]), ENGLISH, surfaces)


def joints() -> JointState:
    return JointState(captured=0.0, sent=0.0, positions=POSTURE, velocities=[], torques=[])


async def test_each_link_begins_at_its_joint(page: DetachedPage) -> None:
    view = ShownCell()
    panel(page, view)
    view.joints = joints()
    await page.tick()
    frames = ARM.frames(POSTURE)
    for link, frame in zip(page.shapes()["link"], frames, strict=False):
        np.testing.assert_allclose((link.x, link.y, link.z), frame.translation, atol=3e-4)
    (box,) = page.shapes()["box table"]
    np.testing.assert_allclose((box.x, box.y, box.z), some_pose(5).translation, atol=1e-4)


async def test_tools_are_shown_only_where_they_are_known(page: DetachedPage) -> None:
    view = ShownCell()
    panel(page, view)
    view.joints = joints()
    await page.tick()
    (planned,), (measured,) = page.shapes()["planned"], page.shapes()["measured"]
    assert not planned.visible_
    assert not measured.visible_

    base_from_tool_tip = ARM.frames(POSTURE)[-1] @ FLANGE_FROM_TOOL_TIP
    base_from_tool_marker = base_from_tool_tip @ TOOL_MARKER_FROM_TOOL_TIP.inverse()
    base_from_tracker, registered, plan = some_pose(1), some_pose(2), some_pose(3)
    view.poses["coil"] = body("coil", base_from_tracker.inverse() @ base_from_tool_marker)
    view.poses["body_ref"] = body("body_ref", base_from_tracker.inverse() @ some_pose(4))
    view.received = {"coil": 0.0, "body_ref": 0.0}
    view.data = ProcedureDataView(landmarks=[], body_ref_from_image=as_message(registered), plan=as_message(plan))
    await page.tick()
    assert planned.visible_
    assert measured.visible_
    expected = (some_pose(4) @ registered @ plan).translation
    np.testing.assert_allclose((planned.x, planned.y, planned.z), expected, atol=3e-4)
    np.testing.assert_allclose((measured.x, measured.y, measured.z), base_from_tool_tip.translation, atol=3e-4)
