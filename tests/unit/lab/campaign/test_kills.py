"""Killed writers: what of a killed process counts, what is lost, and what its pipe says."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import JournalError
from pcmrs.failpoints import FAILPOINTS
from pcmrs.journal import Journal
from pcmrs.testing.clock import ManualClock
from pcmrs.testing.journal import row
from pcmrs_lab.campaign import kills
from pcmrs_lab.campaign.kills import RANDOM, KillReport, Tally, VerifiedPrefix, lost_rows
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.writing import REFUSED, SEQUENCE

Ended = tuple[list[int], bool]


async def journal(path: Path, *runs: str) -> None:
    opened = Journal.open(path)
    for number, run in enumerate(runs):
        await opened.append([row(run, 0, number)])
    await opened.close()


async def test_a_row_that_is_not_there_is_a_loss(tmp_path: Path) -> None:
    await journal(tmp_path / "journal.sqlite", *["run0"] * 3)
    assert lost_rows(tmp_path / "journal.sqlite", "run0", [2, 3], VerifiedPrefix()) == 0
    assert lost_rows(tmp_path / "journal.sqlite", "run0", [3, 9], VerifiedPrefix()) == 1
    assert lost_rows(tmp_path / "journal.sqlite", "run1", [2, 3], VerifiedPrefix()) == 2
    assert lost_rows(tmp_path / "nowhere.sqlite", "run0", [1], VerifiedPrefix()) == 1


async def test_broken_chain_is_detected(tmp_path: Path) -> None:
    await journal(tmp_path / "journal.sqlite", *["run0"] * 3)
    with pytest.raises(JournalError, match="does not continue"):
        lost_rows(tmp_path / "journal.sqlite", "run0", [2], VerifiedPrefix(1, bytes(32)))


async def test_the_next_run_is_verified_from_the_last_on(tmp_path: Path) -> None:
    path, checked = tmp_path / "journal.sqlite", VerifiedPrefix()
    await journal(path, "run0", "run0")
    assert lost_rows(path, "run0", [1, 2], checked) == 0
    assert checked.sequence == 2
    await journal(path, "run1")
    assert lost_rows(path, "run1", [3], checked) == 0
    assert lost_rows(path, "run1", [3], checked) == 1, "what was verified is not read again"


def test_each_killed_process_is_counted_where_it_died() -> None:
    seen: list[tuple[str, int, int]] = []
    tally = Tally(ManualClock(), 7, 4, None, lambda *shown: seen.append(shown))
    first = FAILPOINTS[0]
    tally.count(RANDOM, 5, 0, reached=True)
    tally.count(first, 3, 1, reached=True)
    tally.count(first, 0, 0, reached=False)
    report = tally.report("a process")
    assert (report.kills, report.at, report.not_reached) == (3, {first: 1, RANDOM: 1}, {first: 1})
    assert list(report.at) == [first, RANDOM], "in the order of the failpoints"
    assert (report.acknowledged, report.lost, report.seed, report.violated) == (8, 1, 7, True)
    assert not tally.done
    tally.count(RANDOM, 0, 0, reached=True)
    assert tally.done
    assert seen[0] == (f"killed at {RANDOM}", 1, 4)
    assert seen[2] == (f"{first} not reached", 3, 4)


@pytest.mark.parametrize(("lost", "refused", "violated"), [(0, [], False), (1, [], True), (0, ["damaged"], True)])
def test_a_loss_or_an_unreadable_journal_violates(lost: int, refused: list[str], violated: bool) -> None:
    assert KillReport("a process", 1, {}, {}, 9, lost, refused, 1, 1.0).violated is violated


def test_a_run_is_done_when_its_time_is_over() -> None:
    clock = ManualClock()
    tally = Tally(clock, 1, 1000, 0.5, lambda *_: None)
    assert not tally.done
    clock.stall(30.0)
    assert tally.done
    assert tally.report("a process").seconds == 30.0


def test_nothing_is_killed_in_a_sham_campaign() -> None:
    with sham():
        assert Tally(ManualClock(), 1, 1000, None, lambda *_: None).done


def test_the_pipe_of_a_process_says_what_it_acknowledged() -> None:
    begun, whole = SEQUENCE.pack(0), SEQUENCE.pack(4) + SEQUENCE.pack(7)
    assert kills._acknowledged(begun + whole) == [4, 7]
    assert kills._acknowledged(begun + whole + SEQUENCE.pack(9)[:3]) == [4, 7], "half a number is none"
    with pytest.raises(JournalError, match="is damaged"):
        kills._acknowledged(begun + SEQUENCE.pack(REFUSED) + b"It is damaged.")


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)


def test_a_pipe_is_read_until_closed_enough_or_late(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    clock = SystemClock()
    os.write(writing, b"12345678more")
    assert kills._read(reading, 8, clock.monotonic() + 30.0, clock) == b"12345678"
    assert kills._read(reading, 0, clock.monotonic(), clock) == b"more"
    assert kills._read(reading, 8, clock.monotonic(), clock) == b""
    os.write(writing, b"last")
    os.close(writing)
    assert kills._read(reading, 0, clock.monotonic() + 30.0, clock) == b"last"


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> list[Ended | JournalError]:
    """What each writer acknowledged and whether it died at its place; or an error."""
    found: list[Ended | JournalError] = []

    def run(_context: Any, _path: Path, _number: int, _place: str, *_: Any) -> Ended:
        answer = found.pop(0)
        if isinstance(answer, JournalError):
            raise answer
        return answer

    monkeypatch.setattr(kills, "_run_until_killed", run)
    monkeypatch.setattr(kills, "lost_rows", lambda _path, _run, acknowledged, _checked: len(acknowledged) // 10)
    return found


def test_a_journal_that_cannot_be_opened_is_given_up(processes: list[Ended | JournalError]) -> None:
    processes += [([1, 2], True), JournalError("It is damaged."), ([3], False), (list(range(10)), True)]
    report = kills.kill_writers(4, 1, ManualClock())
    assert report.kills == 4
    assert report.refused == ["It is damaged."]
    assert (report.acknowledged, report.lost) == (13, 1)
    assert sum(report.not_reached.values()) == 2
    assert report.violated
