"""kill -9 of what writes the journal loses nothing, and a loss would be seen."""

from __future__ import annotations

import pytest

from pcmrs.clock import SystemClock
from pcmrs_lab.campaign import kills
from pcmrs_lab.campaign.cuts import cut_and_flip
from pcmrs_lab.campaign.kills import JOURNAL_FAILPOINTS, RANDOM, kill_writers


def test_no_acknowledged_row_is_lost_at_any_failpoint_or_instant() -> None:
    found = kill_writers(14, 3, SystemClock())
    assert (found.kills, found.lost, found.refused) == (14, 0, [])
    assert found.acknowledged > 14
    assert set(found.at) == {*JOURNAL_FAILPOINTS, RANDOM}
    assert found.not_reached == {}
    assert not found.violated


def test_failpoint_that_is_not_reached_is_counted_as_not_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "LATEST", 1 << 40)
    monkeypatch.setattr(kills, "DIES_WITHIN", 3.0)
    found = kill_writers(3, 3, SystemClock())
    assert (found.kills, found.at) == (3, {RANDOM: 1})
    assert found.not_reached == dict.fromkeys(JOURNAL_FAILPOINTS[:2], 1)
    assert found.acknowledged > 3
    assert not found.violated


def test_a_process_that_ends_by_itself_was_not_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "JOURNAL_FAILPOINTS", ("journal.nowhere",))
    found = kill_writers(2, 3, SystemClock())
    assert found.at == {RANDOM: 1}
    assert found.refused == ["A process that writes the journal ended by itself, with exit status 1."]
    assert found.violated


@pytest.mark.nightly
def test_nothing_acknowledged_is_lost_in_many_kills() -> None:
    found = kill_writers(600, 4, SystemClock())
    assert not found.violated
    assert set(found.at) == {*JOURNAL_FAILPOINTS, RANDOM}


def test_no_cut_and_no_flipped_bit_is_a_silent_loss() -> None:
    found = cut_and_flip(25, 25, 5, SystemClock())
    assert (found.silent, found.broken) == ([], [])
    assert found.tried == 50
    assert 0 < found.reported < 50


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_no_cut_at_any_byte_and_no_flip_is_a_silent_loss() -> None:
    found = cut_and_flip(None, None, 6, SystemClock(), minutes=20.0)
    assert not found.violated
