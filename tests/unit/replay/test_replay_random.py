"""Whatever a dispatcher has journalled, it decides again."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.dispatcher.locks import LockManager
from pcmrs.replay.replay import ReplayReport, replay_runs
from pcmrs.simulated_time.loop import SimulatedLoop
from tests.support.trials import examples
from tests.unit.replay.random_course import OPERATIONS, Course, is_event

Action = tuple[str, tuple[Any, ...]]

FOLLOWING = 6
"""No row makes more than so many others follow, one after the other, each once the one before is durable."""

WAY = ["registration.plan_landmarks", "digitization.digitize_all", "registration.register", "toolplan.plan"]
WAY += ["robot.connect", "placement.locate", "placement.approach", "placement.confirm", "placement.follow"]
NAMES = [f"{branch}.{operation}" for branch, operation in OPERATIONS]
ON_THE_WAY = [NAMES.index(name) for name in WAY]

values = st.sampled_from([0.0, 7.0, 11.0, -1.0])
indices = st.one_of(st.sampled_from(ON_THE_WAY), st.integers(0, len(OPERATIONS) - 1))
endings = st.sampled_from([None, None, None, "failed", "unknown", "raised", "partial", "moved", "held", "standoff"])
actions: st.SearchStrategy[Action] = st.one_of(
    st.tuples(st.just("submit"), st.tuples(indices, values)),
    st.tuples(st.just("submit"), st.tuples(indices, st.just(0.0))),
    st.tuples(st.just("end"), st.tuples(st.integers(0, 3), endings)),
    st.tuples(st.just("flush"), st.tuples(st.sampled_from([1, 2, 99]))),
    st.tuples(st.just("idle"), st.just(())),
    st.tuples(st.just("stop"), st.just(("bus:test",))),
    st.tuples(st.just("report"), st.tuples(st.sampled_from(["link_lost", "warm", "force_limit"]), st.booleans())),
    st.tuples(st.just("fail"), st.tuples(st.booleans())),
    st.tuples(st.just("confirm"), st.tuples(st.sampled_from([True, True, True, False]))),
    st.tuples(st.just("joints"), st.tuples(st.sampled_from([0.0, 1.0]))),
)


async def perform(course: Course, todo: list[Action]) -> None:
    for name, arguments in todo:
        if name == "submit":
            if is_event(arguments[0]):  # as a detector does, which sees what has happened
                await settled(course)
            course.submit(*arguments)
        elif name == "end":
            if course.end_one(*arguments):
                await asyncio.sleep(1.0)  # whether it ended before what is asked for next, no journal tells
        elif name == "flush":
            course.flush(*arguments)
        elif name == "stop":
            await settled(course)
            course.stop(*arguments)
        elif name == "report":
            await settled(course)
            course.report(*arguments)
        elif name == "fail":
            await settled(course)
            course.fail()
            await asyncio.sleep(1.0)
            course.confirm(stands=arguments[0])  # of two holds at once no journal tells which was answered first
            await asyncio.sleep(1.0)  # nor what was asked for in the turn of the loop in which an operation ended
        elif name == "confirm":
            course.confirm(stands=arguments[0])
            await asyncio.sleep(1.0)
        elif name == "joints":
            course.cell.joints = arguments[0]
        await asyncio.sleep(1.0 if name == "idle" else 0.0)


async def settled(course: Course) -> None:
    """Danger comes when the disk has all and the last hold is answered: a journal does not tell which came first."""
    for _ in range(FOLLOWING):
        course.confirm(stands=True)
        course.flush(99)
        await asyncio.sleep(1.0)


async def on_the_way(course: Course, far: int) -> None:
    """Performs the first operations of a whole procedure."""
    for index in ON_THE_WAY[:far]:
        course.submit(index, 0.0)
        for _ in range(3):
            await asyncio.sleep(1.0)
            course.flush(99)
            await asyncio.sleep(1.0)
            course.end_one(-1, None)  # the newest: activities go on


async def record(far: int, todo: list[Action]) -> Course:
    course = Course()
    await on_the_way(course, far)
    await perform(course, todo)
    await asyncio.sleep(1.0)
    await course.close()
    return course


def decide_anew(course: Course) -> ReplayReport:
    return replay_runs("memory", course.runs(), lambda _: course.workflow, SystemClock())


def on_simulated_time(work: Any) -> Any:
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        return runner.run(work)


@examples(40, derandomize=True)
@given(far=st.integers(0, len(WAY)), todo=st.lists(actions, max_size=40))
def test_every_random_course_is_decided_again_as_it_was(far: int, todo: list[Action]) -> None:
    check_decided_again(far, todo)


@pytest.mark.parametrize("first", ["fail", "stop"])
def test_which_of_two_holds_was_not_confirmed_is_no_difference(first: str) -> None:
    begin = ("fail", (True,)) if first == "fail" else ("stop", ("bus:test",))
    check_decided_again(0, [begin, ("stop", ("bus:test",)), ("flush", (1,)), ("confirm", (False,))])


@pytest.mark.nightly
@examples(400, derandomize=True)  # now and then a course rests on an order that no journal tells: docs/replay.md
@given(far=st.integers(0, len(WAY)), todo=st.lists(actions, max_size=40))
def test_many_random_courses_are_decided_again_as_they_were(far: int, todo: list[Action]) -> None:
    check_decided_again(far, todo)


def check_decided_again(far: int, todo: list[Action]) -> None:
    course = on_simulated_time(record(far, todo))
    replayed = decide_anew(course)
    assert replayed.differences == [], _told(course)


async def turn_one_away() -> Course:
    """A course in which Stop finds one operation under way and another waiting."""
    course = Course()
    await on_the_way(course, 1)
    for name in ("digitization.digitize_all", "registration.clear_landmarks"):
        course.submit(NAMES.index(name), 0.0)
        await asyncio.sleep(1.0)
        course.flush(99)
    await asyncio.sleep(1.0)
    course.stop("bus:test")
    await asyncio.sleep(1.0)
    await course.close()
    return course


def test_that_stop_turns_away_what_waits_is_decided_again(monkeypatch: pytest.MonkeyPatch) -> None:
    course = on_simulated_time(turn_one_away())
    waited = [each.row.verdict for each in course.rows if each.row.operation == "clear_landmarks"]
    assert [verdict.reason.code for verdict in waited if verdict and verdict.reason] == ["stopped"]
    assert decide_anew(course).differences == []
    monkeypatch.setattr(LockManager, "drain_commands", lambda _: [])
    assert decide_anew(course).differences


def _told(course: Course) -> str:
    lines = []
    for each in course.rows:
        row, verdict = each.row, each.row.verdict
        said = (verdict.decision, verdict.reason.code if verdict.reason else "", verdict.sequence) if verdict else ""
        lines.append(f"{each.sequence} {row.kind} {row.source} {row.command_id} {row.operation} {said} {row.states}")
    return "\n".join(lines)
