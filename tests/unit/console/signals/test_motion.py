"""Ages, joints and force as numbers, and motion over time with gaps where nothing was known."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace
from nicegui import ui

from pcmrs.console.signals._motion import MotionPanel
from pcmrs.messages import JointState
from pcmrs.spatial import Transform
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import body, setup

JOINTS = JointState(captured=0.0, sent=0.0, positions=[math.pi / 2, -0.1] + [0.0] * 5, velocities=[], torques=[])


def test_missing_numbers_are_not_known(page: DetachedPage) -> None:
    MotionPanel(ShownCell(), setup(), ENGLISH).draw()
    assert page.text("joints") == "Joints, degrees: not known"
    assert page.text("force").endswith("not known")
    assert page.text("ages") == "joints: not known"


def test_joints_are_degrees_and_the_force_is_its_length(page: DetachedPage) -> None:
    panel = MotionPanel(view := ShownCell(), setup(), ENGLISH)
    view.joints = replace(JOINTS, flange_force=(3.0, 0.0, 4.0))
    panel.draw()
    assert page.text("joints").split()[2:4] == ["90.00", "-5.73"]
    assert page.text("force").endswith("5.0")


def test_an_unseen_body_says_so_and_a_seen_one_has_its_error(page: DetachedPage) -> None:
    panel = MotionPanel(view := ShownCell(), setup(), ENGLISH)
    view.poses = {
        "coil": replace(body("coil", Transform.identity()), error=0.00025),
        "body_ref": body("body_ref", Transform.identity(), valid=False),
    }
    view.received, view.now = {"coil": 1.0, "body_ref": 1.0}, 1.25
    panel.draw()
    _, ref, coil = page.text("ages").splitlines()
    assert ref.startswith("body_ref: ")
    assert ref.endswith(ENGLISH("not_seen"))
    assert "250" in coil
    assert coil.endswith("0.25 mm")


def test_a_chart_is_mm_and_degrees_until_now_with_a_gap(page: DetachedPage) -> None:
    panel = MotionPanel(view := ShownCell(), setup(), ENGLISH)
    for view.now, pose in (
        (0.0, Transform.identity()),
        (1.0, None),
        (2.0, Transform.from_rotvec((0.003, 0.0, 0.0), (0.0, 0.0, math.radians(2.0)))),
    ):
        view.poses["body_ref"] = body("body_ref", pose or Transform.identity(), valid=pose is not None)
        panel.look()
    view.now = 4.0
    panel.draw()
    _, chart = [each for each in page.client.elements.values() if isinstance(each, ui.echart)]
    mm, degrees = (series["data"] for series in chart.options["series"])
    assert mm == [[-4.0, 0.0], [-3.0, None], [-2.0, pytest.approx(3.0)]]
    assert degrees[2] == [-2.0, pytest.approx(2.0)]
