"""kill -9 of what writes the journal loses nothing, and a loss would be seen."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pcmrs.campaign.cuts import cut_and_flip, cut_power
from pcmrs.campaign.kills import OF_JOURNAL, RANDOM, Checked, kill_writers, lost_rows
from pcmrs.campaign.writing import row
from pcmrs.clock import SystemClock
from pcmrs.errors import JournalError
from pcmrs.journal import Journal


def test_nothing_acknowledged_is_lost_at_any_failpoint_or_instant() -> None:
    found = kill_writers(14, 3, SystemClock())
    assert (found.kills, found.lost, found.refused) == (14, 0, [])
    assert found.acknowledged > 14
    assert set(found.at) == {*OF_JOURNAL, RANDOM}
    assert not found.violated


@pytest.mark.nightly
def test_nothing_acknowledged_is_lost_in_many_kills() -> None:
    found = kill_writers(600, 4, SystemClock())
    assert not found.violated
    assert set(found.at) == {*OF_JOURNAL, RANDOM}


async def _journal(path: Path, rows: int) -> None:
    journal = Journal.open(path)
    for number in range(rows):
        await journal.append([row("run0", 0, number)])
    await journal.close()


async def test_a_row_that_is_not_there_is_a_loss(tmp_path: Path) -> None:
    await _journal(tmp_path / "journal.sqlite", 3)
    assert lost_rows(tmp_path / "journal.sqlite", "run0", [2, 3], Checked()) == 0
    assert lost_rows(tmp_path / "journal.sqlite", "run0", [3, 9], Checked()) == 1
    assert lost_rows(tmp_path / "journal.sqlite", "run1", [2, 3], Checked()) == 2
    assert lost_rows(tmp_path / "nowhere.sqlite", "run0", [1], Checked()) == 1


async def test_a_chain_that_does_not_go_on_is_seen(tmp_path: Path) -> None:
    await _journal(tmp_path / "journal.sqlite", 3)
    with pytest.raises(JournalError, match="does not continue"):
        lost_rows(tmp_path / "journal.sqlite", "run0", [2], Checked(1, bytes(32)))


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


needs_strace = pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")


@needs_strace
def test_a_power_cut_at_any_instant_loses_nothing_acknowledged() -> None:
    found = cut_power(15, 7, SystemClock(), commits=60)
    assert (found.lost, found.broken) == (0, [])
    assert found.acknowledged > 15


@needs_strace
def test_a_writer_that_waits_for_no_disk_is_seen_to_lose() -> None:
    found = cut_power(15, 8, SystemClock(), commits=60, durable=False)
    assert found.violated
