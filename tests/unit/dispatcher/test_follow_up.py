"""Consequences of a verdict: listeners, locks and posted commands."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.dispatcher import Run
from pcmrs.errors import RefusalError
from pcmrs.messages import Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import STANDOFF, Bench, Notes, code


def posting(name: str) -> Any:
    async def post(run: Run[Any, Notes]) -> None:
        branch, operation = name.split(".")
        run.post(branch, operation)

    return post


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


async def test_09_a_step_posts_a_command_which_carries_its_parent(bench: Bench) -> None:
    bench.script.steps["robot.connect"] = posting("placement.locate")
    verdict = await bench.do("robot.connect", id="parent")
    await settle()
    posted = bench.recorder.commands[-1]
    assert verdict.decision == "accepted"
    assert (posted.parent, posted.operation) == ("parent", "locate")
    assert bench.joint[4] == "retracted"


async def test_09_an_operation_that_fails_posts_nothing(bench: Bench) -> None:
    async def post_and_fail(run: Run[Any, Notes]) -> None:
        run.post("toolplan", "plan")
        raise RefusalError("no", "No.")

    bench.script.steps["robot.connect"] = post_and_fail
    await bench.do("robot.connect")
    await settle()
    assert bench.joint == INITIAL


@pytest.mark.parametrize("name", ["registration.plan_landmarks", "robot.connect", "registration.no_such_operation"])
async def test_requester_is_answered_before_the_verdict_is_published(bench: Bench, name: str) -> None:
    published_at_reply: list[int] = []

    async def request() -> None:
        await bench.dispatcher.submit(bench.command(name))
        published_at_reply.append(sum(isinstance(each, Verdict) for each in bench.published))

    await asyncio.gather(request())
    await settle()
    assert published_at_reply == [0]
    assert sum(isinstance(each, Verdict) for each in bench.published) == 1
