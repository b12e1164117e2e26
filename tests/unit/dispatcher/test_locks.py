"""Locks: what overlaps, what waits and in which order, and what is turned away."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher import Run
from pcmrs.dispatcher.locks import MAX_WAITING, Locks
from pcmrs.fsm import parse_blueprint
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import USER_OPERATIONS
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RETRACTED, STANDOFF, Bench, Notes, code

PLANNED = ("100", "0", "0", "0", "unknown", "0", "off")


TURNING = parse_blueprint(
    b"""
id = "turning"
version = "1"

[branches.table]
states = { flat = "flat", turning = "not locked", tilted = "tilted and locked" }
[branches.table.operations.turn]
from = ["flat"]
to = "turning"
[branches.table.operations.lock]
from = ["turning"]
to = "tilted"
steps = ["move"]
[branches.table.operations.strap_changed]
from = ["tilted"]
to = "tilted"
iio = true

[branches.strap]
level = 2
states = { open = "open", closed = "closed" }
emits = { "*" = "strap_changed" }
[branches.strap.parent]
branch = "table"
start = "flat"
compatible = { "*" = ["flat", "turning", "tilted"] }
[branches.strap.operations.close]
from = ["open"]
to = "closed"
[branches.strap.operations.reinit]
from = ["*"]
to = "open"
rio = true
""",
    origin="turning.toml",
)
"""`strap.close` is denied by the state of its parent, which it does not name in its requirements."""


def _side(own: str, other: str) -> str:
    """A motor, a clamp that it opens, and a rail with the clamp on it that the other side's motor may take away."""
    return f"""
[branches.{own}_motor]
states = {{ still = "still", turned = "turned" }}
[branches.{own}_motor.operations.turn]
from = ["still"]
to = "turned"
steps = ["move"]

[branches.{own}_rail]
revocations = [{{ by = ["{other}_motor"], from = ["out"], to = "gone" }}]
states = {{ in = "in", out = "out", gone = "away" }}
[branches.{own}_rail.operations.extend]
from = ["in"]
to = "out"
[branches.{own}_rail.operations.clamp_changed]
from = ["*"]
to = {{ in = "in", out = "out", gone = "gone" }}
iio = true

[branches.{own}_clamp]
level = 2
revocations = [{{ by = ["{own}_motor"], from = ["shut"], to = "open" }}]
states = {{ open = "open", shut = "shut" }}
emits = {{ "*" = "clamp_changed" }}
[branches.{own}_clamp.parent]
branch = "{own}_rail"
start = "in"
compatible = {{ open = ["in", "out", "gone"], shut = ["in", "out"] }}
[branches.{own}_clamp.operations.close]
from = ["open"]
to = "shut"
[branches.{own}_clamp.operations.reinit]
from = ["*"]
to = "open"
rio = true
"""


CROSSED = parse_blueprint(
    ('id = "crossed"\nversion = "1"\n' + _side("left", "right") + _side("right", "left")).encode(),
    origin="crossed.toml",
)
"""Once the rails are out, each motor would open the other side's clamp, which that side's motor has locked."""


async def test_disjoint_operations_are_in_their_steps_at_once(worldly_bench: Bench) -> None:
    """Each waits for the other: only together can they end."""
    await worldly_bench.go(PLANNED)
    names = ("digitization.digitize_all", "toolplan.plan", "robot.connect")
    together, met = asyncio.Barrier(len(names)), set[str]()

    async def meet(run: Run[Any, Notes]) -> None:
        if run.command.id not in met:  # an operation of several steps meets the others in its first one
            met.add(run.command.id)
            await together.wait()

    worldly_bench.script.steps |= dict.fromkeys(names, meet)
    tasks = [await worldly_bench.begin(name) for name in names]
    await settle()
    assert [(await task).decision for task in tasks] == ["accepted"] * 3
    assert worldly_bench.joint == ("110", "1", "1", "1", "unknown", "0", "off")


async def test_journal_has_the_states_after_each_parallel_commit(bench: Bench) -> None:
    await bench.go(PLANNED)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    tasks = [await bench.begin(name) for name in ("toolplan.plan", "registration.clear_landmarks")]
    gate.set()
    for task in tasks:
        await task
    states = [row[2] for row in bench.recorder.rows[-2:]]
    assert [(s["registration"], s["toolplan"]) for s in states] == [("100", "1"), ("000", "1")]


async def test_conflicting_operations_run_one_by_one_in_their_order(bench: Bench) -> None:
    await bench.go(PLANNED)
    gate = bench.script.hang("digitization.digitize_all")
    first = await bench.begin("digitization.digitize_all")
    others = [await bench.begin(n) for n in ("registration.register", "registration.plan_landmarks")]
    third = await bench.begin("registration.register")
    assert "registration.register" not in bench.script.entered
    gate.set()
    verdicts = [await task for task in (first, *others, third)]
    assert [v.state for v in verdicts] == ["1", "111", "100", "100"]
    assert [v.decision for v in verdicts] == ["accepted"] * 3 + ["rejected"], "asked again when dequeued"
    assert [v.sequence for v in verdicts] == [2, 3, 4, 4]


