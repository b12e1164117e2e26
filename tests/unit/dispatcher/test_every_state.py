"""Every reachable joint state x every operation, driven through the dispatcher and judged by the oracle."""

from __future__ import annotations

import pytest

from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL, INTERNAL_OPERATIONS, MOTIONS, Joint, all_operations, expected
from tests.unit.dispatcher.dispatcher_fakes import RATMS, Bench, has_steps, routes_from

JOINTS = list(routes_from(INITIAL))
EVERY_STATE = pytest.mark.parametrize("joint", JOINTS, ids=["-".join(joint) for joint in JOINTS])


CODES = ("invalid_in_state", "requirement_not_met", "parent_refuses", "tool_near_patient", "not_guided")


def source_of(branch: str, operation: str) -> str:
    return "device:test" if RATMS.branches[branch].operations[operation].event else "test:user"


@EVERY_STATE
async def test_rejections_of_the_oracle_change_nothing(bench: Bench, joint: Joint) -> None:
    await bench.go(joint)
    before, data, snapshots = bench.dispatcher.snapshot(), bench.data, len(bench.snapshots())
    bench.script.entered.clear()
    for branch, operation in all_operations():
        if expected(joint, branch, operation) is not None:
            continue
        verdict = await bench.do(f"{branch}.{operation}", source=source_of(branch, operation))
        await settle()
        state = before.branches[branch]
        assert (verdict.decision, verdict.state, verdict.sequence) == ("rejected", state, before.sequence)
        assert verdict.reason is not None
        assert verdict.reason.code in CODES
        assert verdict.reason.text
        assert operation not in verdict.allowed
        assert bench.verdicts()[-1] == verdict
    assert bench.dispatcher.snapshot() == before
    assert bench.data == data
    assert bench.script.entered == []
    assert len(bench.snapshots()) == snapshots


@EVERY_STATE
async def test_accepted_operations_end_where_the_oracle_says(bench: Bench, joint: Joint) -> None:
    for branch, operation in all_operations():
        for ending, after in (expected(joint, branch, operation) or {}).items():
            if ending in ("failed", "unknown") and not has_steps(branch, operation):
                continue
            await bench.go(joint)
            sequence = bench.dispatcher.snapshot().sequence
            verdict = await bench.take(branch, operation, ending)
            decision = ending if ending in ("failed", "unknown") else "accepted"
            assert (verdict.decision, bench.joint) == (decision, after), (branch, operation, ending)
            assert verdict.sequence == bench.dispatcher.snapshot().sequence == sequence + 1
            assert bench.snapshots()[-1] == bench.dispatcher.snapshot()
            assert bench.recorder.rows[-1][2] == bench.dispatcher.snapshot().branches


@EVERY_STATE
async def test_a_verdict_lists_what_the_oracle_allows_now(bench: Bench, joint: Joint) -> None:
    await bench.go(joint)
    for branch, spec in RATMS.branches.items():
        verdict = await bench.do(f"{branch}.no_such_operation")
        usable = [name for name, operation in spec.operations.items() if not operation.event and not operation.iio]
        assert verdict.allowed == [name for name in usable if expected(joint, branch, name) is not None]


async def test_operations_of_children_cannot_be_called_from_outside(bench: Bench) -> None:
    await bench.go(JOINTS[-1])
    for branch, operations in INTERNAL_OPERATIONS.items():
        for operation in operations:
            verdict = await bench.do(f"{branch}.{operation}", source="device:test")
            assert verdict.reason is not None
            assert verdict.reason.code == "internal_operation"


@EVERY_STATE
async def test_stop_wins_in_every_state(bench: Bench, joint: Joint) -> None:
    await bench.go(joint)
    holds = bench.holds
    for _ in range(2):
        await bench.dispatcher.stop("test:operator")
    if joint[4] in ("following", "guided"):  # what moves has ended, the robot is held once more, the tool is let go
        await settle()
        holds, joint = holds + 1, (*joint[:4], "held", "0", "off")
    assert bench.holds == holds + 2
    assert bench.dispatcher.snapshot().latched
    assert bench.joint == joint
    for operation in MOTIONS:
        verdict = await bench.do(f"placement.{operation}")
        assert (verdict.decision, bench.joint) == ("rejected", joint)
        assert verdict.reason is not None
        assert verdict.reason.code == "latched"
        assert not set(MOTIONS) & set(verdict.allowed)
    acknowledged = await bench.do("robot.acknowledge")
    assert (acknowledged.decision == "accepted") == (joint[3] == "1")
    assert bench.dispatcher.snapshot().latched == (joint[3] == "0")
