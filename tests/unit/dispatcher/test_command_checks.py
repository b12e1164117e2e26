"""Checks without a state: operation, role, age and arguments of a command."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.command_checks import CLOCK_TOLERANCE, EVENT_SOURCES, check_fresh, check_role
from pcmrs.errors import RefusalError
from pcmrs.fsm import OperationSpec
from pcmrs.messages import Command
from pcmrs.messages.identity import COMMANDING, ROLES, Role
from pcmrs.workflows import read_workflow
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import Bench, code


@pytest.mark.parametrize(
    ("ahead", "ttl", "expected_code"),
    [
        (CLOCK_TOLERANCE + 1.0, 1.0, "expired"),
        (CLOCK_TOLERANCE + 1.0, None, "expired"),
        (1e12, 1e13, "expired"),
        (None, 5.0, "bad_arguments"),
        (0.0, -1.0, "bad_arguments"),
        (0.0, float("inf"), "bad_arguments"),
        (0.0, float("nan"), "bad_arguments"),
    ],
)
async def test_command_of_unknown_age_is_rejected_and_changes_nothing(
    bench: Bench, ahead: float | None, ttl: float | None, expected_code: str
) -> None:
    sent = None if ahead is None else bench.clock.wall() + ahead
    verdict = await bench.do("toolplan.plan", id="stamped", sent=sent, ttl=ttl)
    assert (verdict.id, verdict.decision, bench.joint) == ("stamped", "rejected", INITIAL)
    assert verdict.reason is not None
    assert verdict.reason.code == expected_code


@pytest.mark.parametrize("stamp", [{}, {"ahead": 4.0}, {"ahead": 4.0, "ttl": 0.0}, {"ahead": -1e9}])
async def test_sender_clock_may_be_a_bit_ahead_and_no_ttl_is_no_limit(bench: Bench, stamp: dict[str, Any]) -> None:
    sent = bench.clock.wall() + stamp["ahead"] if stamp else None
    assert (await bench.do("toolplan.plan", sent=sent, ttl=stamp.get("ttl"))).decision == "accepted"


class FixedClock:
    """A clock of which only the wall's time is asked."""

    def wall(self) -> float:
        return 1.7e9


@given(age=st.floats(-100.0, 100.0), ttl=st.floats(0.0, 100.0))
def test_command_is_fresh_from_the_tolerance_to_its_time_to_live(age: float, ttl: float) -> None:
    sent = 1.7e9 - age
    command = Command(id="a", branch="robot", operation="connect", source="bus:local", sent=sent, ttl=ttl)
    fresh = -CLOCK_TOLERANCE <= 1.7e9 - sent <= ttl
    with nullcontext() if fresh else pytest.raises(RefusalError, match=r"in the future|limit of"):
        check_fresh(FixedClock(), command)  # type: ignore[arg-type]


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


@pytest.mark.parametrize(
    ("name", "arguments", "expected_code"),
    [
        ("roof.plan", {}, "unknown_branch"),
        ("toolplan.think", {}, "unknown_operation"),
        ("toolplan.plan", {"value": 1}, "bad_arguments"),
        ("toolplan.plan", {"values": "many"}, "bad_arguments"),
        ("toolplan.plan", {"values": ["1.5"]}, "bad_arguments"),
        ("toolplan.plan", {"values": [1.0, float("nan")]}, "bad_arguments"),
        ("toolplan.plan", {"values": [float("-inf")]}, "bad_arguments"),
        ("toolplan.clear", {"values": []}, "bad_arguments"),
    ],
)
async def test_05_malformed_commands_are_rejected(
    bench: Bench, name: str, arguments: dict[str, Any], expected_code: str
) -> None:
    verdict = await bench.do(name, arguments=arguments)
    assert (verdict.decision, code(verdict), bench.joint) == ("rejected", expected_code, INITIAL)


async def test_05_an_old_command_is_rejected(bench: Bench) -> None:
    sent = bench.clock.wall()
    await bench.clock.advance(2.0)
    assert code(await bench.do("toolplan.plan", sent=sent, ttl=1.5)) == "expired"
    assert (await bench.do("toolplan.plan", sent=sent, ttl=2.5)).decision == "accepted"


async def test_event_operations_are_for_devices_detectors_and_timers(bench: Bench) -> None:
    await bench.do("robot.connect")
    for source in ("udp:planner", "bus:local", "devices", "test:device:"):
        assert code(await bench.do("robot.link_lost", source=source)) == "event_operation"
    for source in ("device:robot", "detector:heartbeat", "timer:watchdog"):
        assert (await bench.do("robot.link_lost", source=source)).decision == "accepted"
        await bench.do("robot.connect")
