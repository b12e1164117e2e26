"""The journal answers for the devices: whether the robot stands, was released, and how activities ended."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.dispatcher.execution import reason_of
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.journal import JournalRow
from pcmrs.messages import Reason
from pcmrs.replay._answers import Holds, end_activities, end_unrequested
from pcmrs.replay._workflow import PendingActivity
from tests.unit.replay.rows import event, outcome

SILENT = Reason(code="outcome_unknown", text="The robot does not answer.", fields={"step": "release_stop", "link": 1})


async def started(work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
    """A task that waits already."""
    task = asyncio.create_task(work)
    await asyncio.sleep(0)
    return task


@pytest.mark.parametrize(
    ("rows", "confirmed"),
    [
        ([outcome("robot.acknowledge")], True),
        ([event("stopped", danger=True), event(NOT_CONFIRMED, danger=True)], True),
        ([event("warm"), event(NOT_CONFIRMED, danger=True)], False),
        ([outcome("placement.home", decision="unknown")], False),
    ],
)
async def test_a_hold_is_confirmed_unless_the_next_danger_says_no(rows: list[JournalRow], confirmed: bool) -> None:
    holds = Holds(rows)
    assert not holds.answer(0), "nothing waits yet"
    holding = await started(holds.hold(True))
    assert holds.answer(0)
    if confirmed:
        await holding
    else:
        with pytest.raises(DeviceError, match="not confirmed"):
            await holding
    assert not holds.answer(0), "each is answered once"


async def test_devices_that_stayed_latched_are_those_of_the_verdict() -> None:
    holds = Holds(
        [outcome("robot.acknowledge", result={"still_latched": ["stimulator"]}), outcome("robot.acknowledge")]
    )
    for index, latched in enumerate((["stimulator"], [])):
        released = await started(holds.release(True))
        assert holds.answer_release(index)
        assert await released == latched


@pytest.mark.parametrize(
    ("decision", "reason", "error", "code"),
    [
        ("unknown", SILENT, UnknownOutcomeError, "outcome_unknown"),
        ("failed", Reason(code="no_marker", text="It moves.", fields={}), DeviceError, "no_marker"),
        ("failed", None, DeviceError, "device_failed"),
    ],
)
async def test_a_release_that_failed_raises_what_was_journalled(
    decision: Any, reason: Reason | None, error: type[PcmrsError], code: str
) -> None:
    holds = Holds([outcome("robot.acknowledge", decision=decision, reason=reason)])
    released = await started(holds.release(True))
    holds.answer_release(0)
    with pytest.raises(error) as raised:
        await released
    assert reason_of(raised.value).code == code
    if reason is SILENT:
        assert raised.value.fields == {"link": 1}


async def test_after_the_end_nobody_waits() -> None:
    holds = Holds([])
    holding = await started(holds.hold(False))
    holds.end()
    await holding
    await asyncio.wait_for(holds.hold(True), 1.0)
    assert await asyncio.wait_for(holds.release(True), 1.0) == []


def activity(name: str) -> PendingActivity:
    loop = asyncio.get_running_loop()
    return PendingActivity(name, loop.create_future(), asyncio.Event(), loop.create_future())


async def test_activities_asked_to_end_do_so_by_source_or_all() -> None:
    following, watching, other = activity("follow_head"), activity("watch_alignment"), activity("teleoperate")
    following.end_requested.set()
    watching.end_requested.set()
    assert end_activities([following, watching, other], "activity:watch_alignment")
    assert [each.end_allowed.done() for each in (following, watching, other)] == [False, True, False]
    assert end_activities([following, watching, other], "bus:test")
    assert [each.end_allowed.done() for each in (following, watching, other)] == [True, True, False]
    assert not end_activities([following, watching, other], None)


@pytest.mark.parametrize(
    ("code", "error"), [("activity_ended", None), ("activity_raised", RuntimeError), ("pose_stale", RefusalError)]
)
async def test_an_activity_ends_by_itself_as_journalled(code: str, error: type[Exception] | None) -> None:
    following, other = activity("follow_head"), activity("watch_alignment")
    end_unrequested([following, other], "follow_head", Reason(code=code, text="It ended."))
    assert following.unrequested_end.done()
    assert not other.unrequested_end.done()
    raised = following.unrequested_end.exception()
    assert raised is None if error is None else isinstance(raised, error)
    if isinstance(raised, RefusalError):
        assert raised.refusal_code == "pose_stale"


async def test_an_end_with_another_reason_answers_the_request() -> None:
    following = activity("follow_head")
    following.end_requested.set()
    end_unrequested([following], "follow_head", Reason(code="pose_stale", text="Hidden."))
    assert not following.unrequested_end.done()
    assert isinstance(following.end_allowed.exception(), RefusalError)
