"""A damaged journal is either recovered with every row or refused with a reason; anything in between is reported."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from msgspec.structs import replace

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow
from pcmrs.testing import journal_recovery as checking
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import HEAD, KEY, NAME, PUBLIC_KEY, contents, place, row
from pcmrs.testing.journal_recovery import check_sound, is_recovered, missing_rows

Written = tuple[dict[str, bytes], list[StoredRow]]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """The files of a closed journal, and its rows."""

    async def write() -> list[StoredRow]:
        journal = Journal.open(folder / NAME)
        await journal.append([row("run0", 0, number) for number in range(3)])
        rows = list(journal.reader.read())
        await journal.close()
        return rows

    folder = tmp_path_factory.mktemp("journal")
    rows = asyncio.run(write())
    return contents(folder), rows


def test_an_undamaged_journal_is_recovered(written: Written, tmp_path: Path) -> None:
    files, rows = written
    journal = place(files, tmp_path / "copy")
    check_sound(journal)
    assert is_recovered(journal, rows)


def test_a_row_that_is_missing_or_changed_is_reported(written: Written, tmp_path: Path) -> None:
    files, rows = written
    journal = place(files, tmp_path / "copy")
    changed, more = replace(rows[0], row=row("other", 0, 0)), replace(rows[0], sequence=99)
    assert asyncio.run(missing_rows(journal, [changed, *rows[1:]])) == 1
    with pytest.raises(Unmet, match="1 rows are missing or changed"):
        is_recovered(place(files, tmp_path / "again"), [*rows, more])


def test_a_refused_journal_must_be_as_it_was(written: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, rows = written
    damaged = files | {NAME: files[NAME][: len(files[NAME]) // 2]}
    journal = place(damaged, tmp_path / "copy")
    assert not is_recovered(journal, rows)
    refusal = checking._refusal

    async def change(path: Path) -> JournalError | None:
        found = await refusal(path)
        (path.parent / HEAD).write_bytes(b"new")
        (path.parent / PUBLIC_KEY).write_bytes(b"new")
        return found

    monkeypatch.setattr(checking, "_refusal", change)
    with pytest.raises(Unmet, match=f"refused, but changed: {HEAD}$"):
        is_recovered(place(damaged, tmp_path / "again"), rows)


def test_verify_must_find_why_a_journal_is_refused(
    written: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, rows = written
    journal = place(files, tmp_path / "copy")
    text = "The head is damaged."

    async def refuse(_: Path) -> JournalError:
        return JournalError(text)

    monkeypatch.setattr(checking, "_refusal", refuse)
    with pytest.raises(Unmet, match=r"verify found nothing, but opening was refused: The head is damaged\."):
        is_recovered(journal, rows)
    text = f"{KEY} is damaged."
    assert not is_recovered(journal, rows), "verifying needs no private key"


def test_a_journal_that_verify_complains_of_is_unmet(written: Written, tmp_path: Path) -> None:
    files, _ = written
    without = {name: content for name, content in files.items() if name != HEAD}
    with pytest.raises(Unmet, match="verify finds"):
        check_sound(place(without, tmp_path / "copy"))
    with pytest.raises(JournalError):
        check_sound(tmp_path / "none.sqlite")


def test_looking_for_rows_leaves_a_usable_journal(written: Written, tmp_path: Path) -> None:
    files, rows = written
    journal = place(files, tmp_path / "copy")
    assert asyncio.run(missing_rows(journal, rows)) == 0
    with JournalReader(journal) as reader:
        assert [stored.row.session_id for stored in reader.read()][-1] == "after"
