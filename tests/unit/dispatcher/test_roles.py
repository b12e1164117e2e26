"""Whatever an edge lets through: the dispatcher holds everybody to their role, for every operation."""

from __future__ import annotations

import pytest

from pcmrs.dispatcher.command_checks import EVENT_SOURCES, check_role
from pcmrs.errors import RefusalError
from pcmrs.fsm import OperationSpec
from pcmrs.messages import Command
from pcmrs.messages.identity import COMMANDING, ROLES, Role
from pcmrs.workflows import read_workflow
from tests.unit.dispatcher.dispatcher_fakes import Bench

WORKFLOWS = ("ratms", "femoroplasty", "ratms_threshold", "grid_mapping")


def refused(spec: OperationSpec, role: Role, source: str = "bus:anna") -> bool:
    command = Command(id="1", branch="b", operation="o", source=source, user="anna", role=role)
    try:
        check_role(command, spec)
    except RefusalError as error:
        return error.refusal_code == "role_not_allowed"
    return False


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_every_operation_asks_for_the_roles_of_its_blueprint(workflow: str, role: Role) -> None:
    for branch in read_workflow(workflow).branches.values():
        for spec in branch.operations.values():
            assert refused(spec, role) == (role not in (spec.roles or COMMANDING) or role not in COMMANDING)
            assert not any(refused(spec, role, source) for source in EVENT_SOURCES), "what the cell itself asks for"


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_planner_moves_nothing_and_only_an_operator_unlatches(workflow: str) -> None:
    for branch in read_workflow(workflow).branches.values():
        for name, spec in branch.operations.items():
            if spec.blocked_when_latched and not (spec.event or spec.iio):
                assert refused(spec, "planner"), name
            if spec.unlatches:
                assert [role for role in ROLES if not refused(spec, role)] == ["operator"], name


async def test_command_of_a_wrong_role_changes_nothing_but_is_recorded() -> None:
    bench = Bench()
    before = bench.dispatcher.snapshot()
    for role in ROLES:
        if role not in COMMANDING:
            verdict = await bench.do("registration.plan_landmarks", user="eve", role=role)
            assert (verdict.decision, verdict.reason and verdict.reason.code) == ("rejected", "role_not_allowed")
    assert bench.dispatcher.snapshot() == before
    assert len(bench.recorder.rows) == len(ROLES) - len(COMMANDING)
