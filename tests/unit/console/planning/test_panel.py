"""Each kind of plan is sent as an operation of the workflow."""

from __future__ import annotations

from typing import get_args

import msgspec
import numpy as np
import pytest

from pcmrs.console.planning._draft import Draft, Kind
from pcmrs.console.planning.panel import operations
from pcmrs.workflows import femoroplasty, grid_mapping, read_workflow
from pcmrs.workflows.opening import placement_registry
from tests.unit.console.planning.drafts import RADIUS, direction, draft


@pytest.mark.parametrize("workflow", ["grid_mapping", "femoroplasty"])
def test_every_plan_is_taken_by_the_payload_of_its_operation(workflow: str) -> None:
    blueprint, registry = read_workflow(workflow), placement_registry()
    for procedure in (grid_mapping, femoroplasty):
        procedure.register(registry)
    plan = draft()
    plan.place(RADIUS * direction(1))
    plan.add_landmark(RADIUS * direction(2))
    plan.lay_grid(0.01, 3, 3)
    plan.entry, plan.end = np.array((0.0, 0.0, 0.09)), np.array((0.0, 0.0, 0.04))
    found = operations(blueprint)
    assert {"landmarks", "tool_pose"} <= found.keys()
    assert ("grid" in found) == (workflow == "grid_mapping")
    assert ("trajectory" in found) == (workflow == "femoroplasty")
    for kind, name in found.items():
        branch, operation = name.split(".")
        assert blueprint.branches[branch].operations[operation].payload == kind
        assert Draft().arguments(kind) is None, "what is not whole is not sent"
        msgspec.convert(plan.arguments(kind), registry.payloads[kind])
    assert set(found) <= {*get_args(Kind)}
