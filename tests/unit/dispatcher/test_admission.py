"""Admission: what waits, for how long, and what a suspended dispatcher still takes."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.dispatcher import command_checks
from pcmrs.fsm import parse_blueprint
from pcmrs.messages import DeviceEvent, Reason, Verdict
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, RETRACTED, STANDOFF, Bench, code

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


def test_no_event_moves_or_acts() -> None:
    """Nothing that moves waits for its turn, and an event is never turned away."""
    operations = (spec for branch in RATMS.branches.values() for spec in branch.operations.values())
    assert not any(spec.event and spec.blocked_when_latched for spec in operations)


FULL = Reason(code="disk_full", text="50 MB are free.")


async def test_commands_are_rejected_without_a_row_and_later_redecided(bench: Bench) -> None:
    await bench.go(RETRACTED)
    rows = len(bench.recorder.rows)
    bench.dispatcher.suspend(FULL)

    for name in ("toolplan.clear", "placement.approach", "robot.disconnect"):
        verdict = await bench.do(name, id=f"again-{name}")
        assert (verdict.decision, verdict.reason) == ("rejected", FULL)
        assert verdict in bench.published
    assert len(bench.recorder.rows) == rows

    bench.dispatcher.suspend(None)
    verdict = await bench.do("placement.approach", id="again-placement.approach")
    assert verdict.decision == "accepted"
    assert bench.joint == STANDOFF


async def test_stop_events_and_running_commands_continue(bench: Bench) -> None:
    await bench.go(RETRACTED)
    rows = len(bench.recorder.rows)
    bench.dispatcher.suspend(FULL)

    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="gone", danger=True))
    assert bench.dispatcher.snapshot().branches["robot"] == "0"
    await bench.dispatcher.stop("test:operator")

    assert bench.dispatcher.snapshot().latched
    assert len(bench.recorder.rows) > rows
    assert bench.dispatcher.broken is None


async def test_nobody_is_kept_from_retreating(bench: Bench) -> None:
    await bench.go(STANDOFF)
    await bench.dispatcher.stop("test:operator")
    bench.dispatcher.suspend(FULL)

    assert (await bench.do("robot.acknowledge", arguments={"stop": 1})).decision == "accepted"
    assert (await bench.dispatcher.dry_run(bench.command("placement.back_off"))).reason is None
    assert (await bench.do("placement.back_off")).decision == "accepted"
    assert (await bench.do("placement.home")).decision == "accepted"
    assert bench.joint == RETRACTED
    assert (await bench.do("placement.approach")).reason == FULL


async def test_an_operation_that_runs_ends_as_it_would(bench: Bench) -> None:
    await bench.go(RETRACTED)
    approach = asyncio.ensure_future(bench.do("placement.approach"))
    await asyncio.sleep(0)
    bench.dispatcher.suspend(FULL)

    assert (await approach).decision == "accepted"
    assert bench.joint == STANDOFF