async def test_a_newcomer_does_not_overtake_one_that_waits(worldly_bench: Bench) -> None:
    """What the third writes is free, but the second, which waits for the first, needs it unchanged."""
    await worldly_bench.go(RETRACTED)
    gate = worldly_bench.script.hang("toolplan.plan")
    tasks = [await worldly_bench.begin(name) for name in ("toolplan.plan", "toolplan.reinit", "placement.reinit")]
    assert [task.done() for task in tasks] == [False] * 3
    gate.set()
    verdicts = [await task for task in tasks]
    assert [v.decision for v in verdicts] == ["accepted"] * 3
    assert [v.sequence - verdicts[0].sequence for v in verdicts] == [0, 1, 2]


async def test_a_requirement_is_locked_for_reading(bench: Bench) -> None:
    """Nothing that an approach requires can change while it moves."""
    await bench.go(RETRACTED)
    gate = bench.script.hang("placement.approach")
    task = await bench.begin("placement.approach")
    for name in (
        "toolplan.plan",
        "toolplan.clear",
        "registration.plan_landmarks",
        "registration.clear_registration",
        "digitization.redigitize_one",
    ):
        assert code(await bench.do(name)) == "busy"
    gate.set()
    assert (await task).state == "standoff"


async def test_revocation_is_locked_too(worldly_bench: Bench) -> None:
    """A plan that would revoke the placement waits for nothing that moves it."""
    await worldly_bench.go(STANDOFF)
    gate = worldly_bench.script.hang("toolplan.plan")
    plan = await worldly_bench.begin("toolplan.plan")
    for name in ("home", "confirm", "nudge", "back_off"):
        assert code(await worldly_bench.do(f"placement.{name}")) == "busy"
    gate.set()
    assert (await plan).decision == "accepted"
    assert worldly_bench.joint[4] == "held"


async def test_motions_never_wait(bench: Bench) -> None:
    await bench.go(PLACED)
    gate = bench.script.hang("placement.nudge")
    task = await bench.begin("placement.nudge")
    verdict = await bench.do("placement.home")
    assert (verdict.decision, code(verdict)) == ("rejected", "busy")
    assert verdict.reason is not None
    assert verdict.reason.fields == {"running": ["placement.nudge"]}
    gate.set()
    assert (await task).decision == "accepted"


async def test_disconnection_waits_for_the_motion_and_is_redecided(bench: Bench) -> None:
    await bench.go(STANDOFF)
    gate = bench.script.hang("placement.confirm")
    motion = await bench.begin("placement.confirm")
    disconnect = await bench.begin("robot.disconnect")
    assert not disconnect.done()
    gate.set()
    await motion
    assert code(await disconnect) == "tool_near_patient"


async def test_waiting_command_takes_the_locks_of_its_later_turn(bench: Bench) -> None:
    """The connection is denied when it is asked for, and would be made while a landmark is checked."""
    await bench.go(("111", "1", "0", "1", "unknown", "0", "off"))
    bench.script.entered.clear()
    checked, disconnected = bench.script.hang("digitization.check_landmark"), bench.script.hang("robot.disconnect")
    checking, disconnecting = [await bench.begin(name) for name in ("digitization.check_landmark", "robot.disconnect")]
    connecting = await bench.begin("robot.connect")
    disconnected.set()
    assert (await disconnecting).decision == "accepted"
    await settle()
    assert "robot.connect" not in bench.script.entered
    checked.set()
    await checking
    assert (await connecting).decision == "accepted"


