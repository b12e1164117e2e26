"""Restoring of a backup: the journal verifies and says that it was set back; nothing existing is replaced."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import BackupError, ConfigurationError, PcmrsError
from pcmrs.files import sha256_of
from pcmrs.journal import JournalReader, JournalRow, verify
from pcmrs.journal.head import head_path
from pcmrs.maintenance import back_up, check_folder, enter_folder, restore
from tests.unit.maintenance.labs import Lab, contents

NOW = 1.8e9


def last_row(journal: Path) -> JournalRow:
    with JournalReader(journal) as reader:
        return next(reader.read(last=1)).row


@pytest.mark.parametrize("lab", ["first", "present"])
def test_a_restored_journal_says_so_and_verifies(lab: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    written: Lab = request.getfixturevalue(lab)
    rows = verify(written.journal).rows
    back_up(written.cell, tmp_path / "copy", NOW, configuration={"cell.toml": written.configuration})
    copied = contents(tmp_path / "copy")
    report = restore(tmp_path / "copy", tmp_path / "restored")

    journal = tmp_path / "restored" / "ratms.sqlite"
    found = verify(journal, kept=head_path(tmp_path / "copy" / "ratms.sqlite"))
    assert (found.problems, found.unnamed) == ((), 0)
    row = last_row(journal)
    assert (row.kind, row.source, row.operation) == ("event", "journal", "restored")
    assert (row.result or {})["rows"] == rows
    assert "2027-01-15T08:00:00+00:00" in (row.result or {})["text"]
    assert report.journals == {"ratms.sqlite": rows}
    assert check_folder(tmp_path / "restored").action == "use"
    enter_folder(tmp_path / "restored")
    assert contents(tmp_path / "copy") == copied
    restored = contents(tmp_path / "restored")
    assert not {"backup.json", "configuration/cell.toml"} & restored.keys()
    assert restored["peers.counters"] == copied["peers.counters"]


def test_a_folder_with_files_is_not_touched(present: Lab, tmp_path: Path) -> None:
    back_up(present.cell, tmp_path / "copy", NOW)
    before = contents(present.cell)
    with pytest.raises(ConfigurationError, match="is not empty"):
        restore(tmp_path / "copy", present.cell)
    assert contents(present.cell) == before


def test_an_empty_folder_is_filled(present: Lab, tmp_path: Path) -> None:
    back_up(present.cell, tmp_path / "copy", NOW)
    (tmp_path / "restored").mkdir()
    restore(tmp_path / "copy", tmp_path / "restored")
    assert verify(tmp_path / "restored" / "ratms.sqlite").sound


@pytest.mark.parametrize("name", ["ratms.sqlite", "ratms.sqlite.head", "journal.key", "backup.json"])
def test_a_damaged_backup_restores_nothing(present: Lab, tmp_path: Path, name: str) -> None:
    back_up(present.cell, tmp_path / "copy", NOW)
    path = tmp_path / "copy" / name
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BackupError):
        restore(tmp_path / "copy", tmp_path / "restored")
    assert {path.name for path in tmp_path.iterdir()} == {"lab", "copy"}


def test_a_folder_of_a_later_version_is_not_restored(present: Lab, tmp_path: Path) -> None:
    back_up(present.cell, tmp_path / "copy", NOW)
    manifest = (tmp_path / "copy" / "backup.json").read_text()
    marker = tmp_path / "copy" / "cell.json"
    before = sha256_of(marker).hex()
    marker.write_text('{"format": 3, "program": "9.1"}')
    (tmp_path / "copy" / "backup.json").write_text(manifest.replace(before, sha256_of(marker).hex()))
    with pytest.raises(PcmrsError, match=r"PCMRS 9\.1 wrote it"):
        restore(tmp_path / "copy", tmp_path / "restored")
    assert not (tmp_path / "restored").exists()


def test_nothing_is_restored_into_the_backup(present: Lab, tmp_path: Path) -> None:
    """The backup was changed by that, and could not be used again."""
    back_up(present.cell, tmp_path / "copy", NOW)
    before = contents(tmp_path / "copy")
    with pytest.raises(ConfigurationError, match="is in the backup"):
        restore(tmp_path / "copy", tmp_path / "copy" / "restored")
    assert contents(tmp_path / "copy") == before


def test_a_folder_beside_the_restored_one_stays(present: Lab, tmp_path: Path) -> None:
    back_up(present.cell, tmp_path / "copy", NOW)
    (tmp_path / "restored.part").mkdir()
    (tmp_path / "restored.part" / "notes.txt").write_text("mine")
    restore(tmp_path / "copy", tmp_path / "restored")
    assert (tmp_path / "restored.part" / "notes.txt").read_text() == "mine"


def test_no_backup_is_made_in_the_cell_by_another_name(present: Lab, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(present.cell)
    before = contents(present.cell)
    with pytest.raises(ConfigurationError, match="is in the folder that it would be a copy of"):
        back_up(present.cell, tmp_path / "link" / "inside", NOW)
    assert contents(present.cell) == before
