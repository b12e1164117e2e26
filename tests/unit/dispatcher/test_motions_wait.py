"""A motion waits for what an event is about to change, for a moment; and what moves begins in time or not at all."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.dispatcher import command_checks
from pcmrs.fsm import parse_blueprint
from pcmrs.messages import Verdict
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, STANDOFF, Bench
from tests.unit.dispatcher.test_locks import code

TRACKER = "activity:watch_alignment"


def _arm(name: str) -> str:
    return f"""
[branches.{name}]
states = {{ back = "back", held = "held" }}
[branches.{name}.operations.turn]
from = ["back"]
to = "back"
on_failure = "held"
on_unknown = "held"
motion = "approach"
steps = ["move"]
requires = {{ door = ["shut"] }}
[branches.{name}.operations.retreat]
from = ["held"]
to = "back"
on_failure = "held"
on_unknown = "held"
motion = "retreat"
steps = ["move"]
"""


ARMS = parse_blueprint(
    f"""
id = "arms"
version = "1"
[branches.door]
states = {{ open = "open", shut = "shut" }}
[branches.door.operations.shut]
from = ["*"]
to = "shut"
event = true
[branches.door.operations.acknowledge]
from = ["*"]
to = {{ open = "open", shut = "shut" }}
unlatches = true
{_arm("left")}
{_arm("right")}
""".encode(),
    origin="arms.toml",
)
"""Two motions that are in nobody's way but of the door's event."""


async def within_on_its_way(bench: Bench) -> tuple[asyncio.Event, asyncio.Task[Verdict]]:
    """The tool is placed, and an event of the alignment is being journalled."""
    await bench.go(PLACED)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    return gate, await bench.begin("alignment.within", source=TRACKER)


async def test_a_motion_waits_for_an_event_that_is_being_journalled(bench: Bench) -> None:
    gate, event = await within_on_its_way(bench)
    motion = await bench.begin("placement.nudge")
    assert not motion.done()
    gate.set()
    assert [(await task).decision for task in (event, motion)] == ["accepted", "accepted"]


async def test_a_motion_does_not_wait_for_long(bench: Bench) -> None:
    gate, event = await within_on_its_way(bench)
    asked = asyncio.get_running_loop().time()
    motion = await bench.begin("placement.nudge")
    asyncio.get_running_loop().call_at(asked + 2 * command_checks.CHECKS_BEGIN_WITHIN, gate.set)
    assert code(await motion) == "busy"
    assert (await event).decision == "accepted"
    assert "placement.nudge" not in bench.script.entered


async def test_one_motion_waits_and_nothing_that_acts_otherwise(bench: Bench) -> None:
    gate, event = await within_on_its_way(bench)
    motion, other = [await bench.begin(f"placement.{name}") for name in ("nudge", "back_off")]
    gate.set()
    assert code(await other) == "busy"
    assert [(await task).decision for task in (event, motion)] == ["accepted", "accepted"]


async def test_one_motion_waits_also_where_another_would_not_conflict() -> None:
    bench = Bench(ARMS, ["left", "right"])
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    event = await bench.begin("door.shut", source="device:door")
    first, second = [await bench.begin(f"{arm}.turn") for arm in ("left", "right")]
    gate.set()
    assert [(await task).decision for task in (event, first, second)] == ["accepted", "accepted", "rejected"]
    assert code(await second) == "busy"
    await bench.dispatcher.close()


async def test_a_motion_waits_for_no_command(bench: Bench) -> None:
    await bench.go(PLACED)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    stopping = await bench.begin("alignment.reinit")
    motion = await bench.begin("placement.nudge")
    gate.set()
    assert code(await motion) == "busy"
    await stopping


async def test_a_motion_that_waits_counts_as_moving(bench: Bench) -> None:
    gate, event = await within_on_its_way(bench)
    motion = await bench.begin("placement.nudge")
    dry_run = await bench.dispatcher.dry_run(bench.command("digitization.clear_surface"))
    plan = await bench.begin("toolplan.plan")
    gate.set()
    assert dry_run.reason is not None
    assert (dry_run.reason.code, code(await plan)) == ("busy", "busy")
    assert [(await task).decision for task in (event, motion)] == ["accepted", "accepted"]


async def test_a_motion_is_asked_again_whether_it_may_still_wait(bench: Bench) -> None:
    """An event with a step in the world has come ahead of it."""
    gate, _ = await within_on_its_way(bench)
    motion = await bench.begin("placement.nudge")
    outside = await bench.begin("alignment.outside", source=TRACKER)
    (waiting,) = (each for each in bench.dispatcher._locks.waiting if each.spec.event)
    waiting.side_effecting = True
    gate.set()
    assert code(await motion) == "busy"
    await outside


async def test_stop_rejects_a_motion_that_waits(bench: Bench) -> None:
    gate, event = await within_on_its_way(bench)
    motion = await bench.begin("placement.nudge")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    gate.set()
    assert code(await motion) == "stopped"
    assert (await event).decision == "accepted"
    await stop


@pytest.mark.parametrize("name", ["placement.confirm", "teleoperation.engage"])
async def test_command_that_moves_or_acts_is_checked_soon_or_refused(bench: Bench, name: str) -> None:
    joint = STANDOFF if name == "placement.confirm" else ("111", "1", "1", "1", "guided", "0", "off")
    await bench.go(joint)
    bench.script.entered.clear()
    arrived = asyncio.get_running_loop().time() - 2 * command_checks.CHECKS_BEGIN_WITHIN
    verdict = await bench.dispatcher.submit(bench.command(name), arrived=arrived)
    await settle()
    assert (verdict.decision, code(verdict), bench.joint) == ("rejected", "expired", joint)
    assert (bench.recorder.kinds(verdict.id), verdict in bench.published) == (["decision"], True)
    assert bench.script.entered == []


async def test_command_that_neither_moves_nor_acts_may_start_late(bench: Bench) -> None:
    arrived = asyncio.get_running_loop().time() - 60.0
    assert (await bench.dispatcher.submit(bench.command("toolplan.plan"), arrived=arrived)).decision == "accepted"


@pytest.mark.parametrize("name", ["toolplan.clear", "toolplan.plan", "registration.clear_registration"])
async def test_plan_and_registration_stay_until_standoff_is_journalled(bench: Bench, name: str) -> None:
    """A command that would take them away is rejected as busy."""
    await bench.go(HELD)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    retreat = await bench.begin("placement.back_off")
    change = await bench.begin(name)
    gate.set()
    assert (await retreat).state == "standoff"
    assert code(await change) == "busy"
    assert bench.joint == STANDOFF
    assert (await bench.do(name)).decision == "accepted"
    assert bench.joint[4] == "held"


@pytest.mark.parametrize("name", ["toolplan.clear", "toolplan.plan", "registration.clear_registration"])
async def test_retreat_does_not_end_at_a_standoff_that_has_changed(bench: Bench, name: str) -> None:
    await bench.go(HELD)
    at_the_end = bench.script.hang("placement.back_off")
    retreat = await bench.begin("placement.back_off")
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    change = await bench.begin(name)
    at_the_end.set()
    await settle()
    gate.set()
    assert (await change).decision == "accepted"
    assert (code(await retreat), bench.joint[4]) == ("outcome_outdated", "held")


async def test_retreat_does_not_end_at_a_plan_journalled_as_it_began(bench: Bench) -> None:
    await bench.go(HELD)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    plan = await bench.begin("toolplan.plan")
    retreat = await bench.begin("placement.back_off")
    gate.set()
    assert (await plan).decision == "accepted"
    assert (code(await retreat), bench.joint[4]) == ("outcome_outdated", "held")


async def test_failure_after_a_verdict_is_fail_stop_and_frees_locks(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("The test wants it to fail.")

    await bench.go(STANDOFF)
    monkeypatch.setattr(bench.dispatcher._activities, "follow", fail)
    assert (await bench.do("placement.back_off")).decision == "accepted"
    await settle()
    assert bench.dispatcher.broken is not None
    assert bench.dispatcher.broken.code == "internal_error"
    assert bench.dispatcher._locks.running == []
    assert (bench.holds, bench.dispatcher.snapshot().latched) == (1, True)
    assert code(await bench.do("toolplan.plan")) == "internal_error"


def test_no_event_moves_or_acts() -> None:
    """Nothing that moves waits for its turn, and an event is never turned away."""
    operations = (spec for branch in RATMS.branches.values() for spec in branch.operations.values())
    assert not any(spec.event and spec.blocked_when_latched for spec in operations)
