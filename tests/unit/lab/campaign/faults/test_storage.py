"""Rows of the disk: what must be refused, how soon, and what counts as a damage that was reported."""

from __future__ import annotations

import asyncio
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.cuts import CutReport
from pcmrs_lab.campaign.durable import AnsweredCommands
from pcmrs_lab.campaign.faults import storage
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, ScriptedLab
from tests.unit.lab.scripted_client import Answer, rejected, snapshot

PLAN = "registration.plan_landmarks"
FULL = rejected("disk_full")
ACCEPTED: Answer = ("accepted", None)


class Stored(ScriptedCell):
    """A cell with a journal in a folder, whose daemon is in its first state."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, registration="000")
        self.journal = Path(self.ready.journal)


@pytest.fixture
def cell(tmp_path: Path) -> Stored:
    (tmp_path / "cell1").mkdir()
    return Stored(tmp_path / "cell1")


def commands(cell: ScriptedCell) -> AnsweredCommands:
    return AnsweredCommands(cell.as_cell)


async def test_a_few_commands_may_still_fit(cell: Stored) -> None:
    cell.client.answers[PLAN] = [ACCEPTED, ACCEPTED, FULL]
    cell.client.answers["registration.reinit"] = [FULL] * 2
    found = await storage._check_refused_eventually(commands(cell))
    assert found == {"refused_as": "disk_full", "latched": True}
    assert cell.client.asked.count(PLAN) == 3


async def test_a_daemon_that_never_refuses_is_unmet(cell: Stored) -> None:
    with pytest.raises(Unmet, match="Forty commands were accepted"):
        await storage._check_refused_eventually(commands(cell))


def test_a_refusal_comes_in_time_and_for_the_space(monkeypatch: pytest.MonkeyPatch, cell: Stored) -> None:
    cell.client.answers[PLAN] = [*[ACCEPTED] * 20, rejected("busy"), FULL]
    cell.client.answers["registration.reinit"] = [FULL] * 2
    assert run(monkeypatch, storage._check_refused_in_time(commands(cell)))["latched"] is True
    cell.client.latched = False
    with pytest.raises(Unmet, match="nearly full"):
        run(monkeypatch, storage._check_refused_in_time(commands(cell)))


def test_damage_is_proved_by_files_that_changed() -> None:
    def found(**changed: Any) -> Any:
        numbers = {"changed": 9, "reported": 8, "whole": 2, "tried": 10, "unaffected": 2} | changed
        report = CutReport("cut", acknowledged=60, lost=0, silent=[], broken=[], seed=1, seconds=1.0, **numbers)
        return storage._damage_reported("reported", report)

    assert proves(found())
    assert "changed" in found(changed=0).missing("order")
    assert "reported" in found(reported=0).missing("order")
    assert "undamaged_taken_up" in found(whole=0).missing("order")


def test_a_lock_is_seen_by_another_program(tmp_path: Path) -> None:
    path = tmp_path / "ratms.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as holder:
        holder.execute("CREATE TABLE journal (sequence)")
        assert storage._lock_error(path) == ""
        holder.execute("BEGIN IMMEDIATE")
        assert "locked" in storage._lock_error(path)
        holder.execute("ROLLBACK")
    assert storage._lock_error(path) == "", "it has given it back"


def test_the_files_of_a_journal_are_named(cell: Stored) -> None:
    assert [path.name for path in storage._files(cell.as_cell)] == [
        "ratms.sqlite",
        "ratms.sqlite-wal",
        "ratms.sqlite.head",
    ]
    assert storage._log_of(cell.as_cell).name == "ratms.sqlite-wal"


def test_a_started_daemon_is_in_its_first_state() -> None:
    storage._expect_initial(snapshot(registration="000"))
    with pytest.raises(Unmet, match="begins in"):
        storage._expect_initial(snapshot(registration="111"))


async def test_only_a_running_daemon_is_killed(cell: Stored) -> None:
    await storage._kill(cell.as_cell)
    await storage._kill(cell.as_cell)
    assert len(cell.process.signals) == 1


class Damaged(ScriptedLab):
    """A lab whose next daemon refuses to start with this, and the one after that starts."""

    def __init__(self, folder: Path, cell: Stored, status: int, errors: str) -> None:
        super().__init__(folder, cell)
        self.refusals = [(status, errors)]


def test_a_torn_log_is_reported_and_the_whole_one_read(tmp_path: Path, cell: Stored) -> None:
    log = storage._log_of(cell.as_cell)
    log.write_bytes(b"half")

    async def check(status: int, errors: str) -> Any:
        lab = Damaged(tmp_path, cell, status, errors)
        return await storage._check_damage_is_reported(lab.as_lab, cell.as_cell, "torn", b"the whole")

    found = asyncio.run(check(1, "log line\nError: the journal ends too early\n"))
    assert proves(found)
    assert found.took_place == {"bytes_lost": 5}
    assert log.read_bytes() == b"the whole"
    log.write_bytes(b"half")
    for status, errors, text in (
        (0, "journal", "Exit status 0"),
        (1, "Traceback ... journal", "Exit status 1"),
        (1, "Out of memory.", "It ended with: Out of memory"),
        (1, "", "It ended with: "),
    ):
        with pytest.raises(Unmet, match=text):
            asyncio.run(check(status, errors))
    log.write_bytes(b"the whole")
    with pytest.raises(Unmet, match="has lost nothing"):
        asyncio.run(check(1, "the journal ends too early"))


async def test_commands_before_the_fault_must_be_accepted(cell: Stored) -> None:
    assert len((await storage._accepted_commands(cell.as_cell)).verdicts) == storage.COMMANDS
    cell.client.answers[PLAN] = [FULL]
    with pytest.raises(Unmet, match="before the fault"):
        await storage._accepted_commands(cell.as_cell)


async def test_the_next_daemon_starts_in_the_same_folder(tmp_path: Path, cell: Stored) -> None:
    lab = ScriptedLab(tmp_path, cell)
    assert await storage._check_successor(lab.as_lab, cell.as_cell) == "accepted"
    (settings,) = lab.started
    assert settings == (f"cell.folder={cell.ready.folder}", storage.NO_LEAST)
    cell.client.branches["registration"] = "111"
    with pytest.raises(Unmet, match="The next daemon begins in"):
        await storage._check_successor(lab.as_lab, cell.as_cell)


def half_written(tmp_path: Path, cell: Stored, status: int) -> Any:
    lab = Damaged(tmp_path, cell, status, "")
    cell.process.pid = os.getpid()  # the kernel shows what this process sees
    return storage.a_half_written_file(lab.as_lab)


def test_half_written_files_are_ignored_but_not_a_key(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Stored
) -> None:
    found = run(monkeypatch, half_written(tmp_path, cell, 4))
    assert proves(found)
    assert found.took_place == {"half_written_files_where_the_daemon_reads": 5}
    assert (cell.folder / "journal.key").read_bytes() == storage.HALF_WRITTEN


def test_files_that_were_not_written_are_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Stored
) -> None:
    with sham():
        found = run(monkeypatch, half_written(tmp_path, cell, 4))
    assert "half_written_files" in found.missing("order")
    with pytest.raises(Unmet, match="not noticed even if it is read"):
        run(monkeypatch, half_written(tmp_path, cell, 0))
