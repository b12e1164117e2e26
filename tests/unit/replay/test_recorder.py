"""Replayed decisions meet their journalled rows, and are durable when those show that they were."""

from __future__ import annotations

from pcmrs.messages import Command, DeviceEvent, Verdict
from pcmrs.replay._recorder import ReplayRecorder
from tests.unit.replay.rows import event, intent, outcome, stored


def command(number: int, name: str = "robot.connect") -> Command:
    branch, operation = name.split(".")
    return Command(id=f"c{number}", branch=branch, operation=operation, source="bus:test", arguments={})


def verdict(asked: Command) -> Verdict:
    return Verdict(
        id=asked.id, branch=asked.branch, operation=asked.operation, decision="accepted", state="1", sequence=1
    )


async def test_decisions_are_matched_by_their_key_whatever_their_order() -> None:
    recorder = ReplayRecorder(stored([outcome("robot.connect", "c1"), outcome("robot.connect", "c2")]))
    assert recorder.outcome_of(command(2)) is not None
    for number in (2, 1):
        asked = command(number)
        recorder.decision(asked, verdict(asked), {"robot": "1"}, {}, with_intent=False)
    for index, name in enumerate(("c1", "c2")):
        found = recorder.decided(index)
        assert found is not None
        assert found.verdict is not None
        assert (found.verdict.id, found.index) == (name, index)
    assert recorder.outcome_of(command(2)) is None, "it has been decided"
    assert recorder.extra == []


async def test_a_decision_without_a_row_is_extra() -> None:
    recorder = ReplayRecorder(stored([outcome("robot.connect", "c1")]))
    asked = command(9)
    recorder.decision(asked, verdict(asked), {}, {}, with_intent=True)
    assert [each.key.kind for each in recorder.extra] == ["intent", "outcome"]
    assert recorder.decided(0) is None


async def test_decision_is_durable_after_the_rows_made_without_it() -> None:
    """The second row names an older commit: the first was not yet on the disk."""
    rows = [outcome("robot.connect", "c1", sequence=5), outcome("toolplan.plan", "c2", "rejected", sequence=4)]
    recorder = ReplayRecorder(stored([*rows, outcome("robot.connect", "c3", sequence=6)]))
    asked = command(1)
    durable = recorder.decision(asked, verdict(asked), {}, {}, with_intent=False)
    recorder.release(1)
    assert not durable.done()
    assert recorder.holds_locks("robot.connect")
    recorder.release(2)
    assert durable.done()
    assert not recorder.holds_locks("robot.connect")


async def test_events_are_durable_one_by_one_and_by_source() -> None:
    rows = [event("warm", "tracker"), event("warm", "robot"), intent("robot.connect", "c1")]
    recorder = ReplayRecorder(stored(rows))
    of_tracker, of_robot = (
        recorder.event(DeviceEvent(device=device, code="warm", text=""), {}) for device in ("tracker", "robot")
    )
    recorder.release(3)
    assert (of_tracker.done(), of_robot.done()) == (False, False)
    assert recorder.release_event(3, "device:robot")
    assert (of_tracker.done(), of_robot.done()) == (False, True)
    assert not recorder.release_event(3, "robot")
    assert recorder.release_any(3)
    assert of_tracker.done()
    assert not recorder.release_any(3)


async def test_at_the_end_everything_is_durable_and_nothing_compared() -> None:
    recorder = ReplayRecorder(stored([outcome("robot.connect", "c1")]))
    pending = recorder.intent(command(1), {})
    recorder.end()
    later = recorder.intent(command(2), {})
    assert pending.done()
    assert later.done()
    assert [each.key.id for each in recorder.extra] == ["c1"]


async def test_changes_are_compared_as_plain_data() -> None:
    recorder = ReplayRecorder(stored([outcome("robot.connect", "c1")]))
    asked = command(1)
    recorder.decision(asked, verdict(asked), {}, {"points": ((0.1, 0.2),), "plan": None}, with_intent=False)
    found = recorder.decided(0)
    assert found is not None
    assert found.changes == {"points": ((0.1, 0.2),), "plan": None}
    recorder.recall("bus:test", "c1")
    assert recorder.submitted == {("bus:test", "c1")}
