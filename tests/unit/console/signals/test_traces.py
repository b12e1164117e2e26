"""Traces are what was measured; what is not known leaves a gap."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console.signals._traces import SHOWN, Traces
from pcmrs.spatial import Transform
from tests.unit.console.shown_cell import body, setup


class At(CellViewModel):
    """What is known at a moment that the test chooses."""

    now = 0.0


def test_body_motion_is_from_first_pose_with_gaps_while_hidden() -> None:
    told, traces = At(), Traces(setup())
    poses: Iterator[Any] = iter(
        [
            body("body_ref", Transform.identity(), valid=False),
            body("body_ref", Transform.from_rotvec((0.1, 0.0, 0.0), (0.0, 0.0, 0.0))),
            body("body_ref", Transform.from_rotvec((0.1, 0.003, 0.0), (0.0, 0.02, 0.0))),
            body("body_ref", Transform.identity(), valid=False),
        ]
    )
    for told.now, pose in enumerate(poses):
        told.poses["body_ref"] = pose
        traces.look(told)
    first, begun, moved, hidden = (moment.body for moment in traces.moments)
    assert (first, hidden) == (None, None)
    assert begun == pytest.approx((0.0, 0.0), abs=1e-12)
    assert moved == pytest.approx((0.003, 0.02))
    assert all(moment.tool is None for moment in traces.moments), "nothing is planned"


def test_last_minute_is_kept_and_a_replay_going_back_restarts() -> None:
    told, traces = At(), Traces(setup())
    for told.now in range(200):
        traces.look(told)
    assert [moment.at for moment in traces.moments] == list(range(int(199 - SHOWN), 200))
    told.now = 10.0
    traces.look(told)
    assert [moment.at for moment in traces.moments] == [10.0]
