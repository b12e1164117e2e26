"""Backup of a cell: verified, complete without secrets of others, or not there at all."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from pcmrs.errors import BackupError, ConfigurationError, PcmrsError
from pcmrs.journal import Journal, verify
from pcmrs.maintenance import back_up
from pcmrs.maintenance._backup import read_backup
from pcmrs.maintenance._folder import MANIFEST
from tests.unit.journal.journal_rows import row
from tests.unit.maintenance.labs import Lab, contents

NOW = 1.8e9


def test_a_backup_has_every_file_but_secrets_of_others(present: Lab, tmp_path: Path) -> None:
    (present.cell / "device.key").write_bytes(b"secret")
    (present.cell / "console.token").write_bytes(b"secret")
    before = contents(present.cell)
    report = back_up(present.cell, tmp_path / "copy", NOW, configuration={"cell.toml": present.configuration})
    copied = contents(tmp_path / "copy")

    expected = before.keys() - {"device.key", "console.token"}
    assert copied.keys() == {*expected, MANIFEST, "configuration/cell.toml"}
    same = expected - {"ratms.sqlite", "ratms.sqlite.head"}
    assert {name: copied[name] for name in same} == {name: before[name] for name in same}
    assert report.manifest.left_out == ("console.token", "device.key")
    assert verify(tmp_path / "copy" / "ratms.sqlite").rows == verify(present.journal).rows
    assert read_backup(tmp_path / "copy") == report.manifest
    assert (tmp_path / "copy").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "copy" / "journal.key").stat().st_mode & 0o777 == 0o600
    assert contents(present.cell) == before


def test_recordings_can_be_left_out(present: Lab, tmp_path: Path) -> None:
    manifest = back_up(present.cell, tmp_path / "copy", NOW, recordings=False).manifest
    assert not (tmp_path / "copy" / "recordings").exists()
    assert "recordings" in manifest.left_out


def test_an_older_folder_is_backed_up_as_it_is(first: Lab, tmp_path: Path) -> None:
    back_up(first.cell, tmp_path / "copy", NOW)
    assert verify(tmp_path / "copy" / "ratms.sqlite").version == 2


async def test_a_journal_that_is_written_meanwhile_is_consistent(tmp_path: Path) -> None:
    """Each backup holds all rows that were acknowledged before it began, and its head names its last row."""
    cell = tmp_path / "cell"
    cell.mkdir()
    journal = Journal.open(cell / "ratms.sqlite")
    stop = asyncio.Event()

    async def write() -> None:
        while not stop.is_set():
            await journal.append([row()])
            await asyncio.sleep(0.002)

    writing = asyncio.create_task(write())
    await journal.append([row()])
    for number in range(4):
        acknowledged = journal.reader.last_sequence()
        manifest = (await asyncio.to_thread(back_up, cell, tmp_path / f"copy{number}", NOW)).manifest
        found = verify(tmp_path / f"copy{number}" / "ratms.sqlite")
        assert found.sound
        assert found.rows == manifest.journals["ratms.sqlite"].rows >= acknowledged
        assert found.unnamed == 0
    stop.set()
    await writing
    await journal.close()


def test_a_damaged_journal_gives_no_backup(present: Lab, tmp_path: Path) -> None:
    present.edit("cell/ratms.sqlite", lambda content: content.replace(b"phantom", b"phantoM"))
    with pytest.raises(PcmrsError, match="not whole"):
        back_up(present.cell, tmp_path / "copy", NOW)
    assert [path.name for path in tmp_path.iterdir()] == ["lab"]


@pytest.mark.parametrize("place", ["copy", "lab/cell/copy"], ids=["existing", "inside"])
def test_a_place_that_is_no_new_folder_outside_is_refused(present: Lab, tmp_path: Path, place: str) -> None:
    (tmp_path / "copy").mkdir()
    before = contents(tmp_path)
    with pytest.raises(ConfigurationError):
        back_up(present.cell, tmp_path / place, NOW)
    assert contents(tmp_path) == before


def test_a_folder_above_a_cell_is_not_backed_up(present: Lab, tmp_path: Path) -> None:
    """The rows in the log of the journal below would not be copied."""
    with pytest.raises(ConfigurationError, match=r"not the folder of one cell: it has cell/cell.json below it"):
        back_up(present.folder, tmp_path / "copy", NOW)
    assert [path.name for path in tmp_path.iterdir()] == ["lab"]


def test_a_linked_key_of_the_journal_gives_no_backup(present: Lab, tmp_path: Path) -> None:
    """A backup without the key cannot be restored."""
    (present.cell / "journal.key").rename(present.folder / "journal.key")
    (present.cell / "journal.key").symlink_to("../journal.key")
    with pytest.raises(ConfigurationError, match=r"cell/journal.key is a symbolic link to \.\./journal.key"):
        back_up(present.cell, tmp_path / "copy", NOW)
    assert [path.name for path in tmp_path.iterdir()] == ["lab"]


@pytest.mark.parametrize("change", ["changed", "removed", "added"])
def test_a_changed_backup_is_recognized(present: Lab, tmp_path: Path, change: str) -> None:
    copy = tmp_path / "copy"
    back_up(present.cell, copy, NOW)
    if change == "changed":
        (copy / "peers.counters").write_bytes(bytes(16_384))
    elif change == "removed":
        (copy / "journal.pub").unlink()
    else:
        (copy / "records.txt").write_text("new")
    with pytest.raises(BackupError, match="was changed after it was made"):
        read_backup(copy)


def test_a_backup_of_a_later_version_is_refused(present: Lab, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    back_up(present.cell, copy, NOW)
    manifest = json.loads((copy / MANIFEST).read_text())
    (copy / MANIFEST).write_text(json.dumps({"schema": 2, "made": manifest["made"]}))
    with pytest.raises(BackupError, match="has format 2, and this version of PCMRS reads 1"):
        read_backup(copy)


def test_a_folder_that_is_no_backup_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BackupError, match="is not a backup"):
        read_backup(tmp_path)
