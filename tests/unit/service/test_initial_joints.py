"""The posture that `placement.to_initial` returns to is taken only where nothing moves and the tool is retracted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.messages import JointState
from pcmrs.service.gateway_adapter import GatewayAdapter

JOINTS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


@pytest.mark.parametrize(
    ("placement", "idle", "taken"),
    [
        pytest.param("retracted", True, JOINTS, id="at rest and clear"),
        pytest.param("standoff", True, None, id="near the body"),
        pytest.param("retracted", False, None, id="on the way to the body: states change when a motion has ended"),
    ],
)
def test_only_a_posture_at_rest_and_clear_of_the_body_is_kept(
    placement: str, idle: bool, taken: list[float] | None
) -> None:
    zero = [0.0] * 7
    state = JointState(captured=1.0, sent=1.0, positions=JOINTS, velocities=zero, torques=zero, moving=not idle)
    cell = SimpleNamespace(joints=state, initial_joints=None)
    procedure = SimpleNamespace(joint=lambda: {"robot": "1", "placement": placement})
    dispatcher = SimpleNamespace(procedure=procedure, idle=idle, report_later=lambda _: None)
    core = GatewayAdapter(cast(Any, dispatcher), cast(Any, cell), cast(Any, None))

    assert core.remember_initial_joints() == taken
    assert cell.initial_joints == taken