async def test_command_barred_by_its_parent_waits_for_the_parent(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    connecting = await bench.begin("robot.connect")
    locating = await bench.begin("placement.locate")
    assert not locating.done()
    gate.set()
    await connecting
    assert (await locating).decision == "accepted"


async def test_command_its_parent_would_refuse_waits_for_the_parent() -> None:
    """The parent's operation leaves the branch that waits as it is, so that only the parent's lock keeps it waiting."""
    bench = Bench(TURNING, ["table"])
    assert (await bench.do("table.turn")).decision == "accepted"
    assert code(await bench.do("strap.close")) == "parent_refuses"
    locked = bench.script.hang("table.lock")
    locking = await bench.begin("table.lock")
    closing = await bench.begin("strap.close")
    assert not closing.done()
    locked.set()
    assert (await locking).decision == "accepted"
    assert (await closing).decision == "accepted"
    await bench.dispatcher.close()


async def test_waiting_command_expires_after_its_time_to_live(worldly_bench: Bench) -> None:
    gate = worldly_bench.script.hang("toolplan.plan")
    running = await worldly_bench.begin("toolplan.plan")
    waiting = await worldly_bench.begin("toolplan.plan", sent=worldly_bench.clock.wall(), ttl=2.0)
    await worldly_bench.clock.advance(2.5)
    gate.set()
    assert (await running).decision == "accepted"
    assert code(await waiting) == "expired"


branches = st.frozensets(st.sampled_from("abcd"))


@given(branches, branches, branches, branches)
def test_two_conflict_where_one_writes_what_the_other_touches(
    writes: frozenset[str], reads: frozenset[str], other_writes: frozenset[str], other_reads: frozenset[str]
) -> None:
    touched, touched_by_other = writes | reads, other_writes | other_reads
    expected = bool(writes & touched_by_other) or bool(other_writes & touched)
    assert Locks(writes, reads).conflicts(Locks(other_writes, other_reads)) == expected


async def test_the_queue_is_bounded(worldly_bench: Bench) -> None:
    gate = worldly_bench.script.hang("toolplan.plan")
    tasks = [await worldly_bench.begin("toolplan.plan") for _ in range(1 + MAX_WAITING)]
    verdict = await worldly_bench.do("toolplan.clear")
    assert (verdict.decision, code(verdict)) == ("rejected", "queue_full")
    gate.set()
    assert {(await task).decision for task in tasks} == {"accepted"}


async def test_status_takes_no_lock(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    task = await bench.begin("robot.connect")
    assert [r.operation for r in bench.dispatcher.snapshot().running] == ["connect"]
    gate.set()
    await task


MOTIONLESS = ("registration", "digitization", "toolplan")


HARMLESS = [f"{branch}.{name}" for branch in MOTIONLESS for name in USER_OPERATIONS[branch]]


@given(st.lists(st.sampled_from([*HARMLESS, "robot.connect", "robot.disconnect", "placement.locate"]), max_size=15))
def test_commands_sent_at_once_are_all_answered(names: list[str]) -> None:
    async def ask_all() -> None:
        bench = Bench()
        tasks = [asyncio.create_task(bench.do(name)) for name in names]
        verdicts = await asyncio.gather(*tasks)
        assert {v.decision for v in verdicts} <= {"accepted", "rejected"}
        accepted = sorted(v.sequence for v in verdicts if v.decision == "accepted")
        assert accepted == list(range(1, len(accepted) + 1))
        shown = bench.dispatcher.snapshot()
        assert shown.running == []
        assert shown.branches["digitization"] == shown.branches["registration"][1]
        assert bench.recorder.rows == [] or bench.recorder.rows[-1][2] == shown.branches
        await bench.dispatcher.close()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(ask_all())


@pytest.mark.parametrize("ending", ["failed", "unknown"])
async def test_locks_are_free_after_every_ending(bench: Bench, ending: str) -> None:
    await bench.take("robot", "connect", ending)
    assert (await bench.do("robot.connect")).decision == "accepted"


async def test_commit_waits_for_the_motion_that_it_would_revoke(bench: Bench) -> None:
    """Found by the verifier: a digitization begun while held, a retreat to the standoff, then a way home.

    When the digitization ends, the registration that the standoff rests on ends with it: placement would go to held
    while the arm moves home, and the way home could not be concluded any more.
    """
    await bench.go(HELD)
    digitized, at_home = bench.script.hang("digitization.digitize_all"), bench.script.hang("placement.home")
    digitizing = await bench.begin("digitization.digitize_all")
    assert (await bench.do("placement.back_off")).state == "standoff"
    homing = await bench.begin("placement.home")
    digitized.set()
    await settle()
    assert not digitizing.done()
    assert bench.joint == STANDOFF
    at_home.set()
    assert (await homing).state == "retracted"
    assert (await digitizing).decision == "accepted"
    assert bench.joint == ("110", "1", "1", "1", "retracted", "0", "off")
    assert (await bench.do("toolplan.clear")).decision == "accepted"


async def test_stop_ends_both_when_a_commit_waits_for_a_motion(bench: Bench) -> None:
    await bench.go(HELD)
    digitized, _ = bench.script.hang("digitization.digitize_all"), bench.script.hang("placement.home")
    digitizing = await bench.begin("digitization.digitize_all")
    await bench.do("placement.back_off")
    homing = await bench.begin("placement.home")
    digitized.set()
    await settle()
    assert await bench.dispatcher.stop("test:user")
    assert (await homing).decision == "failed"
    assert (await digitizing).decision == "accepted"
    assert bench.joint == ("110", "1", "1", "1", "held", "0", "off")


async def test_commits_that_would_revoke_each_other_do_not_deadlock() -> None:
    bench = Bench(CROSSED, ["left_motor", "right_motor"])
    for side in ("left", "right"):
        assert (await bench.do(f"{side}_clamp.close")).decision == "accepted"
    ends = {side: bench.script.hang(f"{side}_motor.turn") for side in ("left", "right")}
    turning = [await bench.begin(f"{side}_motor.turn") for side in ends]
    for side in ends:
        assert (await bench.do(f"{side}_rail.extend")).decision == "accepted"
    ends["left"].set()
    await settle()
    assert [each.done() for each in turning] == [False, False], "the left one waits for the right one"
    ends["right"].set()
    await settle()
    assert [each.done() for each in turning] == [True, True]
    assert [(await each).decision for each in turning] == ["accepted"] * 2
    await bench.dispatcher.close()
