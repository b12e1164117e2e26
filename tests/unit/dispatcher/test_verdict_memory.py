"""So many verdicts are kept in memory; the journal knows the older ones, and what runs is never forgotten."""

from __future__ import annotations

import pytest

from pcmrs.dispatcher import verdict_cache
from pcmrs.dispatcher.recorder import EarlierDecision
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.messages import Command, Verdict
from tests.unit.dispatcher.dispatcher_fakes import MemoryRecorder


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
