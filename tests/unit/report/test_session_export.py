"""What an export says of a journal that was cut, and of files that are not there any more."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag
from pcmrs.recording.settings import FOLDER
from pcmrs.report.session_export import ExportReport, export_session
from pcmrs.settings import Settings, read_settings

TAG = BlueprintTag(id="w", version="1", hash="0")


def row(session: str, kind: Any = "event", result: dict[str, Any] | None = None) -> JournalRow:
    return JournalRow(
        kind=kind, wall=1.0, monotonic=1.0, boot_id="b", session_id=session, blueprint=TAG, source="x", result=result
    )


async def written(folder: Path) -> tuple[Settings, Path]:
    """A journal of two sessions, the second with a recording and a calibration file that is gone."""
    settings = read_settings(None, [f"cell.folder={folder}"])
    lost = str(folder / "gone.toml")
    plain = msgspec.to_builtins(settings)
    plain["procedure"]["calibration"]["tool_file"] = lost
    started = {"settings": plain, "versions": {"pcmrs": "0"}, "calibration": "c0ffee"}
    path = folder / "ratms.sqlite"
    journal = Journal.open(path)
    await journal.append([row("first-session", "config", {"settings": plain})])
    await journal.append([row("second-session", "config", started), row("second-session")])
    await journal.close()
    (folder / FOLDER).mkdir()
    (folder / FOLDER / "20260101T000000Z-second-s.0001.mcap").write_bytes(b"recorded")
    (folder / FOLDER / "20260101T000000Z-first-se.0001.mcap").write_bytes(b"another")
    return settings, path


def exported(settings: Settings, journal: Path, folder: Path, session: str | None = None) -> ExportReport:
    return export_session(settings, journal, session, folder, lambda *_: None)


async def test_missing_file_is_reported_and_a_cut_journal_is_not_sound(tmp_path: Path) -> None:
    settings, journal = await written(tmp_path)
    good = exported(settings, journal, tmp_path / "good")
    assert good.session == "second-session"
    assert good.problems == ()
    assert good.recordings == ("20260101T000000Z-second-s.0001.mcap",)
    assert [line for line in good.missing if "gone.toml" in line]
    assert "gone.toml" in (tmp_path / "good" / "README.txt").read_text()
    assert "c0ffee" in (tmp_path / "good" / "README.txt").read_text()
    assert exported(settings, journal, tmp_path / "first", "first").session == "first-session"

    with closing(sqlite3.connect(journal)) as database:
        (guard,) = database.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        database.execute("DROP TRIGGER no_delete")
        database.execute("DELETE FROM journal WHERE sequence = (SELECT max(sequence) FROM journal)")
        database.execute(guard)
        database.commit()
    cut = exported(settings, journal, tmp_path / "cut")
    assert cut.rows == good.rows - 1
    assert cut.problems
    assert "NOT SOUND" in (tmp_path / "cut" / "README.txt").read_text()


async def test_unknown_session_or_used_folder_exports_nothing(tmp_path: Path) -> None:
    settings, journal = await written(tmp_path)
    out, used = tmp_path / "out", tmp_path / FOLDER
    before = sorted(used.iterdir())
    for session in ("third", ""):
        with pytest.raises(JournalError, match="second-session"):
            exported(settings, journal, out, session)
    with pytest.raises(ConfigurationError, match="not empty"):
        exported(settings, journal, used)
    assert not out.exists()
    assert sorted(used.iterdir()) == before
