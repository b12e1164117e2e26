"""The journal of earlier runs is read whole once, in a process of its own, and damage in it is never silent."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from pcmrs.journal import Journal, JournalRow, verify
from pcmrs.messages import BlueprintTag, DeviceEvent
from pcmrs.service.restart.audit import audit

ROW = JournalRow(
    kind="event",
    source="here",
    wall=1.7e9,
    monotonic=1.0,
    boot_id="boot",
    session_id="session",
    blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)


@pytest.fixture
async def path(tmp_path: Path) -> Path:
    """A journal of three rows."""
    journal = Journal.open(tmp_path / "journal.sqlite")
    await journal.append([ROW] * 3)
    await journal.close()
    return tmp_path / "journal.sqlite"


def damage(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[content.index(b"here")] ^= 1
    path.write_bytes(content)


async def test_a_sound_journal_is_logged_and_nothing_is_reported(path: Path) -> None:
    reported: list[DeviceEvent] = []
    with capture_logs() as logs:
        await audit(path, reported.append)
    assert reported == []
    assert [(each["event"], each["rows"]) for each in logs] == [("journal_verified", 3)]


async def test_damaged_journal_is_reported_with_bad_row_and_remedy(path: Path) -> None:
    """The row is the first bad one."""
    damage(path)
    found, reported = verify(path), list[DeviceEvent]()
    assert not found.sound
    with capture_logs() as logs:
        await audit(path, reported.append)
    (event,) = reported
    assert (event.device, event.code, event.danger) == ("daemon", "journal_damaged", False)
    assert event.fields == {"rows": found.rows, "first_bad": found.first_bad, "missing": found.missing}
    assert found.problems[0] in event.text
    assert "pcmrs journal export --good-part" in event.text
    assert logs == []


async def test_a_journal_that_cannot_be_verified_is_no_damage(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(path.with_name("nothing")))
    reported: list[DeviceEvent] = []
    with capture_logs() as logs:
        async with asyncio.timeout(30.0):
            await audit(path, reported.append)
    assert reported == []
    assert [each["event"] for each in logs] == ["journal_not_verified"]
