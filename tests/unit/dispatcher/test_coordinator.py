"""A completed command changes data only if it is accepted, and releases the latch only of Stops before it."""

from __future__ import annotations

import asyncio
from typing import Any, get_args

import pytest

from pcmrs.clock import SystemClock
from pcmrs.dispatcher._coordinator import CompletedCommand
from pcmrs.dispatcher._run import ProcedureData, Run
from pcmrs.dispatcher.locks import Locks, PendingCommand
from pcmrs.messages import Command, Decision, Reason
from tests.unit.dispatcher.dispatcher_fakes import RATMS

STOPPED = Reason(code="stopped", text="Stopped by test:operator.")


async def completed(
    decision: Decision, operation: str = "robot.acknowledge", stopped: Reason | None = None
) -> CompletedCommand[Any, ProcedureData]:
    """An operation that has kept a plan and ended with `decision`."""
    branch, name = operation.split(".")
    command = Command(id="1", branch=branch, operation=name, source="test:user")
    run: Run[Any, ProcedureData] = Run(command, None, {}, None, SystemClock(), ProcedureData(), lambda fraction: None)
    run.keep(plan_id="p1")
    verdict = asyncio.get_running_loop().create_future()
    spec = RATMS.branches[branch].operations[name]
    pending = PendingCommand(command, spec, None, verdict, Locks(frozenset(), frozenset()), 0.0, side_effecting=False)
    pending.stopped = stopped
    return CompletedCommand(command, verdict, decision, pending=pending, run=run)


@pytest.mark.parametrize("decision", get_args(Decision))
async def test_only_an_accepted_command_changes_data(decision: Decision) -> None:
    changes = (await completed(decision)).changes
    assert changes == ({"plan_id": "p1"} if decision == "accepted" else {})


@pytest.mark.parametrize("decision", get_args(Decision))
async def test_only_an_accepted_acknowledgement_unlatches(decision: Decision) -> None:
    assert (await completed(decision)).unlatches == (decision == "accepted")
    assert not (await completed(decision, "robot.connect")).unlatches


async def test_acknowledgement_that_a_later_stop_met_releases_nothing() -> None:
    assert not (await completed("accepted", stopped=STOPPED)).unlatches


async def test_command_rejected_before_it_was_pending_changes_nothing() -> None:
    command = Command(id="1", branch="robot", operation="acknowledge", source="test:user")
    rejected: CompletedCommand[Any, ProcedureData] = CompletedCommand(
        command, asyncio.get_running_loop().create_future(), "accepted"
    )
    assert (rejected.changes, rejected.unlatches) == ({}, False)
