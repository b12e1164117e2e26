"""Who holds a cell gives the commands; whoever does not is refused, and everything about it is on record."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.dispatcher.lease import LAPSED, LEASE, Lease, lapse
from pcmrs.messages import Command, LeaseState, Verdict
from pcmrs.messages.identity import ROLES
from tests.unit.dispatcher.dispatcher_fakes import Bench

PEOPLE: dict[str, Any] = {
    "anna": {"source": "bus:anna", "user": "anna", "role": "operator"},
    "bob": {"source": "bus:bob", "user": "bob", "role": "teleoperator"},
    "slicer": {"source": "peer:slicer", "user": "slicer", "role": "planner"},
    "eve": {"source": "bus:eve", "user": "eve", "role": "viewer"},
    "local": {"source": "bus:local"},
}


async def do(bench: Bench, who: str, name: str, **arguments: Any) -> Verdict:
    return await bench.do(name, arguments=arguments, **PEOPLE[who])


def code(verdict: Verdict) -> str:
    return verdict.reason.code if verdict.reason is not None else verdict.decision


async def test_one_holds_the_cell_and_the_others_are_refused() -> None:
    bench = Bench()
    assert code(await do(bench, "anna", "lease.acquire")) == "accepted"
    assert bench.dispatcher.snapshot().lease == LeaseState(holder="anna")
    before = bench.joint
    for who in ("bob", "local"):
        refused = await do(bench, who, "registration.plan_landmarks")
        assert (code(refused), refused.reason and refused.reason.fields) == ("lease_held", {"holder": "anna"})
        assert code(await do(bench, who, "lease.acquire")) == ("lease_held")
    assert bench.joint == before
    assert code(await do(bench, "anna", "registration.plan_landmarks")) == "accepted"
    assert code(await do(bench, "slicer", "registration.clear_landmarks")) == "accepted", (
        "a planner plans for the holder"
    )
    assert code(await do(bench, "anna", "lease.release")) == "accepted"
    assert code(await do(bench, "bob", "lease.acquire")) == "accepted"


async def test_unheld_lease_allows_commands_unless_a_lease_is_required() -> None:
    bench = Bench()
    assert code(await do(bench, "bob", "registration.plan_landmarks")) == "accepted"
    bench.dispatcher._admission.lease = Lease(bench.clock, required=True)
    for who in ("anna", "bob", "slicer", "local"):
        assert code(await do(bench, who, "registration.plan_landmarks")) == "no_lease"
    await do(bench, "local", "lease.acquire")
    assert code(await do(bench, "slicer", "registration.plan_landmarks")) == "accepted"


@pytest.mark.parametrize("who", ["slicer", "eve"])
@pytest.mark.parametrize("operation", ["acquire", "take_over"])
async def test_role_that_may_not_hold_it_does_not_get_it(who: str, operation: str) -> None:
    bench = Bench()
    assert code(await do(bench, who, f"lease.{operation}")) == "role_not_allowed"
    assert bench.dispatcher.lease.holder is None


async def test_holder_confirms_a_takeover_and_a_local_one_is_immediate() -> None:
    bench = Bench()
    await do(bench, "anna", "lease.acquire")
    assert code(await do(bench, "bob", "lease.take_over")) == "accepted"
    assert bench.dispatcher.snapshot().lease == LeaseState(holder="anna", asking="bob")
    assert code(await do(bench, "bob", "lease.confirm", user="bob")) == "not_holder"
    assert code(await do(bench, "anna", "lease.confirm")) == "bad_arguments"
    assert code(await do(bench, "anna", "lease.confirm", user="local")) == "bad_arguments"
    assert bench.dispatcher.lease.holder == "anna"
    assert code(await do(bench, "anna", "lease.confirm", user="bob")) == "accepted"
    assert bench.dispatcher.snapshot().lease == LeaseState(holder="bob")
    assert code(await do(bench, "local", "lease.take_over")) == "accepted"
    assert bench.dispatcher.lease.holder == "local"


async def test_its_decisions_are_on_record_and_renewing_is_not_one() -> None:
    bench = Bench()
    await do(bench, "anna", "lease.acquire")
    await do(bench, "bob", "lease.acquire")
    rows = len(bench.recorder.rows)
    assert code(await do(bench, "anna", "lease.renew")) == "accepted"
    assert len(bench.recorder.rows) == rows
    assert code(await do(bench, "bob", "lease.renew")) == "not_holder"
    assert len(bench.recorder.rows) == rows + 1
    verdicts = [verdict for *_, verdict in bench.recorder.rows if verdict is not None]
    assert [(each.branch, each.operation, each.decision) for each in verdicts] == [
        ("lease", "acquire", "accepted"),
        ("lease", "acquire", "rejected"),
        ("lease", "renew", "rejected"),
    ]


async def test_silent_holder_loses_it_unless_on_site() -> None:
    bench = Bench()
    lease = bench.dispatcher.lease
    await do(bench, "anna", "lease.acquire")
    await bench.clock.advance(9.0)
    await do(bench, "anna", "lease.renew")
    await bench.clock.advance(9.0)
    assert lease.lapsed(10.0) is None
    await bench.clock.advance(2.0)
    assert lease.lapsed(10.0) == "anna"
    await bench.dispatcher.report(lapse("anna", 10.0, moving=False))
    assert lease.holder is None
    assert not bench.dispatcher.snapshot().latched
    await do(bench, "local", "lease.acquire")
    await bench.clock.advance(1e6)
    assert lease.lapsed(10.0) is None


async def test_a_holder_who_is_lost_in_motion_leaves_a_held_robot() -> None:
    bench = Bench()
    await do(bench, "anna", "lease.acquire")
    await bench.dispatcher.report(lapse("anna", 10.0, moving=True))
    shown = bench.dispatcher.snapshot()
    assert (shown.lease, shown.latched, bench.holds) == (None, True, 1)
    events = [each for each in bench.published if getattr(each, "code", "") == LAPSED]
    assert events, "everybody is told"


async def test_motion_is_held_when_the_cell_changes_hands() -> None:
    bench = Bench()
    await bench.go(("111", "1", "1", "1", "retracted", "0", "off"))
    bench.script.hang("placement.approach")
    await do(bench, "anna", "lease.acquire")
    moving = await bench.begin("placement.approach", **PEOPLE["anna"])
    assert code(await do(bench, "local", "lease.take_over")) == "accepted"
    ended = await moving
    assert (ended.decision, code(ended)) == ("failed", "lease_taken")
    shown = bench.dispatcher.snapshot()
    assert (shown.latched, shown.branches["placement"], shown.lease) == (True, "held", LeaseState(holder="local"))


async def test_an_unknown_operation_of_the_lease_is_refused() -> None:
    verdict = await do(Bench(), "anna", "lease.steal")
    assert code(verdict) == "unknown_operation"


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["anna", "bob", "local"]), st.sampled_from(["acquire", "release", "take_over", "confirm"])
        )
    )
)
def test_holder_loses_it_only_by_consent_or_to_a_user_on_site(asked: list[tuple[str, str]]) -> None:
    lease = Lease(SystemClock())
    for who, operation in asked:
        before = lease.state
        fields = {"source": f"bus:{who}", **PEOPLE[who]}
        arguments = {"user": before.asking} if before is not None else {}
        reason = lease.decide(Command(id="1", branch=LEASE, operation=operation, arguments=arguments, **fields))
        after = lease.state
        if reason is not None:
            assert after == before
        elif before is not None and (after is None or after.holder != before.holder):
            assert before.holder == who or (who, operation) == ("local", "take_over")


def test_only_roles_that_may_hold_it_acquire_it() -> None:
    for role in ROLES:
        lease = Lease(SystemClock())
        command = Command(id="1", branch=LEASE, operation="acquire", source="bus:x", user="x", role=role)
        assert (lease.decide(command) is None) == (role in ("operator", "teleoperator"))
