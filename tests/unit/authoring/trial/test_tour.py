"""Activities in a blueprint: what cannot be meant is named, and every view of a workflow shows them."""

from __future__ import annotations

from pcmrs.authoring.trial.tour import plan_tour
from tests.support.altered import with_branch
from tests.unit.fsm.arm_workflow import arm_blueprint


def test_a_tour_covers_a_workflow_that_has_them() -> None:
    still = with_branch(arm_blueprint(), "arm", activities={})
    assert plan_tour(arm_blueprint()) == plan_tour(still)
