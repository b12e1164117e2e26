"""States, flags and data of a procedure change together, and only by commits."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.dispatcher.procedure import Procedure
from pcmrs.fsm import Closure, Denial
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import Bench, Notes, Script, make_workflow


@pytest.fixture
def procedure() -> Procedure[Any, Notes]:
    return Procedure(make_workflow(Script()))


def connect(procedure: Procedure[Any, Notes]) -> Closure:
    closure = procedure.ask("robot", "connect")
    assert isinstance(closure, Closure)
    return closure


async def test_15_flags_follow_the_states_and_decide_nothing(bench: Bench) -> None:
    await bench.go(("110", "1", "0", "0", "unknown", "0", "off"))
    assert bench.dispatcher.snapshot().flags["landmarks_digitized"]
    bench.dispatcher.snapshot().flags["landmarks_digitized"] = False
    assert (await bench.do("registration.register")).decision == "accepted"


async def test_15_a_flag_that_does_not_mirror_its_state_is_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._flags["registered"] = True
    verdict = await bench.do("toolplan.plan")
    assert (verdict.decision, bench.joint, bench.holds) == ("unknown", INITIAL, 1)
    assert (await bench.do("toolplan.plan")).decision == "rejected"


async def test_15_two_active_states_are_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._engine._states.objects["robot"]["1"].activate()
    assert (await bench.do("toolplan.plan")).decision == "unknown"
    assert bench.holds == 1
    assert (await bench.do("toolplan.plan")).decision == "rejected"


def test_decisions_use_promised_states_and_users_see_committed(procedure: Procedure[Any, Notes]) -> None:
    (change,) = connect(procedure).outcomes.values()
    sequence = procedure.reserve(change)
    assert (procedure.joint()["robot"], procedure.promised()["robot"]) == ("0", "1")
    assert isinstance(procedure.ask("robot", "connect"), Denial), "it is on its way to the disk"
    assert procedure.changed_since(["robot", "toolplan"], sequence - 1) == ["robot"]
    procedure.commit(sequence, change, {"plan_id": "p1"}, unlatch=False)
    assert (procedure.joint()["robot"], procedure.sequence, procedure.data.plan_id) == ("1", sequence, "p1")
    assert procedure.changed_since(["robot"], sequence) == []


def test_promises_that_were_not_kept_are_forgotten(procedure: Procedure[Any, Notes]) -> None:
    (change,) = connect(procedure).outcomes.values()
    procedure.reserve(change)
    procedure.forget_promises()
    assert procedure.promised() == procedure.joint()
    assert connect(procedure).outcomes, "it may be requested again"


def test_commit_that_a_latch_overtook_gets_a_new_number(procedure: Procedure[Any, Notes]) -> None:
    """Stop shows its latch without waiting for the journal; the sequence never goes back."""
    (change,) = connect(procedure).outcomes.values()
    sequence = procedure.reserve(change)
    procedure.latch()
    assert procedure.sequence > sequence
    shown = procedure.sequence
    procedure.commit(sequence, change, {}, unlatch=False)
    assert procedure.sequence > shown
    assert procedure.latched
    assert procedure.joint()["robot"] == "1"
