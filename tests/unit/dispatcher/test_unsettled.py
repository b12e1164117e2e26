"""What settles an outcome that nobody knows: for a pulse somebody has to acknowledge, for a motion somebody to look."""

from __future__ import annotations

import pytest

from pcmrs.dispatcher.recovery import PendingOutcomes
from pcmrs.messages import UnknownOutcome
from pcmrs.workflows.opening import open_workflow

BLUEPRINT = open_workflow("ratms_threshold").blueprint
SETTLING = {
    "stimulation.fire": {"robot.acknowledge"},
    "stimulation.arm": {"robot.acknowledge"},
    "threshold.pulse": {"robot.acknowledge"},
    "stimulation.set_intensity": {
        "robot.acknowledge",
        *(f"stimulation.{name}" for name in ("set_ceiling", "set_intensity", "arm", "disarm", "fire")),
    },
    "placement.home": {
        f"placement.{name}" for name, spec in BLUEPRINT.branches["placement"].operations.items() if spec.steps
    },
}


@pytest.mark.parametrize("name", SETTLING)
def test_only_some_operations_settle_what_is_unknown(name: str) -> None:
    branch, operation = name.split(".")
    unknown = UnknownOutcome(command="c", source="test:user", branch=branch, operation=operation, since=5.0)
    settling = set()
    for other, declared in BLUEPRINT.branches.items():
        for each in declared.operations:
            unsettled = PendingOutcomes(BLUEPRINT, [unknown])
            unsettled.settle_by(other, each)
            if not unsettled.shown():
                settling.add(f"{other}.{each}")
    assert settling == SETTLING[name]
