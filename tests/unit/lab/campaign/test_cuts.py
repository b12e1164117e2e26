"""A damaged journal is counted as refused, whole or lost; a loss that nobody reports is found."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import StoredRow
from pcmrs.testing.clock import ManualClock
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import NAME, contents
from pcmrs_lab.campaign import cuts
from pcmrs_lab.campaign.cuts import CutReport, cut_and_flip, cut_power
from pcmrs_lab.campaign.power_loss import PowerCut
from pcmrs_lab.campaign.sham import sham

CLEAN = CutReport("cut or bent", 10, 60, 8, 2, 0, [], [], 10, 2, 1, 1.0)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is found of each damaged journal, in order: whole, refused, or an error; the controls are whole."""
    found: list[Any] = [True, True]

    def recovered(path: Path, rows: Sequence[StoredRow]) -> bool:
        answer = found.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return bool(answer)

    monkeypatch.setattr(cuts, "is_recovered", recovered)
    monkeypatch.setattr(cuts, "ROWS", 3)
    return found


def test_every_damaged_journal_is_counted_once(opened: list[Any]) -> None:
    opened += [True, False, False, Unmet("2 rows are missing"), KeyError("head")]
    report = cut_and_flip(2, 3, 1, ManualClock())
    assert (report.tried, report.unaffected, report.reported, report.whole) == (5, 1, 2, 2)
    assert (report.acknowledged, report.changed) == (3, 5)
    (silent,), (broken,) = report.silent, report.broken
    assert silent.endswith("2 rows are missing")
    assert "flipped in byte" in silent
    assert broken.endswith("KeyError: 'head'")
    assert report.violated


def test_a_control_that_is_not_whole_is_seen(opened: list[Any]) -> None:
    opened[:] = [True, False, False]
    assert cut_and_flip(1, 0, 1, ManualClock()).whole == 1


def test_nothing_is_changed_in_a_sham_campaign(opened: list[Any]) -> None:
    opened += [True] * 4
    with sham():
        report = cut_and_flip(2, 2, 1, ManualClock())
    assert (report.changed, report.unaffected) == (0, 4)


def test_a_run_ends_early_when_its_time_is_over(opened: list[Any]) -> None:
    opened += [False] * 9
    clock = ManualClock()
    seen: list[tuple[str, int, int]] = []

    def progress(what: str, number: int, of: int) -> None:
        seen.append((what, number, of))
        clock.stall(25.0)

    report = cut_and_flip(9, 0, 1, clock, minutes=1.0, progress=progress)
    assert (report.tried, report.seconds) == (3, 75.0)
    assert [each[1:] for each in seen] == [(1, 9), (2, 9), (3, 9)]


@pytest.mark.parametrize(
    ("found", "violated"),
    [({}, False), ({"silent": ["cut"]}, True), ({"broken": ["cut"]}, True), ({"lost": 1}, True)],
)
def test_what_was_lost_or_not_understood_violates(found: dict[str, Any], violated: bool) -> None:
    fields = {name: getattr(CLEAN, name) for name in CLEAN.__struct_fields__}
    assert CutReport(**(fields | found)).violated is violated


@pytest.fixture
def power(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Cuts the power of a journal of three rows so that these files are left, and these rows were acknowledged."""

    def trace(folder: Path, commits: int, seed: int, *, durable: bool) -> list[str]:
        cuts._written(folder, folder.with_name("killed"), folder.with_name("closed"))
        return []

    def cut_as(*left: tuple[bool, list[int]]) -> None:
        def power_cuts(folder: Path, _: Any, times: int, chance: random.Random) -> Iterator[PowerCut]:
            whole = contents(folder)
            without = {name: content for name, content in whole.items() if not name.startswith(NAME)}
            for number, (survives, acknowledged) in enumerate(left):
                yield PowerCut(number, whole if survives else without, acknowledged)

        monkeypatch.setattr(cuts, "power_cuts", power_cuts)

    monkeypatch.setattr(cuts, "trace_journal", trace)
    monkeypatch.setattr(cuts, "ROWS", 3)
    return cut_as


def test_a_power_cut_must_leave_what_was_acknowledged(power: Callable[..., None]) -> None:
    power((True, [1, 2, 3]))
    report = cut_power(1, 1, ManualClock())
    assert (report.tried, report.acknowledged, report.unaffected, report.lost) == (1, 3, 1, 0)
    assert not report.violated


def test_a_journal_that_a_power_cut_removes_is_lost(power: Callable[..., None]) -> None:
    power((False, [1, 2]))
    report = cut_power(1, 1, ManualClock())
    assert report.lost == 2 or report.broken
    assert report.violated
    assert (report.changed, report.unaffected) == (1, 0)


def test_a_journal_that_does_not_verify_is_broken(power: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    def check(_: Path) -> None:
        raise JournalError("The chain is broken.")

    power((True, [1]))
    monkeypatch.setattr(cuts, "check_sound", check)
    assert cut_power(1, 1, ManualClock()).broken == ["cut 0 before call 0: JournalError: The chain is broken."]


def test_a_sham_power_cut_leaves_everything(power: Callable[..., None]) -> None:
    power((False, [1, 2]))
    with sham():
        report = cut_power(1, 1, ManualClock())
    assert (report.changed, report.violated) == (0, False)
