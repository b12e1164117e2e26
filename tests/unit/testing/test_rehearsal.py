"""The dispatcher on a scripted tour: RATMS does as it must in every way, and one that does not is found out."""

from __future__ import annotations

import logging
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from functools import cache
from typing import Any, cast

import pytest
import structlog

from pcmrs.authoring.trial.coverage import Deviation
from pcmrs.authoring.trial.tour import Tour, TourCommand, plan_tour
from pcmrs.fsm import Blueprint, parse_blueprint
from pcmrs.testing.rehearsal import LeapingClock, rehearse
from tests.support.altered import with_operation
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.rules.small_workflow import SMALL

Judged = tuple[TourCommand, Deviation | None]


@pytest.fixture(autouse=True)
def steps_that_raise_are_not_logged() -> Iterator[None]:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    yield
    structlog.reset_defaults()


@cache
def small() -> Blueprint:
    return parse_blueprint(SMALL.encode())


@cache
def tour() -> Tour:
    return plan_tour(shipped_blueprint("ratms"))


async def rehearsed(blueprint: Blueprint, *, outside: bool = True) -> list[Judged]:
    return [judged async for judged in rehearse(blueprint, tour(), outside=outside)]


@pytest.mark.parametrize("outside", [True, False])
async def test_the_dispatcher_does_as_the_tour_says(outside: bool) -> None:
    done = await rehearsed(shipped_blueprint("ratms"), outside=outside)
    assert [deviation for _, deviation in done if deviation is not None] == []
    assert {move for move, _ in done} == set(tour().wanted)


async def test_nothing_is_too_late_however_busy_the_machine_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.dispatcher.command_checks.CHECKS_BEGIN_WITHIN", 0.0)
    done = [judged async for judged in rehearse(small(), plan_tour(small()), outside=True)]
    assert [deviation for _, deviation in done if deviation is not None] == []


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "approach", {"on_failure": "unknown"}),
        ("placement", "confirm", {"requires": {}, "from_": ["retracted", "standoff"]}),
        ("placement", "confirm", {"checks": []}),
        ("placement", "confirm", {"steps": ["follow_prepared"]}),
        ("registration", "digitized", {"iio": False}),
        ("robot", "link_lost", {"event": False}),
        ("registration", "plan_landmarks", {"to": "000"}),
    ],
)
async def test_a_dispatcher_that_runs_something_else_deviates(
    branch: str, operation: str, fields: dict[str, Any]
) -> None:
    other = with_operation(shipped_blueprint("ratms"), branch, operation, **fields)
    async with aclosing(cast(AsyncGenerator[Judged, None], rehearse(other, tour(), outside=True))) as judged:
        first = await anext(deviation async for _, deviation in judged if deviation is not None)
    assert first.command.startswith(f"{branch}.{operation}:")


async def too_late(clock: LeapingClock) -> None:
    async with clock.timeout(10.0):
        await clock.sleep(4.0)
        await clock.sleep(7.0)


async def test_a_deadline_that_is_leapt_over_has_passed() -> None:
    clock = LeapingClock()
    begin = clock.monotonic()
    async with clock.timeout(10.0):
        await clock.sleep(9.0)
    with pytest.raises(TimeoutError):
        await too_late(clock)
    assert clock.monotonic() - begin == 20.0


async def test_the_end_of_a_step_is_what_the_move_requires() -> None:
    """The verdict names the check or the step that ended it: another one would be a deviation."""
    done = [judged async for judged in rehearse(small(), plan_tour(small()), outside=True)]
    endings = {(move.at, move.how, move.ending) for move, deviation in done if deviation is None}
    assert {("follow", how, "failed") for how in ("refuses", "raises", "late")} <= endings
    assert ("follow", "silent", "unknown") in endings


async def test_a_stretch_that_has_left_the_tour_is_not_continued() -> None:
    other = with_operation(small(), "top", "prepare", to="00")
    planned = plan_tour(small())
    done = [judged async for judged in rehearse(other, planned, outside=True)]
    last = [deviation for _, deviation in done][-1]
    assert last is not None
    assert len(done) < sum(map(len, planned.stretches))
