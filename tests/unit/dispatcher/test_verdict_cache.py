"""Verdicts by source and id: a repeat runs nothing, in this run and after a restart."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.dispatcher import verdict_cache
from pcmrs.dispatcher.events import EarlierDecision
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.messages import Command, Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import Bench, MemoryRecorder


@pytest.fixture
def remembered(monkeypatch: pytest.MonkeyPatch) -> VerdictCache:
    monkeypatch.setattr(verdict_cache, "MAX_REMEMBERED", 2)
    return VerdictCache(MemoryRecorder())


def command(name: str) -> Command:
    return Command(id=name, branch="robot", operation="connect", source="test:user")


def verdict(name: str, sequence: int) -> Verdict:
    return Verdict(id=name, branch="robot", operation="connect", decision="accepted", state="1", sequence=sequence)


async def test_older_verdicts_are_those_of_the_journal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict_cache, "MAX_REMEMBERED", 2)
    recorder = MemoryRecorder()
    remembered = VerdictCache(recorder)
    for number, name in enumerate(("c1", "c2", "c3")):
        asked, _ = remembered.verdict_of(command(name))
        remembered.settle(asked, verdict(name, number))
    recorder.earlier = {("test:user", name): EarlierDecision(verdict(name, 100), {}) for name in ("c1", "c3")}
    found = {name: remembered.verdict_of(command(name)) for name in ("c3", "c1")}
    assert [is_new for _, is_new in found.values()] == [False, False]
    assert {name: asked.result().sequence for name, (asked, _) in found.items()} == {"c3": 2, "c1": 100}


async def test_the_first_answer_stands(remembered: VerdictCache) -> None:
    """What breaks after the answer is concluded a second time."""
    asked, _ = remembered.verdict_of(command("c1"))
    remembered.settle(asked, verdict("c1", 1))
    remembered.settle(asked, verdict("c1", 2))
    assert asked.result().sequence == 1


async def test_running_command_is_never_forgotten(remembered: VerdictCache) -> None:
    """Its verdict is not in the journal yet: a repeat would be taken for a new command, and perform it again."""
    running, _ = remembered.verdict_of(command("motion"))
    for number in range(10):
        asked, is_new = remembered.verdict_of(command(f"c{number}"))
        assert is_new
        remembered.settle(asked, verdict(f"c{number}", number))
    assert remembered.verdict_of(command("motion")) == (running, False)


async def test_14_a_repeat_gets_the_recorded_decision_and_runs_nothing(bench: Bench) -> None:
    command = bench.command("toolplan.plan")
    verdict = await bench.dispatcher.submit(command)
    sequence, entered = bench.dispatcher.snapshot().sequence, list(bench.script.entered)
    assert await bench.dispatcher.submit(command) == verdict
    assert (bench.dispatcher.snapshot().sequence, bench.script.entered) == (sequence, entered)
    rejected = bench.command("registration.register")
    first = await bench.dispatcher.submit(rejected)
    await bench.do("registration.plan_landmarks")
    await bench.do("digitization.digitize_all")
    assert await bench.dispatcher.submit(rejected) == first


async def test_14_a_repeat_while_it_runs_attaches_to_it(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    command = bench.command("robot.connect")
    tasks = [asyncio.create_task(bench.dispatcher.submit(command)) for _ in range(3)]
    await settle()
    gate.set()
    first, *others = await asyncio.gather(*tasks)
    assert others == [first, first]
    assert bench.recorder.kinds(command.id) == ["intent", "decision"]


async def test_14_the_key_is_source_and_id(bench: Bench) -> None:
    await bench.do("toolplan.plan", id="1", source="test:a")
    verdict = await bench.do("toolplan.clear", id="1", source="test:b")
    assert (verdict.operation, bench.joint[2]) == ("clear", "0")


async def test_14_verdicts_of_an_earlier_run_are_recalled(bench: Bench) -> None:
    earlier = Verdict(id="9", branch="toolplan", operation="plan", decision="unknown", state="0", sequence=4)
    bench.recorder.earlier["test:user", "9"] = EarlierDecision(earlier, {})
    assert await bench.do("toolplan.plan", id="9") == earlier
    assert bench.joint == INITIAL


@pytest.mark.parametrize(
    ("name", "arguments"), [("toolplan.clear", {}), ("robot.connect", {}), ("toolplan.plan", {"values": [1.0]})]
)
@pytest.mark.parametrize("earlier_run", [True, False])
async def test_14_an_id_stands_for_one_command(
    bench: Bench, name: str, arguments: dict[str, Any], earlier_run: bool
) -> None:
    """Whoever uses it for something else is not told that this was done."""
    if earlier_run:
        done = Verdict(id="9", branch="toolplan", operation="plan", decision="accepted", state="1", sequence=4)
        bench.recorder.earlier["test:user", "9"] = EarlierDecision(done, {"values": [2.0]})
    else:
        await bench.do("toolplan.plan", id="9", arguments={"values": [2.0]})
    rows, joint = len(bench.recorder.rows), bench.joint
    reused = await bench.do(name, id="9", arguments=arguments)
    assert reused.reason is not None
    assert (reused.decision, reused.reason.code) == ("rejected", "id_reused")
    assert (len(bench.recorder.rows), bench.joint) == (rows, joint)
    assert reused in bench.published
    again = await bench.do("toolplan.plan", id="9", arguments={"values": [2.0]})
    assert again.decision == "accepted", "what it stands for is as before"
